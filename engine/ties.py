"""Directions of parameters that data do not determine: what is known of one parameter depends on others.

Information scaled to a unit diagonal is free of units, and so are its eigenvalues: 1 - r for two parameters
whose correlation is r. Where one of them is no more than differences and rounding leave, no data of this kind
tell the parameters of its eigenvector apart, and inverses of the information are numbers without a meaning.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr
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
