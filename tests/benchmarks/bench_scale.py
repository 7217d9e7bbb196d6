"""Long series: ``python -m tests.benchmarks.bench_scale``.

T = 10^3, 10^4, 10^5 with M = N = 100: processor seconds of the RBPF, of backward simulation (all
weights, and MCMC moves), of the E step that follows and of one M step, and the peak memory of the
process that did it. One thread; each line is a process of its own. Writes ``results/scale.csv`` and
``results/scale.md``.
"""

# ruff: noqa: E402 - the number of threads must be set before NumPy is loaded

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import csv
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import engine
from engine.estimation.expectation import expectation
from engine.estimation.maximization import maximize
from engine.smoothers.moments import Moments
from engine.statespace.points import Points

RESULTS = Path(__file__).parent / "results"
LENGTHS = (1_000, 10_000, 100_000)
MODELS = ("linear-2", "mixed-4")
M = N = 100
COLUMNS = ("filter", "backward", "backward_mcmc", "e_step", "m_step")


def measure(name: str, T: int) -> dict[str, Any]:
    """Seconds of each part, and the peak memory in GiB, of one EM iteration."""
    model = engine.get_model(name)
    warm_up = engine.simulate(model, None, 50, np.random.default_rng(0)).series
    iteration(model, warm_up)
    series = engine.simulate(model, None, T, np.random.default_rng(1)).series
    row: dict[str, Any] = {"model": name, "T": T} | iteration(model, series)
    row["total"] = sum(row[column] for column in COLUMNS if column != "backward_mcmc")
    row["microseconds_per_sample"] = 1e6 * row["total"] / T
    row["peak_GiB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return row


def iteration(model: engine.MixedModel, series: engine.Series) -> dict[str, float]:
    rng = np.random.default_rng(2)
    theta = model.theta()
    seconds: dict[str, float] = {}

    def timed(part: str, work: Callable[[], Any]) -> Any:
        started = time.process_time()
        out = work()
        seconds[part] = time.process_time() - started
        return out

    filtered = timed("filter", lambda: engine.rbpf(model, theta, series, M, rng))
    timed("backward_mcmc", lambda: engine.rb_ffbsi_linear(filtered, N, rng, condition=False))
    draws = timed("backward", lambda: engine.rb_ffbsi(filtered, N, rng, joint=True))

    def expect() -> Any:
        points = Points(model, series, draws.a)
        s = engine.condition_on_trajectories(draws, points)
        return expectation(model, theta, [(Moments(s.a, s.z, s.cov, s.cross), points)])

    q = timed("e_step", expect)
    free = np.arange(len(model.parameters))
    timed("m_step", lambda: maximize(q, np.asarray(theta), free))
    return seconds


def main() -> None:
    RESULTS.mkdir(exist_ok=True)
    rows = []
    for name in MODELS:
        for T in LENGTHS:
            call = [sys.executable, "-m", "tests.benchmarks.bench_scale", name, str(T)]
            out = subprocess.run(call, check=True, capture_output=True, text=True)
            rows.append(json.loads(out.stdout.splitlines()[-1]))
            print(line(rows[-1]), flush=True)
    write(rows)


def write(rows: list[dict[str, Any]]) -> None:
    """The rows as ``scale.csv``, and the page about them."""
    with (RESULTS / "scale.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    head = ("model", "T", *COLUMNS, "us per sample and iteration", "peak GiB")
    text = [
        f"One EM iteration with M = N = {M}, processor seconds on one core",
        "(`python -m tests.benchmarks.bench_scale`; backward_mcmc is the linear-cost alternative to",
        "backward and not part of the total).",
        "",
        "| " + " | ".join(head) + " |",
        "| " + " | ".join("---" for _ in head) + " |",
        *map(line, rows),
        "",
        "Slope of log seconds over log T (1: linear): "
        + ", ".join(f"{name} {slope(rows, name):.2f}" for name in MODELS)
        + ".",
        "",
    ]
    (RESULTS / "scale.md").write_text("\n".join(text))


def slope(rows: list[dict[str, Any]], name: str) -> float:
    """The exponent of T by which the total grows."""
    own = [(row["T"], row["total"]) for row in rows if row["model"] == name]
    T, total = np.log(np.array(own)).T
    return float(np.polyfit(T, total, 1)[0])


def line(row: dict[str, Any]) -> str:
    cells = [row["model"], str(row["T"]), *(f"{row[column]:.3f}" for column in COLUMNS)]
    cells += [f"{row['microseconds_per_sample']:.0f}", f"{row['peak_GiB']:.2f}"]
    return "| " + " | ".join(cells) + " |"


if __name__ == "__main__":
    if len(sys.argv) == 3:
        print(json.dumps(measure(sys.argv[1], int(sys.argv[2]))))
    else:
        main()
