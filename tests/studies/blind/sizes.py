"""``python -m tests.studies.blind.sizes``: the size that gives each cell its likelihood ratio.

The ratio of a cell is 2 x the mean gain in maximised log-likelihood of the true extension. Sizes are
set once per cell from series of their own and kept in ``sizes.csv``.
"""

from __future__ import annotations

import csv
import multiprocessing
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import lru_cache
from pathlib import Path

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.refits.refit import refit
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.screening.screen import Score
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.statespace.model import Array
from tests.studies.blind.bases import BASES
from tests.studies.blind.cells import (
    HARD,
    OTHER,
    UNLISTED,
    USUAL,
    USUAL_RATIO,
    USUAL_ROWS,
    Cell,
)
from tests.studies.blind.hidden import Hidden, draw
from tests.studies.runner import THREADS

FILE = Path(__file__).with_name("sizes.csv")
SEED = 20_000_000  # apart from every series that is judged
SERIES = 14  # per step of the search: the information differs much between series
LONG_SERIES = 4  # of more rows than usual
STEPS = 7
CLOSE = 0.15  # of the logarithm of the ratio: near enough to stop
MOST = 4.0  # by which a size changes in a step


def refit_truth(
    fit: QuasiFit, series: Series, effect: Effect, own: Sequence[float] | Array
) -> Refit:
    """The true extension with the parameters, refitted from the true values."""
    size, *at = (float(x) for x in own)
    return refit(fit, series, Score(effect, 0.0, size, 1.0, 1.0, 1.0, tuple(at)))


def fit_base(cell: Cell, series: Series) -> QuasiFit:
    """The base model estimated on a series, from its true parameters."""
    base = BASES[cell.base]
    return quasi_ml(base.model, series, base.model.theta(), base.free)


def mean_gain(cell: Cell, size: float, seed: int) -> float:
    """The likelihood ratio of a size, from a few series."""
    series = SERIES if cell.rows <= USUAL_ROWS else LONG_SERIES
    gains = []
    for k in range(series):
        try:
            hidden: Hidden = draw(cell, size, np.random.default_rng([SEED, seed, k]))
            if hidden.effect is None:
                raise ValueError(f"{cell.name} has no true extension")
            fit = fit_base(cell, hidden.train)
            gains.append(refit_truth(fit, hidden.train, hidden.effect, hidden.own).gain)
        except (EngineError, np.linalg.LinAlgError):
            continue
    return float(np.mean(gains)) if gains else np.inf


def size_of(cell: Cell, start: float, seed: int) -> tuple[float, float]:
    """The size of a cell and the likelihood ratio measured at it."""
    power = 1.0 if cell.effect.startswith("heavy-tails") else 2.0  # of the size, in the ratio
    tried: list[tuple[float, float]] = []
    size = start
    for _ in range(STEPS):
        ratio = max(mean_gain(cell, size, seed), 1e-3)
        tried.append((size, ratio))
        if abs(np.log(ratio / cell.ratio)) < CLOSE:
            break
        below = max((x for x in tried if x[1] < cell.ratio), default=None)
        above = min((x for x in tried if x[1] >= cell.ratio), default=None)
        if below and above:
            size = float(np.sqrt(below[0] * above[0]))
        else:
            factor = (cell.ratio / max(ratio, 1.0)) ** (1.0 / power)
            size *= float(np.clip(factor, 1.0 / MOST, MOST))
    return min(tried, key=lambda x: abs(np.log(x[1] / cell.ratio)))


def first_size(cell: Cell) -> float:
    """From the curvature of the likelihood ratio at a small size, on one clean series."""
    if cell.effect.startswith("heavy-tails"):
        return 0.02
    hidden = draw(cell, 0.0, np.random.default_rng([SEED, 99]))
    if hidden.effect is None:
        return 1.0
    fit = fit_base(cell, hidden.train)
    found = refit_truth(fit, hidden.train, hidden.effect, [1e-6, *hidden.own[1:]])
    error = found.standard_error
    return float(np.sqrt(cell.ratio) * error) if 0.0 < error < 1e6 else 0.1


def work(cell: Cell, start: float | None) -> tuple[str, float, float]:
    """Name, size and measured ratio; from a first size where there is one."""
    cells = [*USUAL, *HARD, *OTHER, *UNLISTED]
    size, ratio = size_of(cell, start or first_size(cell), cells.index(cell))
    return cell.name, size, ratio


def scaled(cell: Cell, known: dict[str, float]) -> float | None:
    """A first size from that of the same effect at the usual ratio and length."""
    size = known.get(Cell(cell.base, cell.effect).name)
    if size is None:
        return None
    return size * float(np.sqrt(cell.ratio / USUAL_RATIO * USUAL_ROWS / cell.rows))


@lru_cache
def sizes() -> dict[str, float]:
    """Every cell's size by its name."""
    with FILE.open(newline="") as file:
        return {row["cell"]: float(row["size"]) for row in csv.DictReader(file)}


def size(cell: Cell) -> float:
    """The size hidden in a cell; 0 where nothing is, or what has no size. KeyError: not yet made."""
    return sizes()[cell.name] if cell.effect and cell.effect != "outside:play" else 0.0


def main() -> None:
    """Make the sizes that are missing."""
    done: dict[str, list[str]] = {}
    if FILE.exists():
        with FILE.open(newline="") as file:
            done = {row[0]: row for row in list(csv.reader(file))[1:]}
    cells = [c for c in [*USUAL, *HARD, *OTHER, *UNLISTED] if c.effect != "outside:play"]
    for name in THREADS:
        os.environ.setdefault(name, "1")
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(os.cpu_count(), mp_context=context) as pool:
        for batch in ([*USUAL, *HARD], [*OTHER, *UNLISTED]):
            known = {name: float(row[1]) for name, row in done.items()}
            left = [c for c in batch if c in cells and c.name not in done]
            waiting = [pool.submit(work, c, scaled(c, known)) for c in left]
            for future in as_completed(waiting):
                name, size, ratio = future.result()
                done[name] = [name, f"{size:.6g}", f"{ratio:.4g}"]
                print(*done[name], sep="  ", flush=True)
                _write([done[c.name] for c in cells if c.name in done])


def _write(rows: list[list[str]]) -> None:
    with FILE.open("w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(["cell", "size", "ratio"])
        out.writerows(rows)


if __name__ == "__main__":
    main()
