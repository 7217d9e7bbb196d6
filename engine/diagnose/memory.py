"""Effects in the state equation that remember: a missing pole or mode, hysteresis."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.diagnose.effect import (
    Effect,
    Split,
    identifier,
)
from engine.diagnose.more_states import add_linear_states, add_memory, beside
from engine.diagnose.setting import Kind, Setting, each_moved, each_state, pair
from engine.model import Array, MixedModel, Parameter
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
            f, A, Q = beside((f, A, Q), M, [[keep]], 0.0)
            A[:, row, -1] += dt * own[0]
            if column < na:
                f[:, nx] += (1.0 - keep) * a[:, column]
            else:
                A[:, nx, column - na] += 1.0 - keep
            return f, A, Q

        return add_linear_states(base, split, {f"lag_{source}": setting.unit(source)}, dynamics)

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


def _mode(setting: Setting, channel: str) -> Effect | None:
    """A resonance that a state excites and that acts back: q'' = w^2 (x - q) - 2 zeta w q'.

    Discretised exactly for x held over the step; its second state is q' / w, in the unit of x.
    """
    found = pair(setting, channel)
    if found is None:
        return None
    source, target = found
    name, unit = identifier("mode", channel), setting.unit(source)
    length = max(setting.span[1] - setting.span[0], 10.0 * setting.dt)

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)
        na, nx = model.na, model.nx
        states = [*model.nonlinear, *model.linear]
        row, column = states.index(target), states.index(source)

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            M = len(a)
            omega, zeta = 2.0 * np.pi * own[1], own[2]
            damped = np.sqrt(1.0 - zeta * zeta)
            angle, fades = damped * omega * dt, np.exp(-zeta * omega * dt)
            c, s = fades * np.cos(angle), fades * np.sin(angle) / damped
            block = [[np.broadcast_to(c + zeta * s, (M,)), s], [-s, c - zeta * s]]
            f, A, Q = beside(model.transition(a, u, t, dt, own_base), M, block, 0.0)
            A[:, row, -2] += dt * own[0]
            for i, drive in enumerate((1.0 - block[0][0], s)):
                if column < na:
                    f[:, nx + i] += drive * a[:, column]
                else:
                    A[:, nx + i, column - na] += drive
            return f, A, Q

        own_states = {f"mode_{source}": unit, f"mode_rate_{source}": unit}
        return add_linear_states(model, split, own_states, dynamics)

    return Effect(
        "mode",
        channel,
        "state",
        f"missing mode: a resonance driven by {source} acting on {target}",
        f"q'' = w^2 ({source} - q) - 2 {name}_damping w q',  w = 2 pi {name}_frequency,  "
        f"{target}' = ... + dt * {name} * q",
        (
            Parameter(name, 0.0, setting.rate(target, unit)),
            Parameter(
                f"{name}_frequency",
                0.1 / setting.dt,
                "Hz",
                setting.limits(0.5 / length, 0.48 / setting.dt, 1e-12),
            ),
            Parameter(f"{name}_damping", 0.1, "1", (1e-3, 0.99)),
        ),
        extend,
        probes=tuple((f / setting.dt, 0.2) for f in (0.02, 0.06, 0.12, 0.25)),
        look_alikes={"pole": "does not ring", "harmonic": "does not depend on the states"},
    )


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
        column = list(base.nonlinear).index(source)
        row = [*base.nonlinear, *base.linear].index(target)

        def step(
            a: Array, memory: Array, u: Any, t: Any, dt: Any, record: Any, own: Any
        ) -> tuple[Array, Array, Array, Array]:
            f, A, Q = base.transition(a, u, t, dt, record)
            f = f.copy()
            f[:, row] += dt * own[0] * memory
            keep = np.exp(-dt * np.abs(a[:, column]) / own[1])
            return f, A, Q, keep * memory + (1.0 - keep) * own[1] * np.sign(a[:, column])

        def observe(
            a: Array, memory: Array, u: Any, t: Any, record: Any, own: Any
        ) -> tuple[Array, Array, Array]:
            return base.observation(a, u, t, record)

        unit = f"{setting.unit(source)} s"
        return add_memory(base, split, f"memory_{source}", unit, step, observe)

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
    ("mode", _mode, each_moved),
    ("hysteresis", _hysteresis, each_state),
]
