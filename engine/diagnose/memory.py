"""Effects in the state equation that remember: a missing pole, hysteresis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from engine.diagnose.effect import (
    Effect,
    Split,
    identifier,
    on_base,
)
from engine.diagnose.setting import Kind, Setting, each_state, pair
from engine.model import Array, Gaussian, MixedModel, Parameter
from engine.promote import promote


def _pole(setting: Setting, channel: str) -> Effect | None:
    """A first-order lag of a state that acts back: l' = l + dt (x - l) / tau."""
    found = pair(setting, channel)
    if found is None:
        return None
    source, target = found
    name = identifier("pole", channel)
    fast, slow = 2.0 * setting.dt, 0.5 * (setting.span[1] - setting.span[0])

    def extend(model: MixedModel) -> MixedModel:
        base = promote(model, ())
        split = Split(model)
        na, nx = base.na, base.nx
        states = [*base.nonlinear, *base.linear]
        row, column = states.index(target), states.index(source)

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            f, A, Q = base.transition(a, u, t, dt, own_base)
            M = len(a)
            keep = np.broadcast_to(np.exp(-dt / own[1]), (M,))
            f_all = np.concatenate([f, np.zeros((M, 1))], axis=1)
            A_all = np.zeros((M, nx + 1, base.nz + 1))
            A_all[:, :nx, :-1] = A
            A_all[:, nx, -1] = keep
            A_all[:, row, -1] += dt * own[0]
            if column < na:
                f_all[:, nx] += (1.0 - keep) * a[:, column]
            else:
                A_all[:, nx, column - na] += 1.0 - keep
            Q_all = np.zeros((*Q.shape[:-2], nx + 1, nx + 1))
            Q_all[..., :nx, :nx] = Q
            return f_all, A_all, Q_all

        return add_linear_state(base, split, f"lag_{source}", setting.unit(source), dynamics)

    return Effect(
        "pole",
        channel,
        "state",
        f"missing pole: a lag of {source} acting on {target}",
        f"l' = l + dt ({source} - l) / {name}_time,  {target}' = ... + dt * {name} * l",
        (
            Parameter(name, 0.0, setting.rate(target, setting.unit(source))),
            Parameter(
                f"{name}_time",
                10.0 * setting.dt,
                "s",
                setting.limits(fast, max(slow, 2.0 * fast), 1e-12),
            ),
        ),
        extend,
        probes=((5.0 * setting.dt,), (30.0 * setting.dt,)),
        look_alikes={"coupling": "acts without delay", "latent": "is not driven by the states"},
    )


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


def _hysteresis(setting: Setting, channel: str) -> Effect | None:
    """Bouc-Wen with n = 1: h' = h + dt (v - |v| h / w), a force that remembers (Wen 1976)."""
    found = pair(setting, channel)
    if found is None:
        return None
    source, target = found
    name = identifier("hysteresis", channel)
    width = setting.size(source) * 5.0 * setting.dt

    def extend(model: MixedModel) -> MixedModel:
        base = promote(model, (source,))
        split = Split(model)
        na, nx = base.na, base.nx
        column = list(base.nonlinear).index(source)
        row = [*base.nonlinear, *base.linear].index(target)
        order = [*range(na), nx, *range(na, nx)]

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            f, A, Q = base.transition(a[:, :na], u, t, dt, own_base)
            v, memory = a[:, column], a[:, na]
            keep = np.exp(-dt * np.abs(v) / own[1])
            moved = keep * memory + (1.0 - keep) * own[1] * np.sign(v)
            f_all = np.concatenate([f, moved[:, None]], axis=1)
            f_all[:, row] += dt * own[0] * memory
            A_all = np.concatenate([A, np.zeros((*A.shape[:-2], 1, base.nz))], axis=-2)
            Q_all = np.zeros((*Q.shape[:-2], nx + 1, nx + 1))
            Q_all[..., :nx, :nx] = Q
            return (
                f_all[:, order],
                A_all[..., order, :],
                Q_all[..., order, :][..., order],
            )

        def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
            return base.observation(a[:, :na], u, t, split(theta)[0])

        def initial(theta: Any) -> tuple[Any, Any, Any]:
            start = base.start(split(theta)[0])
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
            base,
            nonlinear={**base.nonlinear, f"memory_{source}": f"{setting.unit(source)} s"},
            dynamics=dynamics,
            measurement=measurement,
            initial=initial,
        )

    return Effect(
        "hysteresis",
        channel,
        "state",
        f"hysteresis (Bouc-Wen) driven by {source}" + ("" if source == target else f" on {target}"),
        f"m' = m + dt ({source} - |{source}| m / w),  {target}' = ... + dt * {name} * m",
        (
            Parameter(name, 0.0, setting.rate(target, f"{setting.unit(source)} s")),
            Parameter(
                f"{name}_width",
                width,
                f"{setting.unit(source)} s",
                setting.limits(width / 100, width * 100, 1e-12),
            ),
        ),
        extend,
        probes=((width,), (10.0 * width,)),
        look_alikes={"coulomb": "has no memory beyond the sign", "coupling": "has no loop"},
    )


KINDS: list[Kind] = [
    ("pole", _pole, each_state),
    ("hysteresis", _hysteresis, each_state),
]
