"""Directions in which the likelihood does not fall: parameters that the data determine only together.

Differences of the score along such a direction are rounding or Monte Carlo noise, and an information matrix
kept positive turns them into standard errors that mean nothing. The moment filter's information has
no noise: where only a product b_1 b_2 enters the model, it holds nothing along (b_1, -b_2), whatever the filter
approximates. The reverse does not hold, as it is blind to what does not correlate with the readings, such as
a volatility. So what it does not hold is looked for in the score of the particles as well, and counts as
undetermined where that shows none, and knows well enough that there is next to none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from engine.estimation.likelihood_step import surely_flat
from engine.estimation.uncertainty.score import Score, shift_within
from engine.statespace.model import Array
from engine.ties import flat_directions, tied
from engine.words import enumerated

REACH = 1.0  # length of differences, in the standard errors that complete data would leave
SEEN_ERRORS = 3.0  # Monte Carlo errors by which information that particles see is above zero ...
# ... and of the complete-data one: the score bends along the direction, as theta is not quite the maximum
SEEN_SHARE = 0.015
LITTLE = 0.03  # of it, at most, is there with 2 Monte Carlo errors where there is said to be none
REPLICATES = 16  # smoothers that this takes at either end of each direction


def undetermined(score: Score, complete: Array, seed: int) -> Array:
    """Directions (n, m) of the parameters, in units of their own, that the data do not determine.

    ``complete`` (n, n) is the complete-data information at theta, of which the data hold a part at most.
    """
    found = score.likelihood.information(np.asarray(score.theta), score.indices)
    if found is None:
        return flat_directions(complete)
    flat = flat_directions(found)
    if score.exact or not flat.size:
        return flat
    along, scale, surely = surely_flat(flat, found, complete)
    seeds = np.random.SeedSequence(seed).spawn(REPLICATES)
    doubtful = ~surely
    kept = _not_seen(score, along[:, doubtful], scale[doubtful], seeds)
    return np.hstack([flat[:, surely], flat[:, doubtful] @ kept])


def tied_to_bounds(every: Score, within: NDArray[np.bool_]) -> str:
    """A sentence on parameters whose errors only hold where another stays at the bound that stopped it.

    ``within`` (n,) tells which of the score's parameters are at none. The others are held, and with them a
    direction that the data leave open seems determined.
    """
    if within.all():
        return ""
    found = every.likelihood.information(np.asarray(every.theta), every.indices)
    if found is None:
        return ""
    known = np.diag(found) > 0.0  # a variance at 0 says nothing and is tied to nothing
    flat, free = flat_directions(found[np.ix_(known, known)]), within[known]
    both = [v for v in flat.T if tied(v[free, None]).any() and tied(v[~free, None]).any()]
    if not both:
        return ""
    names, part = np.array(every.names)[known], tied(np.array(both).T)
    others, at = (enumerated([str(n) for n in names[part & side]]) for side in (free, ~free))
    return (
        f"The data only determine {others} together with {at}, at the bound: these errors hold where that "
        "bound is the true value."
    )


def _not_seen(
    score: Score, along: Array, scale: Array, seeds: Sequence[np.random.SeedSequence]
) -> Array:
    """Combinations (m, k) of the directions (n, m) along which the particles' score does not fall, either.

    ``scale`` (m,) is the complete-data information along each, were its parameters independent.
    """
    if not along.size:
        return np.zeros((0, 0))
    directions = along / np.sqrt(scale)
    G = np.array([_information(score, directions, which) for which in seeds])
    _, vectors = np.linalg.eigh(G.mean(axis=0))
    held = np.einsum("ik,rij,jk->rk", vectors, G, vectors)
    mean, error = held.mean(axis=0), held.std(axis=0, ddof=1) / np.sqrt(len(G))
    no_more_than_noise = mean <= SEEN_ERRORS * error + SEEN_SHARE
    next_to_none = np.maximum(mean, 0.0) + 2.0 * error <= LITTLE
    return np.asarray(vectors[:, no_more_than_noise & next_to_none])


def _information(score: Score, directions: Array, which: np.random.SeedSequence) -> Array:
    """D' I D (m, m) by central differences of the score along the columns of D (n, m)."""
    m = directions.shape[1]
    G = np.empty((m, m))
    for k in range(m):
        ends, lengths = [], []
        for sign in (-1.0, 1.0):
            step = sign * directions[:, k]
            length = shift_within(score.x, step, *score.bounds, REACH)
            ends.append(score.at(score.x + length * step, which)[0])
            lengths.append(length)
        G[:, k] = directions.T @ (ends[0] - ends[1]) / sum(lengths)
    return 0.5 * (G + G.T)
