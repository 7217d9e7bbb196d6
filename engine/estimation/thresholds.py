"""Parameters that move a place in the states where the model jumps, such as the level of a relay.

A trajectory on one side of such a place says nothing of where it is. So the slope of its density, of which
Fisher's identity makes the score, leaves out what the likelihood gains where a state changes sides: that of
such a parameter is wrong, or 0. Points of the moment filter tell no more.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.errors import ModelError
from engine.estimation.expectation import either_side
from engine.filters.rbpf import rbpf
from engine.statespace.model import Array, MixedModel, Theta
from engine.statespace.points import Points

SHARES = (0.1, 0.0125)  # of a parameter's size, over which changes are compared
LONGER = 2.8  # times, at least: at a bound both steps may be cut to what is left
KEPT = 0.6  # of the change over the longer step: a jump is as high over the shorter one, a root 0.35 of it
SEEN = 1e-6  # of the largest value: less is rounding
POINTS = 4000  # of all particles, about as many
FAILURES = (ModelError, ArithmeticError, ValueError, np.linalg.LinAlgError)


@np.errstate(all="ignore")
def jumping(
    model: MixedModel,
    theta: Theta,
    all_series: Sequence[Series],
    indices: NDArray[np.intp],
    n_particles: int,
) -> NDArray[np.bool_]:
    """Which of the parameters ``indices`` (n,) move a jump of the model, where particles are at theta.

    None where these cannot be had, or where the model fails beside theta.
    """
    found = np.zeros(len(indices), dtype=bool)
    if not model.na:
        return found
    share = max(1, -(-sum(map(len, all_series)) * n_particles // POINTS))
    for one in all_series:
        try:
            every = rbpf(model, theta, one, n_particles, 0).a
            points = Points(model, one, every[:, :: min(share, n_particles)])
            here = _values(points, np.asarray(theta))
            for i in np.flatnonzero(~found):
                found[i] = _jumps(points, here, np.asarray(theta), int(indices[i]))
        except FAILURES:
            continue
    return found


def _jumps(points: Points, here: Sequence[Array], theta: Array, k: int) -> bool:
    """Whether some value of the model changes hardly less over a far shorter step in parameter k."""
    ends = [either_side(points.model, theta, k, share) for share in SHARES]
    for both in zip(*ends, strict=True):
        far_off, near_by = (abs(end[k] - theta[k]) for end in both)
        if far_off < LONGER * near_by:
            continue
        far, near = (
            [
                np.abs(there - now).max(axis=(0, 1), initial=0.0)
                for there, now in zip(_values(points, end), here, strict=True)
            ]
            for end in both
        )
        for long, short, now in zip(far, near, here, strict=True):
            seen = short > SEEN * np.abs(now).max(axis=(0, 1), initial=0.0)
            if (seen & (short > KEPT * long)).any():
                return True
    return False


def _values(points: Points, theta: Array) -> list[Array]:
    """f, A, Q, h, C, R at all points (T', N', ...)."""
    record = points.model.record(theta)
    return [*points.transition(record), *points.observation(record)]
