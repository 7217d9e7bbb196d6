"""What an input does between its samples, and so over steps, within them, and over several of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.arrays import Array

HOLDS = ("zoh", "foh", "past")  # held from its sample on; a straight line; held up to its sample


def over_steps(values: Array, hold: str) -> Array:
    """Inputs (T, nu) over the step that begins at each row: the mean of a straight line."""
    if hold == "zoh" or not values.shape[1]:
        return values
    following = np.concatenate([values[1:], values[-1:]])
    return following if hold == "past" else 0.5 * (values + following)


def between(values: Array, hold: str, rows: NDArray[np.intp], share: Array) -> Array:
    """Inputs (n, nu) at a share (n,) of the way from each of the rows (n,) to the next."""
    here = np.asarray(values[rows])
    following = np.asarray(values[np.minimum(rows + 1, len(values) - 1)])
    if hold == "zoh":
        return here
    if hold == "past":
        return np.where(share[:, None] > 0.0, following, here)
    return here + share[:, None] * (following - here)


def means(values: Array, hold: str, steps: Array, rows: NDArray[np.intp]) -> Array:
    """Inputs (n, nu) from each of some rows (n,) to the next of these; ``steps`` (T-1,) are of all rows."""
    lasts = np.append(steps, steps[-1])[:, None]  # the last row begins no step
    total = np.add.reduceat(lasts * over_steps(values, hold), rows, axis=0)
    return np.asarray(total / np.add.reduceat(lasts, rows, axis=0))
