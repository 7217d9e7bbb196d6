"""Effects between the recorded input and what drives the system."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from engine.diagnose.effects.channels import Kind, at_inputs, each_input, each_moved
from engine.diagnose.effects.effect import (
    Effect,
    Split,
    add_to_state,
    change_inputs,
    on_base,
)
from engine.diagnose.effects.kinds.clip import Clip
from engine.diagnose.effects.origin import Origin
from engine.diagnose.effects.setting import SOME_TIME, WIDEST, Setting
from engine.diagnose.effects.spare_inputs import UNIT, with_inputs
from engine.diagnose.effects.traits import Traits
from engine.statespace.model import Array, MixedModel, Parameter
from engine.statespace.rows import with_input


def _input_offset(setting: Setting, channel: str, name: str) -> Effect:
    """The system sees u + size."""
    return Effect(
        "input-offset",
        channel,
        "input",
        f"offset of the input {channel}",
        f"{channel} -> {channel} + {name}",
        (Parameter(name, 0.0, setting.unit(channel), description="input offset"),),
        lambda model: change_inputs(model, channel, lambda u, own, t: u + own[0]),
        look_alikes={"force": "stays the same whatever the input is multiplied by"},
        traits=Traits(plainness=3),
    )


INPUT_OFFSET = at_inputs("input-offset", _input_offset)


def _input_gain(setting: Setting, channel: str, name: str) -> Effect:
    """The system sees (1 + size) times what is recorded."""
    origin = Origin(setting, name, channel)
    return Effect(
        "input-gain",
        channel,
        "input",
        f"gain error of the input {channel}",
        f"{channel} -> {channel} + {name} * {origin.text(channel)}",
        extend=lambda model: change_inputs(
            model, channel, lambda u, own, t: u + own[0] * (u - origin.of(own))
        ),
        look_alikes={
            "gain": "acts on the reading, not on what drives the system",
            "path": "follows the input with a lag",
            "input-saturation": "acts on large inputs only",
        },
        **origin.proportional(Parameter(name, 0.0, "1", (-0.99, 10.0), "relative gain error")),
    )


def _input_dead_zone(setting: Setting, channel: str, name: str) -> Effect:
    origin = Origin(setting, name, channel)
    bounds = setting.limits(0.0, WIDEST * setting.distance(channel, 0.7), 0.0)

    def change(u: Any, own: Sequence[Any], t: Any) -> Any:
        zero = origin.of(own)
        return zero + np.sign(u - zero) * np.maximum(np.abs(u - zero) - own[0], 0.0)

    return Effect(
        "input-deadzone",
        channel,
        "input",
        f"dead zone of the input {channel}, to either side",
        f"v = {origin.text(channel)} -> (|v| - {name})+ sign(v)",
        extend=lambda model: change_inputs(model, channel, change),
        look_alikes={
            "coulomb": "acts on the sign of the velocity, not of the input",
            "play": "acts at each turn of the input, not about its zero",
        },
        one_sided=True,
        **origin.counted(Parameter(name, 0.0, setting.unit(channel), bounds, "half width")),
    )


def _input_saturation(setting: Setting, channel: str, name: str) -> Effect:
    clip = Clip(setting, name, channel)
    return Effect(
        "input-saturation",
        channel,
        "input",
        f"saturation of the input {channel}",
        f"{channel} -> {channel} - {name} * {clip.text(channel)}",
        extend=lambda model: change_inputs(
            model, channel, lambda u, own, t: u - own[0] * clip.excess(u, own)
        ),
        look_alikes={"saturation": "depends on the state, not on the input"},
        one_sided=True,
        **clip.members,
    )


def _hold(setting: Setting, channel: str, name: str) -> Effect | None:
    """The input goes on between its samples: the step is driven by u_t + size (u_(t+1) - u_t) / 2.

    With g the gain of an input held over the step, x_(t+1) = F(x_t, u_t) + size g (u_(t+1) - u_t) / 2. The
    states of the extended model are x_t - size g (u_t - u_1) / 2, which needs no input of the next sample
    and is x_1 at first. The input must add to the state equation; g may depend on a slowly. Nothing is asked
    of a series that says already what its inputs did.
    """
    if setting.hold != "zoh":
        return None
    scale, first = setting.size(channel), setting.first(channel)

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)
        index, na = list(model.inputs).index(channel), model.na

        def shift_of(a: Array, u: Any, t: Any, record: Any, own: Any) -> Array:
            """size g (u_t - u_1) / 2, (M, nx)."""
            more = with_input(u, index, u[index] + scale)
            held = model.transition(a, u, t, own[1], record)[0]
            g = (model.transition(a, more, t, own[1], record)[0] - held) / scale
            return g * np.reshape(0.5 * own[0] * (u[index] - own[2]), (-1, 1))

        def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
            record, own = split(theta)
            shift = shift_of(a, u, t, record, own)
            f, A, Q = model.transition(a + shift[:, :na], u, t, dt, record)
            return f + np.einsum("...ij,...j->...i", A, shift[:, na:]) - shift, A, Q

        def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
            record, own = split(theta)
            shift = shift_of(a, u, t, record, own)
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
            Parameter(
                name,
                0.0,
                "1",
                (0.0, 2.0),
                "0: held, 1: linear between samples, 2: that of the next row",
            ),
            setting.time(f"{name}_step", setting.dt, SOME_TIME, "time between samples"),
            Parameter(f"{name}_first", first, setting.unit(channel), description="first input"),
        ),
        extend,
        probes=((setting.dt, first),),
        look_alikes={"delay": "looks back, not ahead"},
        held=(f"{name}_step", f"{name}_first"),
        one_sided=True,
        traits=Traits(says_hold=("foh", "past")),
    )


def _extra_input(setting: Setting, channel: str) -> Effect | None:
    """``channel->state``: a recorded channel drives a state where the model does not say so.

    One that the model does not use is counted from its median where its zero is not declared: what that moves
    is a constant force.
    """
    source, _, target = channel.partition("->")
    taken = {**setting.states, **setting.model.outputs}
    if target not in setting.states or not source or source in taken:
        return None
    name = setting.identifier("extra_input", source, target)
    known, start, used = setting, None, source in each_input(setting)
    if source not in setting.model.inputs:
        known = replace(setting, model=with_inputs(setting.model, [source]))
    if not (used or source in known.known_zeros):
        start = known.quantile(source, 0.5)
    origin = Origin(known, name, source, start)

    def extend(model: MixedModel) -> MixedModel:
        if source not in model.inputs:
            model = with_inputs(model, [source])
        return add_to_state(model, target, lambda v, own: own[0] * (v[source] - origin.of(own)))

    rate = setting.rate(target, setting.model.inputs.get(source, UNIT))
    return Effect(
        "extra-input",
        channel,
        "input",
        f"the input {source} drives {target} beside what the model has of it"
        if used
        else f"the channel {source}, which the model leaves out, drives {target}",
        f"{target}' = ... + dt * {name} * {origin.text(source)}",
        extend=extend,
        look_alikes={
            "force": "is constant",
            "latent": "does not follow the channel",
            "input-gain": "acts wherever the input does",
            "path": "follows the input with a lag",
        },
        traits=Traits(
            contains=("input-gain",)
        ),  # where all that the input does is to drive this state
        **origin.proportional(Parameter(name, 0.0, rate, description="rate per unit")),
    )


def _each_extra(setting: Setting) -> list[str]:
    """Channels that the model leaves out to every state, its inputs to those that are no disturbances."""
    left_out = [f"{source}->{target}" for source in setting.extra for target in setting.targets]
    used = [
        f"{source}->{target}" for source in each_input(setting) for target in each_moved(setting)
    ]
    return left_out + used


KINDS: list[Kind] = [
    INPUT_OFFSET,
    at_inputs("input-gain", _input_gain),
    at_inputs("input-deadzone", _input_dead_zone),
    at_inputs("input-saturation", _input_saturation),
    at_inputs("hold", _hold),
    ("extra-input", _extra_input, _each_extra),
]
