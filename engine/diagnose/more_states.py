"""Extensions of a model by a state of the effect's own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from engine.diagnose.effect import Split, on_base
from engine.model import Array, Gaussian, MixedModel


def add_linear_state(
    model: MixedModel,
    split: Split,
    name: str,
    unit: str,
    dynamics: Any,
    variance: Callable[[Any], float] = lambda own: 0.0,
    **functions: Any,
) -> MixedModel:
    """The model with one more linear state, zero at first up to ``variance(own parameters)``."""
    na = model.na

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        own_base, own = split(theta)
        start = model.start(own_base)

        def z1(a: Array) -> Array:
            z, _ = start.linear(a[:, :na])
            return np.concatenate([z, np.zeros((len(a), 1))], axis=1)

        _, P = start.linear(np.zeros((1, na)))
        if P.ndim == 3:
            P = P[0]
        P_all = np.zeros((model.nz + 1, model.nz + 1))
        P_all[:-1, :-1] = P
        P_all[-1, -1] = variance(own)
        return start.density, z1, P_all

    if "measurement" not in functions:

        def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
            h, C, R = model.observation(a, u, t, split(theta)[0])
            return h, np.concatenate([C, np.zeros((*C.shape[:-1], 1))], axis=-1), R

        functions["measurement"] = measurement
    free_name = name
    while free_name in {**model.nonlinear, **model.linear, **model.inputs, **model.outputs}:
        free_name += "_"
    extended = on_base(model, split, dynamics=dynamics, initial=initial, **functions)
    return replace(extended, linear={**model.linear, free_name: unit})


def add_memory(
    model: MixedModel,
    split: Split,
    name: str,
    unit: str,
    step: Callable[..., tuple[Array, Array, Array, Array]],
    observe: Callable[..., tuple[Array, Array, Array]],
) -> MixedModel:
    """The model with one more nonlinear state, zero at first and without noise of its own.

    ``step(a, memory, u, t, dt, base, own)`` returns f, A, Q of the model's own states and the next memory
    (M,); ``observe(a, memory, u, t, base, own)`` returns h, C, R. p(a_1) must be Gaussian.
    """
    na, nx = model.na, model.nx
    order = [*range(na), nx, *range(na, nx)]

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        f, A, Q, memory = step(a[:, :na], a[:, na], u, t, dt, *split(theta))
        f = np.concatenate([f, memory[:, None]], axis=1)
        A = np.concatenate([A, np.zeros((*A.shape[:-2], 1, model.nz))], axis=-2)
        Q_all = np.zeros((*Q.shape[:-2], nx + 1, nx + 1))
        Q_all[..., :nx, :nx] = Q
        return f[:, order], A[..., order, :], Q_all[..., order, :][..., order]

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        return observe(a[:, :na], a[:, na], u, t, *split(theta))

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        start = model.start(split(theta)[0])
        density: Any = start.density
        cov = np.zeros((na + 1, na + 1))
        cov[:na, :na] = density.cov
        _, P = start.linear(density.mean[None])
        return (
            Gaussian(np.append(density.mean, 0.0), cov),
            lambda a: start.linear(a[:, :na])[0],
            P if P.ndim == 2 else P[0],
        )

    return replace(
        model,
        nonlinear={**model.nonlinear, name: unit},
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
    )
