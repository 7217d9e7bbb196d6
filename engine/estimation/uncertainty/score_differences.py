"""The observed information by central differences of the score, without what a curved ridge adds to them.

Where parameters lie on a curved ridge, half a standard error along a straight line leaves it, and differences
show more information than there is at theta. Scores without noise are differenced over far less; from
particles' differences is taken what the moment filter sees too much over their reach.
"""

from __future__ import annotations

import numpy as np

from engine.estimation.uncertainty.roots import floored_inverse, good_guess, symmetric_root
from engine.estimation.uncertainty.score import Score, shift_within
from engine.failing import where_it_fails
from engine.statespace.model import Array

# Length of the differences in standard errors: further out the curvature differs, and nearer noise is larger.
REACH_ERRORS = 0.5
EXACT_REACH = 0.03  # without noise: along a curved ridge half an error already leaves it
EVEN_NEARER = 0.01  # of differences of a log-likelihood that give a score
# Of the information, by how much more of it is seen over REACH_ERRORS: less is left alone.
BENT = 0.05


def whitened_information(score: Score, L: Array, which: np.random.SeedSequence) -> Array:
    """L' I L from central differences of the score along the columns of L, clipped to the bounds.

    Where it is exact it is that of the log-likelihood, which is had for many parameters at once. Theta stands
    for an end where the model cannot be had; NaN where it does for both.
    """
    ends, lengths = _ends(score, L, EXACT_REACH if score.exact else REACH_ERRORS)
    if score.exact:
        found = _by_values(score, L, ends, lengths)
        if np.isfinite(found).all() and good_guess(found):
            return found
    nothing = np.full(len(score.x), np.nan), np.empty((0, 0))
    at = where_it_fails(nothing)(score.at)
    slopes = np.array([[at(x, which)[0] for x in side] for side in ends])
    lost = ~np.isfinite(slopes).all(axis=2)
    if lost.any():
        slopes[lost], lengths[lost] = score.at(score.x, which)[0], 0.0
    with np.errstate(invalid="ignore"):
        G: Array = (slopes[0] - slopes[1]) @ L / lengths.sum(axis=0)[:, None]
    return 0.5 * (G + G.T)


@np.errstate(divide="ignore", invalid="ignore")  # of a parameter at its bound
def _by_values(score: Score, L: Array, ends: Array, lengths: Array) -> Array:
    """L' I L as above, the score along each column by differences of log-likelihoods."""
    points, step = ends[:, :, None], EVEN_NEARER * L.T
    low, high = score.values(points + step) - score.values(points - step)
    G: Array = (low - high) / (2.0 * EVEN_NEARER * lengths.sum(axis=0)[:, None])
    return 0.5 * (G + G.T)


def _ends(score: Score, L: Array, reach: float) -> tuple[Array, Array]:
    """Points (2, n, n) to either side of theta along the columns of L, and how far they are (2, n)."""
    x, sides = score.x, np.array([-L.T, L.T])
    lengths = np.array(
        [[shift_within(x, step, *score.bounds, reach) for step in side] for side in sides]
    )
    return x + lengths[:, :, None] * sides, lengths


@np.errstate(divide="ignore", invalid="ignore")  # of a parameter at its bound
def bend_of(score: Score, L: Array, held: Array | None = None) -> Array:
    """By how much differences over the particles' reach show too much of L' I L, by the moment filter.

    Zero where that sees hardly any more so far out, or is no guide: it is far from what is ``held`` (n, n) over
    that reach, or, where that is not given, from the identity next to theta.
    """
    none = np.zeros_like(L)
    if score.exact:
        return none
    beside = [_ends(score, L, reach) for reach in (EXACT_REACH, REACH_ERRORS)]
    top = score.values(score.x)
    first, second = (
        2.0 * ((top - score.values(at)) / lengths).sum(axis=0) / lengths.sum(axis=0)
        for at, lengths in beside
    )
    # second differences of a value show half of the bend that differences of its slope do
    if not np.abs(2.0 * (second - first)).max() > BENT:  # nor where they are not finite
        return none
    seen = [_by_values(score, L, at, lengths) for at, lengths in beside]
    if not np.isfinite(seen).all():
        return none
    near, far = seen
    root = None if held is None else symmetric_root(floored_inverse(held))
    return far - near if good_guess(near if root is None else root @ far @ root) else none
