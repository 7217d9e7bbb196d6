"""What a diagnosis costs: ``python -m tests.benchmarks.bench_diagnose``.

Processor seconds on one core of a diagnosis of eq. (35) with T = 1000 and the whole catalogue, with the
share of each stage, clean and with a hidden effect; of screening alone, against the number of candidates
and the length of the series; and seconds on the clock, by one process and by two. Writes
``results/diagnose-cost.csv`` and ``.md``.
"""

# ruff: noqa: E402 - the number of threads must be set before NumPy is loaded

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"

import csv
import time
from pathlib import Path
from typing import Any

import numpy as np

import engine
from engine.diagnose import diagnose, extend
from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.search.pipeline import fit_base
from engine.diagnose.search.search import screen_effects

RESULTS = Path(__file__).parent / "results"
MODEL = "mixed-4"
T = 1000
LENGTHS = (500, 1000, 2000, 4000)
SHARES = (0.25, 0.5, 1.0)  # of the catalogue
REPEATS = 3
HIDDEN, SIZE = "bias:y1", 0.3


def series_of(rows: int, effect: str = "", size: float = 0.0) -> engine.Series:
    """A simulated series, with an effect hidden in it."""
    model = engine.get_model(MODEL)
    if effect:
        model = extend(model, [effect])
    theta = model.theta()
    if effect:
        theta = model.theta({model.parameter_names[-1]: size})
    return engine.simulate(model, theta, rows, np.random.default_rng(11)).series


def stages() -> list[dict[str, Any]]:
    """Seconds of each stage of whole diagnoses, the parameters searched for from their defaults."""
    rows = []
    for label, effect, size in (("clean", "", 0.0), (HIDDEN, HIDDEN, SIZE)):
        series = series_of(T, effect, size)
        began, cpu = time.perf_counter(), time.process_time()
        found = diagnose(engine.get_model(MODEL), series, seed=1, processes=1)
        cpu, wall = time.process_time() - cpu, time.perf_counter() - began
        for stage, seconds in found.seconds.items():
            # stages are clocked by wall time; their shares are applied to processor time
            rows.append(
                {
                    "what": f"diagnosis, {label}: {found.verdict.value}",
                    "part": stage,
                    "T": T,
                    "candidates": len(found.rounds[0].screen.scores),
                    "seconds": cpu * seconds / sum(found.seconds.values()),
                }
            )
        print(label, found.verdict, f"{cpu:.1f} s CPU, {wall:.1f} s wall", flush=True)
    return rows


def screening() -> list[dict[str, Any]]:
    """Median seconds of one screen."""
    rows = []
    model = engine.get_model(MODEL)
    for length in LENGTHS:
        series = series_of(length)
        base = fit_base(model, series, model.theta(), None)
        setting = setting_for(model, series, base.theta)
        names = [effect.name for effect in all_effects(setting)]
        names = [str(n) for n in np.random.default_rng(0).permutation(names)]
        for share in SHARES if length == T else (1.0,):
            some = names[: round(share * len(names))]
            spent = []
            for _ in range(REPEATS):
                cpu = time.process_time()
                screen_effects(base, series, setting, some, 0.05, 0, lambda stage, part: None)
                spent.append(time.process_time() - cpu)
            rows.append(
                {
                    "what": "screen",
                    "part": f"{share:.0%} of the catalogue",
                    "T": length,
                    "candidates": len(some),
                    "seconds": float(np.median(spent)),
                }
            )
            print(rows[-1], flush=True)
    return rows


def shared() -> list[dict[str, Any]]:
    """Median seconds on the clock of whole diagnoses by one process and by two, in turn."""
    rows = []
    for label, effect, size in (("clean", "", 0.0), (HIDDEN, HIDDEN, SIZE)):
        series = series_of(T, effect, size)
        spent: dict[int, list[float]] = {1: [], 2: []}
        for _ in range(REPEATS):
            for processes, seconds in spent.items():
                began = time.perf_counter()
                diagnose(engine.get_model(MODEL), series, seed=1, processes=processes)
                seconds.append(time.perf_counter() - began)
        ratio = float(np.median(np.divide(spent[2], spent[1])))
        for processes, seconds in spent.items():
            rows.append(
                {
                    "what": f"shared, {label}",
                    "part": f"{processes} processes: {ratio:.2f} of the time"
                    if processes > 1
                    else "1 process",
                    "T": T,
                    "candidates": 0,
                    "seconds": float(np.median(seconds)),
                }
            )
            print(rows[-1], flush=True)
    return rows


def slope(rows: list[dict[str, Any]], by: str) -> float:
    """Of log seconds over log ``by``: 1 is linear."""
    x = np.log([row[by] for row in rows])
    return float(np.polyfit(x, np.log([row["seconds"] for row in rows]), 1)[0])


def main() -> None:
    """Measure and write."""
    diagnose(engine.get_model(MODEL), series_of(200), seed=1)  # compiles
    rows = [*stages(), *screening(), *shared()]
    with (RESULTS / "diagnose-cost.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    (RESULTS / "diagnose-cost.md").write_text(page(rows))


def page(rows: list[dict[str, Any]]) -> str:
    """The tables."""
    whole = [row for row in rows if row["what"].startswith("diagnosis")]
    text = [
        f"# What a diagnosis costs\n\n`{MODEL}`, the whole catalogue, processor seconds on one core.\n"
    ]
    text += [f"| diagnosis, T = {T} | stage | seconds | share |", "| --- | --- | --- | --- |"]
    for what in dict.fromkeys(row["what"] for row in whole):
        some = [row for row in whole if row["what"] == what]
        total = sum(row["seconds"] for row in some)
        for row in some:
            text.append(
                f"| {what} | {row['part']} | {row['seconds']:.1f} | {row['seconds'] / total:.0%} |"
            )
        text.append(f"| {what} | all | {total:.1f} | |")
    screens = [row for row in rows if row["what"] == "screen"]
    text += ["\n| one screen | T | candidates | seconds |", "| --- | --- | --- | --- |"]
    text += [
        f"| {r['part']} | {r['T']} | {r['candidates']} | {r['seconds']:.2f} |" for r in screens
    ]
    by_length = [row for row in screens if row["part"].startswith("100")]
    by_number = [row for row in screens if row["T"] == T]
    text.append(
        f"\nSlopes of log seconds: {slope(by_length, 'T'):.2f} over log T, "
        f"{slope(by_number, 'candidates'):.2f} over log candidates; 1 is linear growth, less where a fixed "
        "part counts.\n"
    )
    text += ["| diagnosis by several processes | | seconds on the clock |", "| --- | --- | --- |"]
    text += [
        f"| {r['what'].removeprefix('shared, ')} | {r['part']} | {r['seconds']:.1f} |"
        for r in rows
        if r["what"].startswith("shared")
    ]
    return "\n".join([*text, ""])


if __name__ == "__main__":
    main()
