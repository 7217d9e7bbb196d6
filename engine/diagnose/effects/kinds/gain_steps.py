"""Gains that change at a time: of an actuator that fails in part, of a sensor that was set anew."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from engine.diagnose.effects.channels import Kind, at_inputs, at_outputs
from engine.diagnose.effects.effect import Effect, Split, change_inputs, change_output
from engine.diagnose.effects.kinds.measurement import magnified
from engine.diagnose.effects.kinds.time import from_when, lasting, since
from engine.diagnose.effects.origin import Origin
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import ANY, Course, Traits
from engine.statespace.model import Array, MixedModel, Parameter

NEAREST = 2  # places beyond the record from which it is looked for: one on either side
WITHIN = (-3.0, 10.0)  # a dead actuator is -1, one wired the other way -2


def _input_gain_step(setting: Setting, channel: str, name: str) -> Effect:
    """From a time on the system sees (1 + size) times what is recorded."""

    def extend(model: MixedModel, gain: Gain, origin: Origin) -> MixedModel:
        def change(u: Any, own: Sequence[Any], t: Any) -> Any:
            return u + gain(own, t) * (u - origin.of(own))

        return change_inputs(model, channel, change)

    look_alikes = {
        "input-gain": "was there from the beginning",
        "parameter-step": "acts without the input, too",
        "step": "stays the same whatever the input does",
    }
    what = f"{channel} -> {channel}", channel, f"step of the gain of the input {channel}"
    return _gain_that_changes("input-gain-step", setting, channel, name, what, extend, look_alikes)


def _gain_step(setting: Setting, channel: str, name: str) -> Effect:
    """From a time on the sensor reads (1 + size) times what it did."""

    def extend(model: MixedModel, gain: Gain, origin: Origin) -> MixedModel:
        row = list(model.outputs).index(channel)

        def change(a: Array, u: Any, t: Any, h: Array, C: Array, R: Array, own: Any) -> Any:
            return *magnified(h, C, row, gain(own, t), origin.of(own)), R

        return change_output(model, Split(model), change)

    look_alikes = {
        "gain": "was there from the beginning",
        "parameter-step": "moves the state, not only the reading",
        "step": "is the same at small readings",
    }
    what = f"{channel} = y", "y", f"step of the gain of the sensor {channel}"
    return _gain_that_changes("gain-step", setting, channel, name, what, extend, look_alikes)


# (the effect's own values, t) -> the relative change of the gain, a number or (M,)
Gain = Callable[[Sequence[Any], Any], Any]


def _gain_that_changes(
    kind: str,
    setting: Setting,
    channel: str,
    name: str,
    what: tuple[str, str, str],
    extend: Callable[[MixedModel, Gain, Origin], MixedModel],
    look_alikes: dict[str, str],
) -> Effect:
    """``what`` is changed, written as an equation begins, the signal by its name there, and the title."""
    origin, further = Origin(setting, name, channel), from_when(name, setting)
    begins, signal, title = what

    def gain(own: Sequence[Any], t: Any) -> Any:
        return own[0] * since(t, own[1:], setting.later)

    size = Parameter(name, 0.0, "1", WITHIN, "relative change of the gain")
    members = origin.counted(size, *further, probes=(tuple(p.default for p in further),))
    # from a zero beyond the record it comes at another row than from the middle of it
    probe = members["probes"][0][:-1]
    members["probes"] += tuple((*probe, place) for place in origin.outside[:NEAREST])
    members["held"] += tuple(p.name for p in further[1:])
    return Effect(
        kind,
        channel,
        "time",
        title,
        f"{begins} + {name} * [t >= {name}_time] * {origin.text(signal)}{lasting(further)}",
        extend=lambda model: extend(model, gain, origin),
        look_alikes=look_alikes,
        # what the model has a parameter for is said by its name
        traits=Traits(
            Course.STEP,
            of_gain=True,
            swallowed=True,
            plainness=ANY + 1,
            # of a reading far from the zero it counts from; from before the record on
            contains=("step", kind.removesuffix("-step")),
        ),
        **members,
    )


KINDS: list[Kind] = [
    at_inputs("input-gain-step", _input_gain_step),
    at_outputs("gain-step", _gain_step),
]
