"""Whether a model can be had: whether its functions return numbers at parameters, and at states.

Where it cannot be had at parameters, slopes are those of the other side, and what is drawn comes from there.
Where it cannot be at states, whoever wrote it is told where.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.failing import where_it_fails
from engine.statespace.model import Array, MixedModel
from engine.words import enumerated, with_unit


@np.errstate(all="ignore")
@where_it_fails(np.zeros(1, dtype=bool))
def can_be_had(
    model: MixedModel, record: Any, a: Array, u: Array, t: float, dt: float
) -> NDArray[np.bool_]:
    """At each nonlinear state a (n, na), with the parameters of a record: one for all, or one for each (n,)."""
    n = len(a)
    values = (*model.transition(a, u, t, dt, record), *model.observation(a, u, t, record))
    out = np.ones(n, dtype=bool)
    for value, own in zip(values, (1, 2, 2) * 2, strict=True):  # each (n, ...), or common to all
        finite = np.isfinite(value)
        out &= finite.all() if value.ndim == own else finite.reshape(n, -1).all(axis=1)
    return out


def first_that_can_be_had(
    model: MixedModel, thetas: Iterable[Array], a: Array, u: Array, t: float, dt: float
) -> Array | None:
    """The first of some parameters (n_theta,), within their bounds, at which a model can be had, or None."""
    for theta in thetas:
        inside = np.clip(theta, model.lower, model.upper)
        if can_be_had(model, model.record(inside), a, u, t, dt).all():
            return np.asarray(inside)
    return None


def no_number(model: MixedModel, name: str, a: Array, values: tuple[Array, Array, Array]) -> str:
    """A sentence where a function of the model has NaN among its ``values`` at states a (n, na); else ""."""
    n = len(a)
    if not (model.na and n):
        return ""
    # those of each state, not common to all
    own = [values[0], *(one for one in values[1:] if one.ndim == 3 and len(one) == n)]
    lost = np.any([np.isnan(value).reshape(n, -1).any(axis=1) for value in own], axis=0)
    lost &= np.isfinite(a).all(axis=1)
    if not lost.any():
        return ""
    states = [
        f"{state} = {with_unit(value, unit)}"
        for (state, unit), value in zip(model.nonlinear.items(), a[lost][0].tolist(), strict=True)
    ]
    return (
        f"At {enumerated(states)} its {name} has no number, as a root or a logarithm of something below zero "
        "has none, nor a difference of what overflows. Where a run or a filter may get there, say what holds "
        "there, as in np.sqrt(np.maximum(a[:, 0], 0.0)), or take the state's logarithm for the state"
    )
