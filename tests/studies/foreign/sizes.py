"""``python -m tests.studies.foreign.sizes``: the size that gives each cell its likelihood ratio.

The ratio of a fault of the catalogue is 2 x the gain in maximised log-likelihood of the true extension,
started at the truth. That of a fault which is not is

    LR = 2 (log-likelihood of the base model fitted to the series without the fault
            - the same with the fault, all random numbers alike):

what an extension would win back that knew it. The two agree within a few units where the fault does not
change how far ahead the states can be predicted. Means over a few pilot series, whose seeds no other series
has; sizes are set once per cell and kept in ``sizes.csv``.
"""

from __future__ import annotations

import argparse
import csv
from functools import lru_cache
from pathlib import Path

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from tests.studies.blind.sizes import refit_truth
from tests.studies.foreign.cells import CLEAN, Cell, every_cell
from tests.studies.foreign.drawing import series_of, true_values

FILE = Path(__file__).with_name("sizes.csv")
PILOT = 33_000_000  # first part of the seeds
SERIES = 3
STEPS = 9
TARGET = 60.0
CLOSE = 0.35  # of the logarithm of the ratio
MOST = 4.0  # by which a size changes in a step


def fit_base(cell: Cell, series: Series) -> QuasiFit:
    """The user's model estimated on a series, from the plant's parameters."""
    base = cell.plan.base(cell.level)
    start = base.theta(cell.plan.truth(cell.level))
    return quasi_ml(base, series, start, cell.plan.free(cell.level), tolerance=0.1)


@lru_cache(maxsize=64)
def without(system: str, level: str, run: int) -> float:
    """Log-likelihood of the base model on a clean pilot."""
    cell = Cell(system, CLEAN, level)
    return fit_base(cell, series_of(cell, 0.0, [PILOT, run])[0]).log_likelihood


def ratio_of(cell: Cell, size: float, runs: int = SERIES) -> float:
    """The mean likelihood ratio at a size; NaN where no pilot could be fitted."""
    return float(np.nanmean([ratio_in(cell, size, run) for run in range(runs)]))


def ratio_in(cell: Cell, size: float, run: int) -> float:
    """The likelihood ratio in one pilot, infinite where the plant runs away or the base model is lost."""
    try:
        train, _, own = series_of(cell, size, [PILOT, run])
        fit = fit_base(cell, train)
        if not cell.outside:
            setting = setting_for(fit.model, train, np.asarray(fit.theta))
            effect = make_effect(cell.hidden, setting)
            return refit_truth(fit, train, effect, true_values(cell, effect, size, own)).gain
    except (EngineError, ArithmeticError, ValueError, np.linalg.LinAlgError):
        return np.inf
    return 2.0 * (without(cell.system, cell.level, run) - fit.log_likelihood)


def calibrated(cell: Cell) -> tuple[float, float]:
    """The size of a cell and the likelihood ratio at it, from the size there is."""
    assert cell.what is not None
    size, most = sizes().get(cell.name, cell.what.first), cell.what.most
    tried: list[tuple[float, float]] = []
    for _ in range(STEPS):
        ratio = max(ratio_of(cell, size), 1e-3)
        tried.append((size, ratio))
        if abs(np.log(ratio / TARGET)) < CLOSE:
            break
        below = max((x for x in tried if x[1] < TARGET), default=None, key=lambda x: abs(x[0]))
        above = min((x for x in tried if x[1] >= TARGET), default=None, key=lambda x: abs(x[0]))
        if below and above:
            size = between(below, above)
        else:
            factor = np.sqrt(TARGET / np.clip(ratio, 1.0, 1e6))
            size *= float(np.clip(factor, 1.0 / MOST, MOST))
        size = float(np.sign(size)) * min(abs(size), most)
        if any(np.isclose(size, x[0], rtol=1e-3) for x in tried):
            break
    return min(tried, key=lambda x: abs(np.log(x[1] / TARGET)))


def between(below: tuple[float, float], above: tuple[float, float]) -> float:
    """A size between two, by a power law through both ratios."""
    if not np.isfinite(above[1]) or below[1] < 5.0 or above[1] > 1e3:
        return float(np.sign(below[0]) * np.sqrt(below[0] * above[0]))
    share = np.log(TARGET / below[1]) / np.log(above[1] / below[1])
    share = float(np.clip(share, 0.1, 0.9))
    return float(below[0] * (above[0] / below[0]) ** share)


@lru_cache
def sizes() -> dict[str, float]:
    """Every cell's size by its name."""
    if not FILE.exists():
        return {}
    with FILE.open(newline="") as file:
        return {row["cell"]: float(row["size"]) for row in csv.DictReader(file)}


def size_of(cell: Cell) -> float:
    """The size hidden in a cell, 0 where nothing is.

    A cell that is not planned has that of the same fault at the other level, or the fault's first guess.
    """
    if cell.what is None:
        return 0.0
    same = [Cell(cell.system, cell.fault, level).name for level in cell.plan.plant.sensors]
    return next((sizes()[n] for n in (cell.name, *same) if n in sizes()), cell.what.first)


def main(arguments: list[str] | None = None) -> None:
    """Make the sizes that are missing, or those asked for again."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.foreign.sizes")
    parser.add_argument("--cells", default="", help="of these systems or cells, from what there is")
    options = parser.parse_args(arguments)
    done: dict[str, list[str]] = {}
    if FILE.exists():
        with FILE.open(newline="") as file:
            done = {row[0]: row for row in list(csv.reader(file))[1:]}
    cells = [c for c in every_cell() if c.what is not None]
    asked = [text for text in options.cells.split(",") if text]
    for cell in cells:
        if asked:
            if not any(cell.name.startswith(text) for text in asked):
                continue
        elif cell.name in done:
            continue
        size, ratio = calibrated(cell)
        done[cell.name] = [cell.name, f"{size:.5g}", f"{ratio:.4g}"]
        print(*done[cell.name], sep="  ", flush=True)
        _write([done[c.name] for c in cells if c.name in done])


def _write(rows: list[list[str]]) -> None:
    with FILE.open("w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(["cell", "size", "ratio"])
        out.writerows(rows)


if __name__ == "__main__":
    main()
