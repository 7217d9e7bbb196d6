"""Fewer points of long curves, with their extremes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def keep(curves: Array, points: int) -> NDArray[np.intp]:
    """Rows of curves (n, c) to draw: the first, the last, and each bucket's extremes; sorted."""
    n, c = curves.shape
    if n <= points:
        return np.arange(n)
    buckets = max(1, (points - 2) // (2 * max(c, 1)))
    rows = {0, n - 1}
    for part in np.array_split(np.arange(n), buckets):
        values = curves[part]
        rows.update(part[np.where(np.isnan(values), np.inf, values).argmin(axis=0)].tolist())
        rows.update(part[np.where(np.isnan(values), -np.inf, values).argmax(axis=0)].tolist())
    return np.array(sorted(rows))
