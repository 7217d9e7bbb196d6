"""Effects between the recorded input and what drives the system."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from engine.diagnose.effect import (
    Effect,
    Split,
    add_to_state,
    change_inputs,
    identifier,
    on_base,
)
from engine.diagnose.measurement import sensor_delay
from engine.diagnose.more_states import add_memory
from engine.diagnose.setting import Kind, Setting, each_input, each_output
from engine.diagnose.spare_inputs import UNIT, with_inputs
from engine.model import Array, MixedModel, Parameter


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
    """A share of the input arrives one sample late; the last input is a state without noise.

    At an output it is the sensor's delay.
    """
    if channel not in setting.model.inputs:
        return sensor_delay(setting, channel)
    name = identifier("delay", channel)

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)
        index = list(model.inputs).index(channel)

        def driven(last: Array, u: Any, own: Any) -> list[Any]:
            rows = list(u)
            rows[index] = (1.0 - own[0]) * u[index] + own[0] * last
            return rows

        def step(
            a: Array, last: Array, u: Any, t: Any, dt: Any, record: Any, own: Any
        ) -> tuple[Array, Array, Array, Array]:
            f, A, Q = model.transition(a, driven(last, u, own), t, dt, record)
            return f, A, Q, np.broadcast_to(u[index], (len(a),))

        def observe(
            a: Array, last: Array, u: Any, t: Any, record: Any, own: Any
        ) -> tuple[Array, Array, Array]:
            return model.observation(a, driven(last, u, own), t, record)

        unit = setting.unit(channel)
        return add_memory(model, split, f"last_{channel}", unit, step, observe)

    return Effect(
        "delay",
        channel,
        "input",
        f"delay of the input {channel}",
        f"{channel} -> (1 - {name}) {channel}_t + {name} {channel}_(t-1)",
        (Parameter(name, 0.0, "1", (-1.0, 2.0), "delay in samples"),),
        extend,
        look_alikes={
            "lag": "delays the reading, not the input",
            "hold": "looks half a sample ahead, not back",
        },
    )


def _hold(setting: Setting, channel: str) -> Effect | None:
    """The input goes on between its samples: the step is driven by u_t + size (u_(t+1) - u_t) / 2.

    With g the gain of an input held over the step, x_(t+1) = F(x_t, u_t) + size g (u_(t+1) - u_t) / 2. The
    states of the extended model are x_t - size g u_t / 2, which needs no input of the next sample.
    The input must add to the state equation; g may depend on a slowly.
    """
    if channel not in setting.model.inputs:
        return None
    name, scale = identifier("hold", channel), setting.size(channel)

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)
        index, na = list(model.inputs).index(channel), model.na

        def ahead(a: Array, u: Any, t: Any, record: Any, own: Any) -> Array:
            """size g u_t / 2, (M, nx)."""
            more = list(u)
            more[index] = u[index] + scale
            held = model.transition(a, u, t, own[1], record)[0]
            g = (model.transition(a, more, t, own[1], record)[0] - held) / scale
            return g * np.reshape(0.5 * own[0] * u[index], (-1, 1))

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            record, own = split(theta)
            shift = ahead(a, u, t, record, own)
            f, A, Q = model.transition(a + shift[:, :na], u, t, dt, record)
            return f + np.einsum("...ij,...j->...i", A, shift[:, na:]) - shift, A, Q

        def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
            record, own = split(theta)
            shift = ahead(a, u, t, record, own)
            h, C, R = model.observation(a + shift[:, :na], u, t, record)
            return h + np.einsum("...ij,...j->...i", C, shift[:, na:]), C, R

        return on_base(model, split, dynamics=dynamics, measurement=measurement)

    return Effect(
        "hold",
        channel,
        "input",
        f"input {channel} that changes between its samples",
        f"{channel}_t -> {channel}_t + {name} ({channel}_(t+1) - {channel}_t) / 2",
        (
            Parameter(name, 0.0, "1", (-1.0, 2.0), "0: held, 1: linear between samples"),
            Parameter(f"{name}_step", setting.dt, "s", (1e-300, np.inf), "time between samples"),
        ),
        extend,
        probes=((setting.dt,),),
        look_alikes={"delay": "looks back, not ahead"},
        held=(f"{name}_step",),
    )


def _extra_input(setting: Setting, channel: str) -> Effect | None:
    """``channel->state``: a recorded channel that the model does not use drives a state."""
    source, _, target = channel.partition("->")
    taken = {**setting.states, **setting.model.outputs}
    if target not in setting.states or not source or source in taken:
        return None
    name = identifier("extra_input", source, target)

    def extend(model: MixedModel) -> MixedModel:
        if source not in model.inputs:
            model = with_inputs(model, [source])
        return add_to_state(model, target, lambda v, own: own[0] * v[source])

    unit = setting.model.inputs.get(source, UNIT)
    return Effect(
        "extra-input",
        channel,
        "input",
        f"the channel {source}, which the model leaves out, drives {target}",
        f"{target}' = ... + dt * {name} * {source}",
        (Parameter(name, 0.0, setting.rate(target, unit), description="rate per unit"),),
        extend,
        look_alikes={"force": "is constant", "latent": "does not follow the channel"},
    )


def _each_extra(setting: Setting) -> Iterator[str]:
    for source in setting.extra:
        for target in setting.targets:
            yield f"{source}->{target}"


KINDS: list[Kind] = [
    ("input-offset", input_offset, each_input),
    ("input-deadzone", _input_dead_zone, each_input),
    ("input-saturation", _input_saturation, each_input),
    ("delay", _delay, lambda s: iter([*each_input(s), *each_output(s)])),
    ("hold", _hold, each_input),
    ("extra-input", _extra_input, _each_extra),
]
