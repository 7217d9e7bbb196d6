"""Where a model cannot be had there is no likelihood; bounds that a search learns beside such places.

A user's function may take the logarithm of a noise, whose bound is 0, or the root of a difference. Where the
maximum lies there, a step of all parameters together is cut off by the one that cannot go on. It is held next
to its edge instead, while the others go on, and led closer as long as that is worth anything.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from engine.arrays import Array

SHARES = 0.5 ** np.arange(30)  # of a step, of which the largest that has a likelihood is sought
CLOSER = 0.9  # of what is left to where there is none is gone then


class Edges:
    """``lower`` and ``upper`` (n,), which narrow to where there is a likelihood."""

    def __init__(self, lower: Array, upper: Array) -> None:
        self.lower, self.upper = np.array(lower), np.array(upper)
        n = len(self.lower)
        self._lost = np.full(n, -np.inf), np.full(n, np.inf)  # beyond the edges

    def narrower_than(self, lower: Array, upper: Array) -> bool:
        """Whether some place has no likelihood between these bounds (n,), as far as was learnt."""
        return bool((self.lower > lower).any() or (self.upper < upper).any())

    def learnt(self, x: Array, direction: Array, likelihoods: Callable[[Array], Array]) -> bool:
        """Whether some components of a step from x (n,) have no likelihood by themselves; those get an edge.

        ``likelihoods`` of points (K, n) are -inf where there is none.
        """
        there = np.clip(x + direction, self.lower, self.upper)
        moving = np.flatnonzero(there != x)
        if not moving.size:
            return False
        lost = moving[np.isneginf(likelihoods(in_turn(x, moving, there[moving, None])))]
        if not lost.size:
            return False
        along = x[lost, None] + SHARES * (there - x)[lost, None]
        values = likelihoods(in_turn(x, lost, along)).reshape(along.shape)
        for k, way, last in zip(lost, along, np.argmax(np.isfinite(values), axis=1), strict=True):
            side = int(there[k] > x[k])
            self._lost[side][k] = way[max(last - 1, 0)]
            (self.lower, self.upper)[side][k] = way[last] if last else x[k]
        return True

    def closer(self, x: Array, g: Array, worth: float) -> bool:
        """Whether an edge that holds x (n,) is led closer, as what is left by the slope g (n,) is worth it."""
        up = g > 0.0
        held = np.where(up, x >= self.upper, x <= self.lower)
        left = np.where(up, self._lost[1], self._lost[0]) - x
        with np.errstate(invalid="ignore"):
            more = np.flatnonzero(held & np.isfinite(left) & (g * left > worth))
        for k in more:
            (self.lower, self.upper)[int(up[k])][k] = x[k] + CLOSER * left[k]
        return bool(more.size)


def in_turn(x: Array, which: NDArray[np.intp], values: Array) -> Array:
    """x (n,) with one of the components ``which`` at one of its values (m, K), in turn (m K, n)."""
    out = np.tile(x, (values.size, 1))
    out[np.arange(values.size), np.repeat(which, values.shape[1])] = values.ravel()
    return out
