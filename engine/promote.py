"""Move linear states among the nonlinear ones, so that a nonlinear function of them can be added."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from engine.errors import OptionError
from engine.model import Array, Gaussian, MixedModel


def promote(model: MixedModel, names: Sequence[str]) -> MixedModel:
    """The same model with the linear states ``names`` appended to its nonlinear ones.

    p(a_1) must be Gaussian; z_{1|0} and P_{1|0} are taken at its mean. States that are nonlinear
    already are left where they are. Raises OptionError for an unknown state.
    """
    for name in names:
        if name not in model.nonlinear and name not in model.linear:
            raise OptionError(
                f"model '{model.name}' has no state '{name}'; it has "
                f"{', '.join([*model.nonlinear, *model.linear])}",
                "effects",
            )
    moved = [name for name in model.linear if name in names]
    if not moved:
        return model
    na, nz = model.na, model.nz
    linear = list(model.linear)
    out = np.array([linear.index(name) for name in moved])
    stay = np.array([i for i in range(nz) if i not in out], dtype=int)
    order = np.concatenate([np.arange(na), na + out, na + stay])

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        f, A, Q = model.transition(a[:, :na], u, t, dt, theta)
        f = f + _times(A.take(out, -1), a[:, na:])
        A, Q = A.take(order, -2).take(stay, -1), Q.take(order, -2).take(order, -1)
        return f.take(order, 1), A, Q

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        h, C, R = model.observation(a[:, :na], u, t, theta)
        return h + _times(C.take(out, -1), a[:, na:]), C.take(stay, -1), R

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        start = model.start(theta)
        if not isinstance(start.density, Gaussian):
            raise OptionError(
                f"model '{model.name}': p(a_1) is not Gaussian, so '{moved[0]}' cannot be made a "
                "nonlinear state; write it as one in the model",
                "effects",
            )
        mean, cov = start.density.mean, start.density.cov
        z1, P1 = start.linear(mean[None])
        z, P = z1[0], P1 if P1.ndim == 2 else P1[0]
        full = np.zeros((na + len(out), na + len(out)))
        full[:na, :na], full[na:, na:] = cov, P[np.ix_(out, out)]
        density = Gaussian(np.concatenate([mean, z[out]]), full)
        # what is left of z_1 given the moved part: Gaussian conditioning, report, Theorem A.1
        gain = P[np.ix_(stay, out)] @ np.linalg.pinv(P[np.ix_(out, out)], hermitian=True)
        rest = P[np.ix_(stay, stay)] - gain @ P[np.ix_(out, stay)]
        return density, lambda a: z[stay] + (a[:, na:] - z[out]) @ gain.T, rest

    return replace(
        model,
        nonlinear={**model.nonlinear, **{name: model.linear[name] for name in moved}},
        linear={linear[i]: model.linear[linear[i]] for i in stay},
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
    )


def _times(A: Array, a: Array) -> Array:
    """A a per particle: A (n, k) or (M, n, k), a (M, k) -> (M, n)."""
    if A.ndim == 2:
        common: Array = a @ A.T
        return common
    each: Array = np.einsum("mnk,mk->mn", A, a)
    return each
