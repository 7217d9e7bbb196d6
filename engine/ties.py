"""Directions of parameters that data do not determine: what is known of one parameter depends on others.

Information scaled to a unit diagonal is free of units, and so are its eigenvalues: 1 - r for two parameters
whose correlation is r. Where one of them is no more than differences and rounding leave, no data of this kind
tell the parameters of its eigenvector apart, and inverses of the information are numbers without a meaning.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr
from scipy.optimize import linprog
from scipy.sparse.csgraph import connected_components

from engine.arrays import Array

FLAT = 1e-4  # a direction whose derivatives are this much weaker than the strongest is lost in differences
TIED = 0.003  # share of such directions from which a parameter is only determined with others: less is rounding


def flat_directions(information: Array) -> Array:
    """Directions (n, m) that the information (n, n) does not hold, orthonormal where its diagonal is 1.

    A parameter on which there is none is a direction by itself.
    """
    diagonal = np.diag(information)
    known = diagonal > 0.0
    d = np.where(known, 1.0 / np.sqrt(np.where(known, diagonal, 1.0)), 0.0)
    values, vectors = np.linalg.eigh(information * d[:, None] * d)
    return np.asarray(vectors[:, values < FLAT**2 * values.max(initial=1.0)])


def scaled_inverse(matrix: Array) -> Array:
    """The inverse of an information or covariance (n, n), with a unit diagonal: units may be far apart."""
    scale = np.sqrt(np.diag(matrix))
    both = scale[:, None] * scale
    return np.asarray(np.linalg.inv(matrix / both) / both)


def tied(directions: Array) -> NDArray[np.bool_]:
    """Which parameters (n,) have a part in the directions (n, m): nothing can be said of one alone."""
    return np.asarray(np.linalg.norm(directions, axis=1) > TIED)


def to_hold(directions: Array) -> NDArray[np.intp]:
    """As many parameters as there are directions (n, m), without which the others are determined."""
    if not directions.size:
        return np.zeros(0, dtype=np.intp)
    pivots = qr(directions.T, mode="r", pivoting=True)[1]
    return np.sort(pivots[: directions.shape[1]]).astype(np.intp)


def is_open(values: Array, errors: Array, least: float) -> NDArray[np.bool_]:
    """Which values (n,) are less than ``least`` standard errors (n,) from 0; none that is 0 itself."""
    return np.asarray((values != 0.0) & ~(np.abs(values) >= least * errors))


def held_as_open(
    values: Array, may: NDArray[np.bool_], errors: Callable[[list[int]], Array], least: float
) -> list[int]:
    """Positions of parameters (n,) without which those that ``may`` be held are no longer open.

    The most open first. ``errors(held)`` are the standard errors (n,) with some held, which are not looked at.
    """
    held: list[int] = []
    while True:
        now = errors(held)
        left = may & is_open(values, now, least)
        left[held] = False
        if not left.any():
            return held
        share = np.where(left, now / np.where(left, np.abs(values), 1.0), -np.inf)
        held.append(int(np.argmax(share)))


def ties_in_words(names: Sequence[str], directions: Array) -> str:
    """Which of the first parameters of the directions (n, m), named ``names``, are tied, and what to do.

    What follows them, such as first states, cannot be held. Empty where nothing is tied.
    """
    shares = directions[tied(directions)]
    where = np.flatnonzero(tied(directions))
    together = np.abs(shares @ shares.T) > TIED**2
    groups, of = connected_components(together, directed=False)
    out, lost = [], []
    for k in range(groups):
        own = where[of == k]
        count = max(round(float((directions[own] ** 2).sum())), 1)
        found = [names[i] for i in own if i < len(names)]
        if found and count < len(found):
            many = "one" if count == 1 else str(count)
            out.append(f"Only determined together, keep {many} of them fixed: {', '.join(found)}.")
        else:
            lost += found
    if lost:
        out.append(f"Not determined by these data, keep fixed: {', '.join(lost)}.")
    return " ".join(out)


@dataclass(frozen=True, eq=False)
class Ties:
    """What data only determine together: parameters ``names`` (n,), along ``directions`` (n or more, m)."""

    names: Sequence[str] = ()
    directions: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def in_words(self) -> str:
        """A sentence, with what to do; empty where nothing is tied."""
        return ties_in_words(self.names, self.directions)

    def held(self, sides: Mapping[str, int]) -> dict[str, int]:
        """Those parameters at bounds (1 at the upper, -1 at the lower) that the data hold there.

        Where others make up for what a parameter does, it may as well be inside, so that the data do not draw
        it to its bound. That others at bounds leave no room for this is seen.
        """
        V = self.directions
        at = [i for i, name in enumerate(self.names) if name in sides]
        if not (at and V.size):
            return dict(sides)
        outward = np.array([[sides[self.names[i]]] for i in at]) * V[at]
        alone = np.linalg.norm(V[at], axis=1) ** 2 > 1.0 - TIED**2  # nothing is known of it: no tie
        loose = {
            self.names[i]
            for i, row, unknown in zip(at, outward, alone, strict=True)
            if not unknown and _leaves(row, outward)
        }
        return {name: side for name, side in sides.items() if name not in loose}


def _leaves(row: Array, outward: Array) -> bool:
    """Whether some combination of directions moves one parameter inwards and none ``outward`` (k, m)."""
    found = linprog(row, A_ub=outward, b_ub=np.zeros(len(outward)), bounds=(-1.0, 1.0))
    return bool(found.status == 0 and float(found.fun or 0.0) < -TIED)
