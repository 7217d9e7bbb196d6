"""Theta with one of its parameters less and more: between such filters slopes are taken."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.estimation.expectation import either_side
from engine.filters.sigma_point import MomentFiltered
from engine.statespace.model import Array, MixedModel

DIFFERENCE = 1e-4  # of a parameter's scale, for central differences
ONE_SIDED = 1e-6  # of it, where a bound leaves one side
EVEN = 0.999  # of one side's step, from which the other is as long
SMALL = 0.01  # of a value, up to which a step is small beside it


def neighbours(model: MixedModel, theta: Array, indices: NDArray[np.intp]) -> Array:
    """Rows theta, then theta -+ a step in each free parameter (1 + 2 n, n_theta)."""
    thetas = [np.array(theta)]
    for k in indices:
        thetas += _beside(model, theta, int(k))
    return np.array(thetas)


def _beside(model: MixedModel, theta: Array, k: int) -> tuple[Array, Array]:
    """Theta with parameter k less and more, as far on both sides where its bounds leave room.

    On one side of a bound a difference is wrong by the step, not by its square. Where other parameters do
    the same as this one, what that leaves of the direction between them was taken for information. A noise
    next to 0 keeps the long step, which sees whether more of it is likelier.
    """
    low, high = either_side(model, theta, k, DIFFERENCE)
    near, far = sorted((theta[k] - low[k], high[k] - theta[k]))
    if near > EVEN * far or far > SMALL * abs(theta[k]):
        return low, high
    if near * DIFFERENCE < far * ONE_SIDED:
        return either_side(model, theta, k, ONE_SIDED)
    low[k] = max(theta[k] - near, model.lower[k])
    high[k] = min(theta[k] + near, model.upper[k])
    return low, high


def alive(filtered: MomentFiltered, thetas: Array) -> tuple[MomentFiltered, Array]:
    """Filters at ``thetas``, see :func:`neighbours`, and these, with theta for those that have no likelihood.

    So slopes are those of the other side, as at the edge of where a model can be had. Where that is lost as
    well, or theta itself, the two are no distance apart.
    """
    lost = ~np.isfinite(filtered.log_likelihood)
    if not lost.any():
        return filtered, thetas
    there = filtered.of(np.where(lost, 0, np.arange(len(thetas))))
    return there, np.where(lost[:, None], thetas[0], thetas)
