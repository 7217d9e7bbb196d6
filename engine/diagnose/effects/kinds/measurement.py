"""Effects in the measurement equation: what a sensor does to the reading."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from engine.diagnose.effects.channels import Kind, at_outputs
from engine.diagnose.effects.effect import Effect, Split, add_to_output, change_output, per_point
from engine.diagnose.effects.kinds.clip import Clip
from engine.diagnose.effects.kinds.inputs import INPUT_OFFSET
from engine.diagnose.effects.origin import Origin
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import Traits
from engine.statespace.model import Array, MixedModel, Parameter
from engine.statespace.promotion import promote
from engine.units import product


def observers(setting: Setting, model: MixedModel, output: str) -> list[str]:
    """The linear states that this output sees, somewhere on the record."""
    row, seen = list(model.outputs).index(output), np.zeros(model.nz, dtype=bool)
    points, theta = setting.points(model)
    for x, u, t in zip(points.x, points.u, points.t, strict=True):
        _, C, _ = model.observation(x[None, : model.na], u, float(t), model.record(theta))
        seen |= (C if C.ndim == 2 else C[0])[row] != 0.0
    return [name for name, there in zip(model.linear, seen, strict=True) if there]


def _curve(
    kind: str,
    title: str,
    formula: str,
    curve: Callable[[Any], Any],
    unit_power: float,
    look_alikes: dict[str, str],
    limits: tuple[float, float] = (-np.inf, np.inf),
) -> Kind:
    """A kind ``reading = y + size * curve(y)``, y the noise-free output, counted from its zero."""

    def make(setting: Setting, channel: str, name: str) -> Effect:
        origin = Origin(setting, name, channel)
        unit = product((setting.unit(channel), unit_power))

        def bent(y: Any, own: Sequence[Any]) -> Any:
            return own[0] * curve(y - origin.of(own))

        return Effect(
            kind,
            channel,
            "measurement",
            f"{title} of the sensor {channel}",
            f"{channel} = y + {name} * {formula.format(y=origin.text('y'))}",
            extend=lambda model: _bend(model, setting, channel, bent),
            look_alikes=look_alikes,
            one_sided=limits[0] == 0.0,
            **origin.counted(Parameter(name, 0.0, unit, limits, title)),
        )

    return at_outputs(kind, make)


def _bend(
    model: MixedModel,
    setting: Setting,
    channel: str,
    bent: Callable[[Any, Sequence[Any]], Any],
) -> MixedModel:
    """The reading y + bent(y, own values), y the noise-free output."""
    base = promote(model, observers(setting, model, channel))
    row = list(base.outputs).index(channel)

    def change(a: Array, u: Any, t: Any, h: Array, C: Array, R: Array, own: Any) -> Any:
        h = h.copy()
        h[:, row] += bent(h[:, row], own)
        return h, C, R

    return change_output(base, Split(model), change)


def _saturation(setting: Setting, channel: str, name: str) -> Effect:
    """A sensor that clips: at an upper limit, at a lower one, or at both, alike far from its zero."""
    clip = Clip(setting, name, channel)
    return Effect(
        "saturation-sensor",
        channel,
        "measurement",
        f"saturation of the sensor {channel}",
        f"{channel} = y - {name} * {clip.text('y')}",
        extend=lambda model: _bend(
            model, setting, channel, lambda y, own: -own[0] * clip.excess(y, own)
        ),
        look_alikes={
            "gain": "acts on small readings too",
            "cubic-sensor": "bends everywhere",
            "heavy-tails": "comes at any reading",
        },
        one_sided=True,
        **clip.members,
    )


def _bias(setting: Setting, channel: str, name: str) -> Effect:
    return Effect(
        "bias",
        channel,
        "measurement",
        f"constant offset of the sensor {channel}",
        f"{channel} = ... + {name}",
        (Parameter(name, 0.0, setting.unit(channel), description="sensor bias"),),
        lambda model: add_to_output(model, channel, lambda v, own: own[0]),
        look_alikes={"force": "moves the state, not only the reading", "drift": "grows with time"},
        traits=Traits(plainness=0),
    )


BIAS = at_outputs("bias", _bias)


def _offset(setting: Setting, channel: str) -> Effect | None:
    """Another word for it, at an output or an input."""
    effect = BIAS[1](setting, channel) or INPUT_OFFSET[1](setting, channel)
    return None if effect is None else replace(effect, kind="offset")


def _drift(setting: Setting, channel: str, name: str) -> Effect:
    start, clock = setting.run[0], setting.anew
    return Effect(
        "drift",
        channel,
        "measurement",
        f"drift of the sensor {channel}",
        f"{channel} = ... + {name} * (t - {name}_start){setting.counted}",
        (
            Parameter(name, 0.0, setting.rate(channel), description="sensor drift"),
            Parameter(f"{name}_start", start, setting.time_unit, description="when it is zero"),
        ),
        lambda model: add_to_output(model, channel, lambda v, own: own[0] * (clock(v.t) - own[1])),
        probes=((start,),),
        look_alikes={"bias": "does not grow", "ramp": "moves the state"},
        held=(f"{name}_start",),
        traits=Traits(swallowed=True),
    )


def magnified(h: Array, C: Array, row: int, gain: Any, zero: Any) -> tuple[Array, Array]:
    """h (M, ny) and C with an output 1 + gain times as far from its zero, the gain a number or (M,)."""
    h, C = h.copy(), per_point(C, len(h), gain)
    h[:, row] += gain * (h[:, row] - zero)
    C[..., row, :] *= 1.0 + (np.reshape(gain, (-1, 1)) if np.ndim(gain) else gain)
    return h, C


def _gain(setting: Setting, channel: str, name: str) -> Effect:
    origin = Origin(setting, name, channel)

    def extend(model: MixedModel) -> MixedModel:
        row = list(model.outputs).index(channel)

        def change(a: Array, u: Any, t: Any, h: Array, C: Array, R: Array, own: Any) -> Any:
            return *magnified(h, C, row, own[0], origin.of(own)), R

        return change_output(model, Split(model), change)

    return Effect(
        "gain",
        channel,
        "measurement",
        f"gain error of the sensor {channel}",
        f"{channel} = y + {name} * {origin.text('y')}",
        extend=extend,
        look_alikes={"saturation-sensor": "acts on large readings only"},
        **origin.proportional(Parameter(name, 0.0, "1", (-0.99, 10.0), "relative gain error")),
    )


KINDS: list[Kind] = [
    BIAS,
    ("offset", _offset, lambda setting: ()),  # by name only: listed as bias
    at_outputs("drift", _drift),
    at_outputs("gain", _gain),
    _curve(
        "cubic-sensor",
        "cubic characteristic",
        "{y}^3",
        lambda y: y * y * y,
        -2,
        {"gain": "is linear"},
    ),
    at_outputs("saturation-sensor", _saturation),
    _curve(
        "rectification",
        "rectification",
        "(|{y}| - {y})",
        lambda y: np.abs(y) - y,
        0,
        {"bias": "is constant"},
        limits=(0.0, 1.0),
    ),
]
