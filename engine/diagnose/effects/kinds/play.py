"""Play: what follows does not move until the slack is taken up, at either end of it.

    p_t = clip(p_(t-1), x_t - size, x_t + size)

with x an input that reaches the system through a linkage, or what a sensor reads through one. The played
value does not depend on how fast x moves: steps may be of any length, and samples refined.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.diagnose.effects.augmentation import WithMemory, add_memory
from engine.diagnose.effects.channels import Kind, at_terminals
from engine.diagnose.effects.effect import Effect, Split
from engine.diagnose.effects.kinds.measurement import observers
from engine.diagnose.effects.setting import Setting
from engine.statespace.model import Array, LinearGaussian, MixedModel, Parameter
from engine.statespace.promotion import promote
from engine.statespace.rows import with_input

ALIKE = {
    "delay": "comes late by a time, not by a way",
    "hysteresis": "is rounded, and drives a state",
}


def _played(last: Any, x: Any, size: Any) -> Any:
    return np.clip(last, x - size, x + size)


def _play(setting: Setting, channel: str, name: str) -> Effect:
    """Of an input, or of a sensor."""
    at_input = channel in setting.model.inputs
    first, unit = setting.first(channel), setting.unit(channel)
    reach = 0.5 * (setting.quantile(channel, 1.0) - setting.quantile(channel, 0.0))
    widest = reach if 0.0 < reach < np.inf else setting.size(channel)
    before = Parameter(f"{name}_first", first, unit, description="where it was before the record")
    return Effect(
        "play",
        channel,
        "input" if at_input else "measurement",
        f"play of the {'input' if at_input else 'sensor'} {channel}, to either side",
        f"{channel} -> p,  p_t = clip(p_(t-1), {channel} - {name}, {channel} + {name})",
        (
            Parameter(name, 0.0, unit, setting.limits(0.0, widest, 0.0), "half of the slack"),
            before,
        ),
        lambda model: (_of_input if at_input else _of_reading)(model, setting, channel),
        probes=((first,),),
        look_alikes={
            **ALIKE,
            "input-deadzone": "takes from every motion about zero, not at each turn",
            "lag": "is the less seen the slower the motion",
        },
        held=(before.name,),
        one_sided=True,
    )


def _begin(own: Any) -> tuple[float, float]:
    """Anywhere within the slack."""
    return float(own[1]), float(own[0]) ** 2 / 3.0


def _of_input(model: MixedModel, setting: Setting, channel: str) -> MixedModel:
    split, index = Split(model), list(model.inputs).index(channel)
    held = setting.hold == "zoh"  # nothing moves between samples, and no moments are taken again

    def driven(last: Array, u: Any, t: Any, own: Any) -> Any:
        played = _played(last, u[index], own[0])
        if held:
            played = np.where(setting.at_sample(t), played, last)
        return with_input(u, index, played)

    def step(a: Array, last: Array, u: Any, t: Any, dt: Any, record: Any, own: Any) -> WithMemory:
        rows = driven(last, u, t, own)
        return *model.transition(a, rows, t, dt, record), rows[index]

    def observe(a: Array, last: Array, u: Any, t: Any, record: Any, own: Any) -> LinearGaussian:
        return model.observation(a, driven(last, u, t, own), t, record)

    states = {f"played_{channel}": setting.unit(channel)}
    return add_memory(model, split, states, step, _begin, observe)


def _of_reading(model: MixedModel, setting: Setting, channel: str) -> MixedModel:
    base = promote(model, observers(setting, model, channel))
    split, row = Split(base), list(base.outputs).index(channel)

    def observe(a: Array, last: Array, u: Any, t: Any, record: Any, own: Any) -> LinearGaussian:
        h, C, R = base.observation(a, u, t, record)
        h = h.copy()
        h[:, row] = _played(last, h[:, row], own[0])
        return h, C, R

    def step(a: Array, last: Array, u: Any, t: Any, dt: Any, record: Any, own: Any) -> WithMemory:
        read = observe(a, last, u, t, record, own)[0][:, row]
        return *base.transition(a, u, t, dt, record), read

    states = {f"played_{channel}": setting.unit(channel)}
    return add_memory(base, split, states, step, _begin, observe)


KINDS: list[Kind] = [at_terminals("play", _play)]
