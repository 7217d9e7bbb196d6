"""Whether a model reads the clock; where it does not, its records may be counted from any time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.rates import guessed_points, two_thetas
from engine.statespace.model import MixedModel

ROWS = 100  # of each record


def reads_no_clock(model: MixedModel, records: Sequence[Series], others: Sequence[Series]) -> bool:
    """Whether the model makes the same steps and readings at the times of ``others``.

    Parameters
    ----------
    model : MixedModel
        The model; it is asked at its default parameters and at others.
    records, others : sequence of Series
        The same records, on two clocks.
    """
    try:
        return all(
            _same_steps(model, model.record(theta), one, other)
            for theta in two_thetas(model)
            for one, other in zip(records, others, strict=True)
        )
    except Exception:  # noqa: BLE001 - a user's function may refuse points that are only guessed
        return False


@np.errstate(all="ignore")  # of a law that grows fast the guessed points may be too far off
def _same_steps(model: MixedModel, theta: object, one: Series, other: Series) -> bool:
    steps = np.append(one.steps, one.steps[-1:])
    points = guessed_points(model, float(np.median(steps)))
    a = np.ascontiguousarray(points.x[:, : model.na])
    for i in np.unique(np.linspace(0, len(one) - 1, ROWS).astype(int)):
        u = one.u[i]
        here, there = (
            (*model.transition(a, u, t, steps[i], theta), *model.observation(a, u, t, theta))
            for t in (float(one.t[i]), float(other.t[i]))
        )
        if not all(np.array_equal(x, y, equal_nan=True) for x, y in zip(here, there, strict=True)):
            return False
    return True
