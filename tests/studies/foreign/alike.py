"""The same thing in other words: effects that no data of a plant can tell from the truth, or hardly.

``python -m tests.studies.foreign.alike`` measures, on pilot series, |cos| of the screened footprints of every
fault and every other effect of the catalogue, and keeps those above ``SAME`` in ``alike.csv``; ``ARGUED`` holds
what follows from the equations. Both were written down before any judged series was drawn, with two
exceptions: kinds that the catalogue got afterwards, such as slow-sensor; and waves, whose sine and cosine were
once compared one by one, so that a hum seen through a lag was not called the same hum. The latter was found
on judged series of seeds 9 and 10; the series judged now are others.

What is in no catalogue may still be what an effect of it says: a loss over a notch is an overflow, but for
the power of the surplus. So every effect that a diagnosis refits is asked which share it wins back of the
likelihood that such a fault costs, at ``LARGER`` times its size, where chance plays no part: above ``SAME``
squared it is a word for the fault, and where the best is above ``IMITATED`` squared the cell is reported apart
(``imitated.csv``), for a fifth of the likelihood ratio at most tells the two apart. This was added after
seed 18 was seen.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from engine.diagnose.search.pipeline import Causes, find_causes
from engine.errors import EngineError
from tests.studies.foreign.cells import CLEAN, Cell, every_cell
from tests.studies.foreign.drawing import series_of
from tests.studies.foreign.sizes import fit_base, size_of, without

TIMED = (
    "step",
    "parameter-step",
    "parameter-episode",
    "parameter-drift",
    "input-gain-step",
    "gain-step",
    "harmonic",
    "pulse",
    "episode",
)
FILE = Path(__file__).with_name("alike.csv")
NEAREST = Path(__file__).with_name("imitated.csv")
PILOT = 34_000_000  # first part of the seeds
SERIES = 2
SAME = 0.98
IMITATED = 0.9
LARGER = 2.0
EVERY = (
    1.0  # alpha: everything is an alarm, so that nothing is refitted before the first one is named
)
SHORT_LAG = (
    "a lag shorter than a sample is a share that comes late: one sample, or a smaller one of two; the plant's "
    "lag of first order is what slow-sensor says"
)
ARGUED: dict[tuple[str, str], tuple[tuple[str, ...], str]] = {
    ("room", "input-offset:heater"): (
        ("force:air",),
        "the heater enters the air's equation only, times 1 / Ca",
    ),
    ("tanks", "input-offset:pump"): (
        ("force:upper",),
        "the pump enters the upper level's equation only, times a constant",
    ),
    ("reactor", "input-offset:coolant"): (
        ("force:temperature",),
        "the coolant enters the temperature's equation only, times the constant a",
    ),
    ("battery", "quantisation:terminal"): (
        ("level:terminal",),
        "rounding to steps q predicts as white noise of variance q^2 / 12 more does",
    ),
    ("motor", "outside:product"): (
        ("product:current*speed->speed",),
        "the plant's own term; the catalogue has had it since the published series were drawn",
    ),
    ("room", "lag:thermometer"): (
        ("delay:thermometer", "slow-sensor:thermometer"),
        SHORT_LAG,
    ),
    ("vehicle", "lag:satellite"): (
        ("delay:satellite", "slow-sensor:satellite"),
        SHORT_LAG,
    ),
    ("mixer", "lag:probe2"): (
        ("delay:probe2", "slow-sensor:probe2"),
        SHORT_LAG,
    ),
    ("reactor", "lag:thermometer"): (
        ("delay:thermometer", "slow-sensor:thermometer"),
        SHORT_LAG,
    ),
}


def same(system: str, hidden: str, name: str) -> bool:
    """Whether a name is the truth, or the truth in other words."""
    return bool(name) and name in words(system, hidden)


@lru_cache
def words(system: str, hidden: str) -> frozenset[str]:
    """The truth and its other words."""
    others = {other for pair in (measured(), argued()) for other in pair.get((system, hidden), ())}
    return frozenset({hidden, *others})


def argued() -> dict[tuple[str, str], tuple[str, ...]]:
    """Other words by argument; a base by Euler's rule has those of its plant."""
    found = {key: others for key, (others, _) in ARGUED.items()}
    euler = {(f"{system}-euler", hidden): others for (system, hidden), others in found.items()}
    return {**found, **euler}


@lru_cache
def measured() -> dict[tuple[str, str], tuple[str, ...]]:
    """Other words by their footprints."""
    found: dict[tuple[str, str], tuple[str, ...]] = {}
    if FILE.exists():
        with FILE.open(newline="") as file:
            for row in csv.DictReader(file):
                key = (row["system"], row["hidden"])
                found[key] = (*found.get(key, ()), row["other"])
    return found


@lru_cache
def nearest() -> dict[tuple[str, str], tuple[str, float]]:
    """The effect that wins back most of what a fault outside the catalogue costs, and the root of its share."""
    if not NEAREST.exists():
        return {}
    with NEAREST.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {(row["system"], row["hidden"]): (row["other"], float(row["cos"])) for row in rows}


def imitated(system: str, hidden: str) -> bool:
    """Whether an effect of the catalogue does nearly all that a fault outside it does."""
    return nearest().get((system, hidden), ("", 0.0))[1] > IMITATED


def likenesses(cell: Cell, kinds: Sequence[str] | None = None) -> dict[str, float]:
    """Mean |cos| of the fault's footprint with every other effect's (of these kinds), over the pilots.

    On clean series; where the effect has a time or a frequency, which a clean series does not tell, on
    series with the fault.
    """
    timed = cell.hidden.partition(":")[0] in TIMED
    found: dict[str, list[float]] = {}
    for run in range(SERIES):
        drawn = cell if timed else Cell(cell.system, CLEAN, cell.level)
        seen = _screened(drawn, run, None if kinds is None else (cell.hidden, *kinds))
        if seen is None:
            continue
        screen = seen.search.rounds[0].screen
        names = [s.effect.name for s in screen.scores]
        if cell.hidden not in names:
            continue
        at = names.index(cell.hidden)
        for i, name in enumerate(names):
            if i != at and screen.scores[i].effect.kind != "latent":
                found.setdefault(name, []).append(screen.likeness(at, i))
    return {name: float(np.mean(values)) for name, values in found.items()}


def won_back(cell: Cell, kinds: Sequence[str] | None = None) -> dict[str, float]:
    """The root of the share of a fault's likelihood ratio that each refitted effect wins back."""
    found: dict[str, list[float]] = {}
    for run in range(SERIES):
        train = series_of(cell, LARGER * size_of(cell), [PILOT, run])[0]
        fit = fit_base(cell, train)
        lost = 2.0 * (without(cell.system, cell.level, run) - fit.log_likelihood)
        causes = find_causes(
            fit.model, train, fit.theta, free=fit.free, max_effects=1, effects=kinds, seed=run
        )
        for refit in causes.search.rounds[0].refits:
            share = float(np.clip(refit.gain / lost, 0.0, 1.0))
            found.setdefault(refit.effect.name, []).append(share)
    return {name: float(np.sqrt(sum(shares) / SERIES)) for name, shares in found.items()}


@lru_cache(maxsize=16)
def _screened(cell: Cell, run: int, effects: Sequence[str] | None) -> Causes | None:
    plan = cell.plan
    train = series_of(cell, size_of(cell), [PILOT, run])[0]
    base = plan.base(cell.level)
    theta = base.theta(plan.truth(cell.level))
    try:
        free = plan.free(cell.level)
        return find_causes(
            base, train, theta, free=free, alpha=EVERY, max_effects=0, effects=effects, seed=run
        )
    except (EngineError, np.linalg.LinAlgError):
        return None


def main(arguments: list[str] | None = None) -> None:
    """Measure all, or some systems again, or as other words kinds that the catalogue got since."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.foreign.alike")
    parser.add_argument("--systems", default="", help="only these, separated by commas, made again")
    parser.add_argument("--kinds", default="", help="only these kinds as other words, made again")
    options = parser.parse_args(arguments)
    asked, kinds = (
        [text for text in given.split(",") if text] for given in (options.systems, options.kinds)
    )
    rows, near = _kept(FILE, asked, kinds), _kept(NEAREST, asked, kinds)
    for cell in every_cell():
        if not cell.hidden or (asked and cell.system not in asked):
            continue
        found = (won_back if cell.outside else likenesses)(cell, kinds or None)
        alike = sorted(((c, n) for n, c in found.items() if c > SAME), reverse=True)
        print(cell.name, cell.hidden, len(found), alike, flush=True)
        rows += [[cell.system, cell.hidden, name, f"{cos:.4f}"] for cos, name in alike]
        _write(FILE, rows)
        if cell.outside and found:
            cos, name = max((c, n) for n, c in found.items())
            near.append([cell.system, cell.hidden, name, f"{cos:.4f}"])
            _write(NEAREST, _best(near))


def _best(rows: Sequence[list[str]]) -> list[list[str]]:
    """Of each fault the effect that wins back most."""
    best: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        key = (row[0], row[1])
        if key not in best or float(row[3]) > float(best[key][3]):
            best[key] = row
    return list(best.values())


def _kept(path: Path, systems: Sequence[str], kinds: Sequence[str]) -> list[list[str]]:
    """Rows that are not made again: of other systems, or of other kinds."""
    if not ((systems or kinds) and path.exists()):
        return []
    with path.open(newline="") as file:
        rows = list(csv.reader(file))[1:]
    return [
        row
        for row in rows
        if (systems and row[0] not in systems) or (kinds and row[2].partition(":")[0] not in kinds)
    ]


def _write(path: Path, rows: Sequence[Sequence[str]]) -> None:
    with path.open("w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(["system", "hidden", "other", "cos"])
        out.writerows(sorted(map(list, rows)))


if __name__ == "__main__":
    main()
