"""Extensions of a model by states of the effect's own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from engine.diagnose.effect import Split, on_base
from engine.model import Array, Gaussian, MixedModel


def add_linear_states(
    model: MixedModel,
    split: Split,
    states: Mapping[str, str],
    dynamics: Any,
    variance: Callable[[Any], float] = lambda own: 0.0,
    **functions: Any,
) -> MixedModel:
    """The model with more linear states, name -> unit, behind its own.

    They are zero at first, up to ``variance(own parameters)`` each.
    """
    na, k = model.na, len(states)

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        own_base, own = split(theta)
        start = model.start(own_base)

        def z1(a: Array) -> Array:
            z, _ = start.linear(a[:, :na])
            return np.concatenate([z, np.zeros((len(a), k))], axis=1)

        _, P = start.linear(np.zeros((1, na)))
        if P.ndim == 3:
            P = P[0]
        P_all = np.zeros((model.nz + k, model.nz + k))
        P_all[:-k, :-k] = P
        P_all[-k:, -k:] = variance(own) * np.eye(k)
        return start.density, z1, P_all

    if "measurement" not in functions:

        def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
            h, C, R = model.observation(a, u, t, split(theta)[0])
            return h, np.concatenate([C, np.zeros((*C.shape[:-1], k))], axis=-1), R

        functions["measurement"] = measurement
    taken = {**model.nonlinear, **model.linear, **model.inputs, **model.outputs}
    for name, unit in states.items():
        while name in taken:
            name += "_"
        taken[name] = unit
    added = list(taken.items())[-k:]
    extended = on_base(model, split, dynamics=dynamics, initial=initial, **functions)
    return replace(extended, linear={**model.linear, **dict(added)})


def beside(
    step: tuple[Array, Array, Array], M: int, block: Sequence[Sequence[Any]], noise: Any
) -> tuple[Array, Array, Array]:
    """One step of a model with k more linear states of their own dynamics behind its own.

    ``block`` (k, k) of numbers or (M,) is their transition matrix, ``noise`` the variance of each one's
    noise. Nothing passes between them and the model's states yet.
    """
    f, A, Q = step
    (nx, nz), k = A.shape[-2:], len(block)
    entries = [entry for row in block for entry in row]
    A_all = _zeros(A, M, (nx + k, nz + k), entries)
    A_all[..., :nx, :nz] = A
    Q_all = _zeros(Q, M, (nx + k, nx + k), [noise])
    Q_all[..., :nx, :nx] = Q
    for i, row in enumerate(block):
        Q_all[..., nx + i, nx + i] = noise
        for j, entry in enumerate(row):
            A_all[..., nx + i, nz + j] = entry
    return np.concatenate([f, np.zeros((M, k))], axis=1), A_all, Q_all


def _zeros(matrix: Array, M: int, shape: tuple[int, int], entries: Sequence[Any]) -> Array:
    """Zeros of a shape, per point where the matrix or one of the entries is."""
    common = matrix.ndim == 2 and all(np.ndim(entry) == 0 for entry in entries)
    return np.zeros(shape if common else (M, *shape))


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
    order = np.array([*range(na), nx, *range(na, nx)])
    rows = order[:, None]

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        f, A, Q, memory = step(a[:, :na], a[:, na], u, t, dt, *split(theta))
        f = np.concatenate([f, memory[:, None]], axis=1)
        A = np.concatenate([A, np.zeros((*A.shape[:-2], 1, model.nz))], axis=-2)
        Q_all = np.zeros((*Q.shape[:-2], nx + 1, nx + 1))
        Q_all[..., :nx, :nx] = Q
        return f[:, order], A[..., order, :], Q_all[..., rows, order]

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
