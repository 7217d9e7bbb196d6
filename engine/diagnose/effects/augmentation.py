"""Extensions of a model by states of the effect's own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from engine.diagnose.effects.effect import Parts, Split, on_base
from engine.diagnose.effects.setting import Setting
from engine.statespace.model import Array, LinearGaussian, MixedModel, Parameter
from engine.statespace.promotion import product
from engine.statespace.shapes import as_matrix

# (a_1 (M, na), base record, own values) -> m (M, k), G (k, nz) or (M, k, nz), variances: the new states
# are m + G z_1 at first, plus noise of these variances (a number or (k,))
Begin: TypeAlias = Callable[[Array, Any, Any], tuple[Array, Array, Any]]
# f, A, Q of a model's own states, and the next memory
WithMemory: TypeAlias = tuple[Array, Array, Array, Array]


def add_linear_states(
    model: MixedModel,
    split: Parts,
    states: Mapping[str, str],
    dynamics: Any,
    begin: Begin | None = None,
    **functions: Any,
) -> MixedModel:
    """The model with more linear states, name -> unit, behind its own.

    ``begin`` tells where they start, by default at zero; what they share with x_1 is in P_1.
    """
    na, nz, k = model.na, model.nz, len(states)

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        own_base, own = split(theta)
        start = model.start(own_base)

        def first(a: Array) -> tuple[Array, Array, Any]:
            if begin is None:
                return np.zeros((len(a), k)), np.zeros((k, nz)), 0.0
            return begin(a[:, :na], own_base, own)

        def z1(a: Array) -> Array:
            z, _ = start.linear(a[:, :na])
            m, G, _ = first(a)
            return np.concatenate([z, m + np.einsum("...ij,...j->...i", G, z)], axis=1)

        def P1(a: Array) -> Array:
            _, P = start.linear(a[:, :na])
            _, G, variances = first(a)
            both = np.concatenate(
                [np.broadcast_to(np.eye(nz), (*G.shape[:-2], nz, nz)), G], axis=-2
            )
            whole: Array = both @ P @ np.swapaxes(both, -1, -2)
            own_rows = np.arange(nz, nz + k)
            whole[..., own_rows, own_rows] += variances
            return whole

        one = P1(np.asarray(start.density.sample(np.random.default_rng(0), 2), dtype=float))
        by_point = callable(start.P1) or one.ndim == 3
        return start.density, z1, P1 if by_point else one

    if "measurement" not in functions:

        def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
            h, C, R = model.observation(a, u, t, split(theta)[0])
            return h, np.concatenate([C, np.zeros((*C.shape[:-1], k))], axis=-1), R

        functions["measurement"] = measurement
    extended = on_base(model, split, dynamics=dynamics, initial=initial, **functions)
    return replace(extended, linear={**model.linear, **_with_free_names(model, states)})


def _with_free_names(model: MixedModel, states: Mapping[str, str]) -> dict[str, str]:
    """States to be added, name -> unit, by names that no channel has: two effects may add their like."""
    taken = {*model.nonlinear, *model.linear, *model.inputs, *model.outputs}
    added: dict[str, str] = {}
    for name, unit in states.items():
        while name in taken or name in added:
            name += "_"
        added[name] = unit
    return added


def spread_at_first(setting: Setting, name: str, source: str) -> Parameter:
    """A held parameter of the effect ``name``: how far from rest its memory of ``source`` may begin.

    Up to the source's own standard deviation, where that is known.
    """
    what = f"standard deviation at first of the memory of {source}; 0: it begins at rest"
    most = float(setting.scale.get(source, 0.0))
    return Parameter(f"{name}_spread", most, setting.unit(source), (0.0, np.inf), what)


def beside(step: LinearGaussian, M: int, block: Any, noise: Any) -> LinearGaussian:
    """One step of a model with k more linear states of their own dynamics behind its own.

    ``block`` is their transition matrix, (k, k) or (M, k, k) or k rows of numbers or (M,), ``noise`` the
    variance of each one's noise. Nothing passes between them and the model's states yet.
    """
    f, A, Q = step
    (nx, nz), k = A.shape[-2:], len(block[0]) if isinstance(block, list) else block.shape[-1]
    own = as_matrix(block, M, k, k, "transition of the added states")
    A_all = np.zeros((*_points(M, A.ndim > 2 or own.ndim > 2), nx + k, nz + k))
    A_all[..., :nx, :nz] = A
    A_all[..., nx:, nz:] = own
    Q_all = np.zeros((*_points(M, Q.ndim > 2 or np.ndim(noise) > 0), nx + k, nx + k))
    Q_all[..., :nx, :nx] = Q
    for i in range(nx, nx + k):
        Q_all[..., i, i] = noise
    return np.concatenate([f, np.zeros((M, k))], axis=1), A_all, Q_all


def _points(M: int, each: bool) -> tuple[int, ...]:
    """Leading dimensions of a matrix that each point may have of its own."""
    return (M,) if each else ()


def add_memory(
    model: MixedModel,
    split: Split,
    states: Mapping[str, str],
    step: Callable[..., WithMemory],
    begin: Callable[[Any], tuple[Any, Any]],
    observe: Callable[..., LinearGaussian] | None = None,
) -> MixedModel:
    """The model with more nonlinear states, name -> unit, without noise of their own.

    ``step(a, memory, u, t, dt, base, own)`` returns f, A, Q of the model's own states and the next memory, on
    which linear states act where A has rows of it, too; ``observe(a, memory, u, t, base, own)`` returns h, C,
    R, by default the model's; ``begin(own)`` the memory's mean and variance at first, independent of x_1. A
    memory of one state is (M,), of k states (k, M), so that it unpacks. p(a_1) may be any density.
    """
    na, nx, k = model.na, model.nx, len(states)
    order = np.array([*range(na), *range(nx, nx + k), *range(na, nx)])
    rows = order[:, None]

    def own_states(a: Array) -> tuple[Array, Array]:
        return a[:, :na], a[:, na] if k == 1 else a[:, na:].T

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        f, A, Q, memory = step(*own_states(a), u, t, dt, *split(theta))
        f = np.concatenate([f, np.reshape(memory, (k, -1)).T], axis=1)
        if A.shape[-2] == nx:
            A = np.concatenate([A, np.zeros((*A.shape[:-2], k, model.nz))], axis=-2)
        Q_all = np.zeros((*Q.shape[:-2], nx + k, nx + k))
        Q_all[..., :nx, :nx] = Q
        return f[:, order], A[..., order, :], Q_all[..., rows, order]

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        if observe is None:
            return model.observation(a[:, :na], u, t, split(theta)[0])
        return observe(*own_states(a), u, t, *split(theta))

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        own_base, own = split(theta)
        start = model.start(own_base)
        mean, variance = (np.broadcast_to(np.asarray(x, dtype=float), (k,)) for x in begin(own))

        def memory(a: Array) -> tuple[Array, Array]:
            return np.tile(mean, (len(a), 1)), np.diag(variance)

        def of_base(function: Any) -> Any:
            return (lambda a: function(a[:, :na])) if callable(function) else function

        density = product(start.density, memory, na)
        return density, of_base(start.z1), of_base(start.P1)

    return replace(
        model,
        nonlinear={**model.nonlinear, **_with_free_names(model, states)},
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
    )
