"""Effects between the recorded input and what drives the system."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from engine.diagnose.effect import Effect, Split, change_inputs, identifier, on_base
from engine.diagnose.setting import Kind, Setting, each_input
from engine.model import Array, Gaussian, MixedModel, Parameter


def input_offset(setting: Setting, channel: str) -> Effect | None:
    """The system sees u + size."""
    if channel not in setting.model.inputs:
        return None
    name = identifier("input_offset", channel)
    return Effect(
        "input-offset",
        channel,
        "input",
        f"offset of the input {channel}",
        f"{channel} -> {channel} + {name}",
        (Parameter(name, 0.0, setting.unit(channel), description="input offset"),),
        lambda model: change_inputs(model, channel, lambda u, own: u + own[0]),
        look_alikes={"force": "a constant force through the same equation looks alike"},
    )


def _input_dead_zone(setting: Setting, channel: str) -> Effect | None:
    if channel not in setting.model.inputs:
        return None
    name, scale = identifier("input_deadzone", channel), setting.size(channel)
    return Effect(
        "input-deadzone",
        channel,
        "input",
        f"dead zone of the input {channel}",
        f"{channel} -> (|{channel}| - {name})+ sign({channel})",
        (
            Parameter(
                name, 0.0, setting.unit(channel), setting.limits(0.0, 10.0 * scale), "half width"
            ),
        ),
        lambda model: change_inputs(
            model, channel, lambda u, own: np.sign(u) * np.maximum(np.abs(u) - own[0], 0.0)
        ),
        look_alikes={"coulomb": "acts on the sign of the velocity, not of the input"},
        one_sided=True,
    )


def _input_saturation(setting: Setting, channel: str) -> Effect | None:
    if channel not in setting.model.inputs:
        return None
    name, scale = identifier("input_saturation", channel), setting.size(channel)
    bounds = setting.limits(1e-2 * scale, 20.0 * scale, 1e-12)
    return Effect(
        "input-saturation",
        channel,
        "input",
        f"saturation of the input {channel}",
        f"{channel} -> {channel} - {name} * (|{channel}| - limit)+ sign({channel})",
        (
            Parameter(name, 0.0, "1", (-1.0, 1.0), "share of the excess that is lost"),
            Parameter(f"{name}_limit", scale, setting.unit(channel), bounds, "where it begins"),
        ),
        lambda model: change_inputs(
            model,
            channel,
            lambda u, own: u - own[0] * np.sign(u) * np.maximum(np.abs(u) - own[1], 0.0),
        ),
        probes=((0.7 * scale,), (1.3 * scale,)),
        look_alikes={"saturation": "depends on the state, not on the input"},
    )


def _delay(setting: Setting, channel: str) -> Effect | None:
    """A share of the input arrives one sample late; the last input is a state without noise."""
    if channel not in setting.model.inputs:
        return None
    name = identifier("delay", channel)

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)
        na, nx, index = model.na, model.nx, list(model.inputs).index(channel)
        order = [*range(na), nx, *range(na, nx)]

        def driven(a: Array, u: Any, own: Any) -> list[Any]:
            rows = list(u)
            rows[index] = (1.0 - own[0]) * u[index] + own[0] * a[:, na]
            return rows

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            f, A, Q = model.transition(a[:, :na], driven(a, u, own), t, dt, own_base)
            now = np.broadcast_to(u[index], (len(a),))
            f = np.concatenate([f, now[:, None]], axis=1)
            A = np.concatenate([A, np.zeros((*A.shape[:-2], 1, model.nz))], axis=-2)
            Q_all = np.zeros((*Q.shape[:-2], nx + 1, nx + 1))
            Q_all[..., :nx, :nx] = Q
            return f[:, order], A[..., order, :], Q_all[..., order, :][..., order]

        def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            return model.observation(a[:, :na], driven(a, u, own), t, own_base)

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

        extended = on_base(
            model, split, dynamics=dynamics, measurement=measurement, initial=initial
        )
        return replace(
            extended, nonlinear={**model.nonlinear, f"last_{channel}": setting.unit(channel)}
        )

    return Effect(
        "delay",
        channel,
        "input",
        f"delay of the input {channel}",
        f"{channel} -> (1 - {name}) {channel}_t + {name} {channel}_(t-1)",
        (Parameter(name, 0.0, "1", (-1.0, 2.0), "delay in samples"),),
        extend,
        look_alikes={"lag": "delays the reading, not the input"},
    )


KINDS: list[Kind] = [
    ("input-offset", input_offset, each_input),
    ("input-deadzone", _input_dead_zone, each_input),
    ("input-saturation", _input_saturation, each_input),
    ("delay", _delay, each_input),
]
