"""Readings that a slow channel repeats until it has a new one: they look like more than were taken.

A model takes each for a reading with noise of its own. What was read is then late by up to as many rows, and
its noise lasts: a delay, a wave and noise that changes were found in a record with nothing wrong in it.
"""

from __future__ import annotations

import numpy as np

from engine.arrays import Array
from engine.data.lattice import lattice_step

FEWEST_RUNS = 20  # without which nobody knows how long a value usually stays
USUAL = 0.9  # share of the rows in runs as long as the others, but for a row: what clips has some long ones
MEAN = 1.4  # rows: rounding so coarse that it alone repeats as many moves by less than MOVE
MOVE = 5.0  # steps of the lattice: what moves by fewer repeats itself as it is rounded


def repeated(name: str, y: Array) -> list[str]:
    """A sentence where readings y (T,) come in runs of equal ones that are all as long as each other."""
    seen = y[~np.isnan(y)]
    changes = np.diff(seen)
    starts = np.flatnonzero(changes) + 1
    lengths = np.diff(starts)  # of whole runs only: the first and the last may be cut
    if len(lengths) < FEWEST_RUNS or lengths.mean() < MEAN:
        return []
    usual = int(np.median(lengths))
    near = (
        max(lengths[np.isin(lengths, (k, k + 1))].sum() for k in (usual - 1, usual)) / lengths.sum()
    )
    step = lattice_step(seen)
    moves = np.median(np.abs(changes[changes != 0.0]))
    if near < USUAL or (step is not None and moves < MOVE * step):
        return []
    rows = f"{usual}" if (lengths == usual).mean() >= USUAL else f"{lengths.mean():.1f}"
    return [
        f"Output {name} gives each reading for {rows} rows on end: a slow channel, whose last value is "
        "repeated? Then leave out all but the first of each (NaN, or an empty cell): the others are no "
        "readings, and what is late or lasts in them may be found as a cause."
    ]
