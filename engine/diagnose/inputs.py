"""Effects between the recorded input and what drives the system."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.diagnose.effect import Effect, Split, change_inputs, identifier
from engine.diagnose.more_states import add_memory
from engine.diagnose.setting import Kind, Setting, each_input
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
    """A share of the input arrives one sample late; the last input is a state without noise."""
    if channel not in setting.model.inputs:
        return None
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
        look_alikes={"lag": "delays the reading, not the input"},
    )


KINDS: list[Kind] = [
    ("input-offset", input_offset, each_input),
    ("input-deadzone", _input_dead_zone, each_input),
    ("input-saturation", _input_saturation, each_input),
    ("delay", _delay, each_input),
]
