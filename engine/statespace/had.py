"""Whether a model can be had at parameters: whether its functions return numbers there.

Where it cannot be had, slopes are those of the other side, and what is drawn comes from there.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.failing import where_it_fails
from engine.statespace.model import Array, MixedModel


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
