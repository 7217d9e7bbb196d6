"""Slopes from differences to both sides, where a function may jump between them, as a sign does."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.arrays import Array

JUMP = (
    10.0  # how many times as steep one side of a row is as the other sides are where it jumps there
)


def sides(thetas: Array, indices: NDArray[np.intp]) -> tuple[Array, Array, Array]:
    """How far the neighbours of theta, see ``differences.neighbours``, lie below, above it and apart, (n,)."""
    k = np.arange(len(indices))
    low, here, high = (
        row[..., indices] for row in (thetas[1 + 2 * k], thetas[0], thetas[2 + 2 * k])
    )
    return here - low[k, k], high[k, k] - here, high[k, k] - low[k, k]


def slopes(values: Array, below: Array, above: Array, apart: Array) -> Array:
    """Slopes (T, n, ...) of values (T, 1 + 2 n, ...) at theta, then below and above it in each parameter.

    Between the two neighbours. Where a row is far steeper to one side than every row is to its flatter one, it
    jumps there, by what is no smaller over a shorter distance: the slope is that of the other side. Else one
    row in which a state changes its sign would tell a parameter a thousand times as exactly as all others do.
    """
    shape = (1, len(below), *[1] * (values.ndim - 2))
    # lost neighbours are not finite, and on a bound there is one side alone
    with np.errstate(invalid="ignore", divide="ignore"):
        central = (values[:, 2::2] - values[:, 1::2]) / apart.reshape(shape)
        left = (values[:, :1] - values[:, 1::2]) / below.reshape(shape)
        right = (values[:, 2::2] - values[:, :1]) / above.reshape(shape)
        flatter = np.where(np.abs(left) < np.abs(right), left, right)
        steeper = np.maximum(np.abs(left), np.abs(right))
        usual = np.abs(flatter).max(axis=0, initial=0.0, where=np.isfinite(flatter))
        jumps = np.isfinite(left) & np.isfinite(right) & (steeper > JUMP * usual)
    return np.where(jumps, flatter, central)
