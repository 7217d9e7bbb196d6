"""Which parameters are of the noise alone, and what they have in common with others.

A noise parameter changes the gain of the filter, and so its innovations by z_q, a sum of past innovations that
has mean zero. What z_q has in common with a direction that inputs drive, sum over t of z_k z_q, is chance: its
expectation, the information, is zero, and where few independent readings tell of slow noise the sum is far from
it. Projected out as if it were information it takes a direction's own with it, and what is left of a right
model looks larger than it is. Of a direction that noise drives the sum is information: states that nothing
but noise moves are the usual case.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from engine.arrays import Array
from engine.data.series import Series
from engine.diagnose.screening.score_columns import Column, along_path
from engine.errors import EngineError
from engine.estimation.expectation import either_side
from engine.estimation.quasi_ml import QuasiFit
from engine.filters.sigma_point import MomentPath, moment_path
from engine.statespace.model import MixedModel

DIFFERENCE = 0.01  # of a parameter's scale, by which it is moved
# of what along_path returns
MEANS = NEXT, READING, FIRST = (0, 2, 5)
LATER = (NEXT, READING)


@np.errstate(all="ignore")  # beside theta
def noise_only(
    model: MixedModel,
    theta: Array,
    indices: NDArray[np.intp],
    series: Series,
    path: MomentPath,
    means: Sequence[int] = MEANS,
) -> NDArray[np.bool_]:
    """Which of the parameters ``indices`` (n,) change no mean of a step from where the filter was, (n,).

    Where the model cannot be used beside theta they count as ones that do. ``means`` tells which are looked at;
    a step to where another record begins is one of its first state.
    """
    begun = [] if FIRST in means else [row - 1 for row in series.begins]

    def looked_at(at: Array) -> list[Array]:
        moved = along_path(model, at, model, series, path)
        return [np.delete(moved[m], begun, axis=0) if m == NEXT else moved[m] for m in means]

    here = looked_at(theta)
    out = np.zeros(len(indices), dtype=bool)
    for i, k in enumerate(indices):
        ends = either_side(model, theta, int(k), DIFFERENCE)
        try:
            moved = [looked_at(end) for end in ends]
        except (EngineError, np.linalg.LinAlgError):
            continue
        out[i] = all(np.array_equal(x, y) for one in moved for x, y in zip(here, one, strict=True))
    return out


def noise_of(fit: QuasiFit, series: Series) -> NDArray[np.bool_]:
    """Which of a fit's free parameters are of the noise alone (n_free,)."""
    model, theta = fit.model, np.asarray(fit.theta)
    path = moment_path(model, theta, series)
    return noise_only(model, theta, model.free_indices(fit.free), series, path)


def moves_on(fit: QuasiFit, series: Series) -> NDArray[np.bool_]:
    """Which of a fit's free parameters change a mean after the first state (n_free,)."""
    model, theta = fit.model, np.asarray(fit.theta)
    path = moment_path(model, theta, series)
    return ~noise_only(model, theta, model.free_indices(fit.free), series, path, LATER)


def noise_left_to_states(fit: QuasiFit, series: Series) -> str:
    """A sentence where a fit leaves nothing to the noise of readings, and so all to that of states; else ""."""
    model, theta = fit.model, np.asarray(fit.theta)
    free = model.free_indices(fit.free)
    path = moment_path(model, theta, series)
    names = [
        (
            model.parameter_names[k],
            theta[k] <= model.lower[k],
            *_covariances(model, theta, k, series, path),
        )
        for k in free[noise_only(model, theta, free, series, path)].tolist()
    ]
    readings = [name for name, low, x, y in names if low and y and not x]
    states = [name for name, low, x, _ in names if x and not low]
    if not readings or not states:
        return ""
    return (
        f"The noise of readings was estimated at its bound ({', '.join(readings)}): whatever the model "
        f"gets wrong counts as noise of the states ({', '.join(states)}), which may hide a cause. Where the "
        "noise of the sensor is known, from its data sheet or from a record at rest, hold it there (theta=, "
        "free=) and ask again."
    )


def inside(
    model: MixedModel, theta: Array, indices: NDArray[np.intp], series: Series, path: MomentPath
) -> NDArray[np.intp]:
    """The parameters ``indices`` but those of the noise that stand at a bound.

    There their score is not zero: the likelihood would go on to less noise than there can be. Projected out it
    would be counted for, or against, an effect.
    """
    value = theta[indices]
    bound = (value <= model.lower[indices]) | (value >= model.upper[indices])
    if not bound.any():
        return indices
    out = bound.copy()
    out[bound] = noise_only(model, theta, indices[bound], series, path)
    return np.asarray(indices[~out])


def apart(columns: Sequence[Column], noise: NDArray[np.bool_], readings: int) -> list[Column]:
    """Columns whose noise parameters have innovations of their own; ``readings`` T ny come first in v."""
    out = []
    for column, own in zip(columns, noise, strict=True):
        z, E = column.v[:readings], column.v[readings:]
        none = np.zeros(readings)
        out.append(Column(column.s, np.concatenate([none, E, z] if own else [z, E, none])))
    return out


@np.errstate(all="ignore")  # beside theta
def _covariances(
    model: MixedModel, theta: Array, k: int, series: Series, path: MomentPath
) -> tuple[bool, bool]:
    """Whether parameter k changes covariances of states a step on, and whether those of readings."""
    ends = either_side(model, theta, k, DIFFERENCE)
    one, other = (along_path(model, end, model, series, path) for end in ends)
    return not np.array_equal(one[1], other[1]), not np.array_equal(one[3], other[3])
