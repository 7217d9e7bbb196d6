"""Effects in the measurement equation: what a sensor does to the reading."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from engine.diagnose.effects.clip import Clip
from engine.diagnose.effects.effect import (
    Effect,
    Split,
    add_to_output,
    identifier,
    on_base,
    per_point,
)
from engine.diagnose.effects.origin import Origin
from engine.diagnose.effects.setting import Kind, Maker, Setting, each_output
from engine.diagnose.effects.traits import Traits
from engine.diagnose.effects.units import product
from engine.statespace.model import Array, MixedModel, Parameter
from engine.statespace.promotion import promote


def _observers(setting: Setting, model: MixedModel, output: str) -> list[str]:
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
    curve: Callable[[Any, Sequence[Any]], Any],
    unit_power: float,
    look_alikes: dict[str, str],
    limits: tuple[float, float] = (-np.inf, np.inf),
) -> Maker:
    """A kind ``reading = y + size * curve(y)``, y the noise-free output, counted from its zero."""

    def make(setting: Setting, channel: str) -> Effect | None:
        if channel not in setting.model.outputs:
            return None
        name = identifier(kind, channel)
        origin = Origin(setting, name, channel)
        unit = product((setting.unit(channel), unit_power))

        def bent(y: Any, own: Sequence[Any]) -> Any:
            return own[0] * curve(y - origin.of(own), own[1:])

        return Effect(
            kind,
            channel,
            "measurement",
            f"{title} of the sensor {channel}",
            f"{channel} = y + {name} * {formula.format(y=origin.text('y'))}",
            (Parameter(name, 0.0, unit, limits, title), *origin.parameters),
            lambda model: _bend(model, setting, channel, bent),
            probes=(origin.probe,),
            look_alikes=look_alikes,
            held=origin.held,
            zero=origin.name,
            one_sided=limits[0] == 0.0,
        )

    return make


def _bend(
    model: MixedModel,
    setting: Setting,
    channel: str,
    bent: Callable[[Any, Sequence[Any]], Any],
) -> MixedModel:
    """The reading y + bent(y, own values), y the noise-free output."""
    base = promote(model, _observers(setting, model, channel))
    split = Split(model)
    row = list(base.outputs).index(channel)

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        own_base, own = split(theta)
        h, C, R = base.observation(a, u, t, own_base)
        h = h.copy()
        h[:, row] += bent(h[:, row], own)
        return h, C, R

    return on_base(base, split, measurement=measurement)


def _saturation(setting: Setting, channel: str) -> Effect | None:
    """A sensor that clips: at an upper limit, at a lower one, or at both, alike far from its zero."""
    if channel not in setting.model.outputs:
        return None
    name = identifier("saturation-sensor", channel)
    clip = Clip(setting, name, channel)
    return Effect(
        "saturation-sensor",
        channel,
        "measurement",
        f"saturation of the sensor {channel}",
        f"{channel} = y - {name} * {clip.text('y')}",
        (Parameter(name, 0.0, "1", (0.0, 1.0), "share of the excess lost"), *clip.parameters),
        lambda model: _bend(model, setting, channel, lambda y, own: -own[0] * clip.excess(y, own)),
        probes=clip.probes,
        look_alikes={
            "gain": "acts on small readings too",
            "cubic-sensor": "bends everywhere",
        },
        held=clip.held,
        zero=clip.zero,
        one_sided=True,
    )


def _bias(setting: Setting, channel: str) -> Effect | None:
    if channel not in setting.model.outputs:
        return None
    name = identifier("bias", channel)
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


def _offset(setting: Setting, channel: str) -> Effect | None:
    """Another word for it, at an output or an input."""
    from dataclasses import replace

    from engine.diagnose.effects.inputs import input_offset

    effect = _bias(setting, channel) or input_offset(setting, channel)
    if effect is None:
        return None
    return replace(effect, kind="offset")


def _drift(setting: Setting, channel: str) -> Effect | None:
    if channel not in setting.model.outputs:
        return None
    name, start = identifier("drift", channel), setting.span[0]
    return Effect(
        "drift",
        channel,
        "measurement",
        f"drift of the sensor {channel}",
        f"{channel} = ... + {name} * (t - {name}_start)",
        (
            Parameter(name, 0.0, setting.rate(channel), description="sensor drift"),
            Parameter(f"{name}_start", start, "s", description="when it is zero"),
        ),
        lambda model: add_to_output(model, channel, lambda v, own: own[0] * (v.t - own[1])),
        probes=((start,),),
        look_alikes={"bias": "does not grow", "ramp": "moves the state"},
        held=(f"{name}_start",),
        traits=Traits(swallowed=True),
    )


def _gain(setting: Setting, channel: str) -> Effect | None:
    if channel not in setting.model.outputs:
        return None
    name = identifier("gain", channel)
    origin = Origin(setting, name, channel)

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)
        row = list(model.outputs).index(channel)

        def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            h, C, R = model.observation(a, u, t, own_base)
            h, C = h.copy(), per_point(C, len(a), own[0])
            h[:, row] += own[0] * (h[:, row] - origin.of(own))
            C[..., row, :] *= 1.0 + np.reshape(own[0], (-1, 1)) if np.ndim(own[0]) else 1.0 + own[0]
            return h, C, R

        return on_base(model, split, measurement=measurement)

    return Effect(
        "gain",
        channel,
        "measurement",
        f"gain error of the sensor {channel}",
        f"{channel} = y + {name} * {origin.text('y')}",
        (Parameter(name, 0.0, "1", (-0.99, 10.0), "relative gain error"), *origin.parameters),
        extend,
        probes=(origin.probe,),
        look_alikes={"saturation-sensor": "acts on large readings only"},
        held=origin.held,
        zero=origin.name,
    )


KINDS: list[Kind] = [
    ("bias", _bias, each_output),
    ("offset", _offset, lambda setting: iter(())),  # by name only: listed as bias
    ("drift", _drift, each_output),
    ("gain", _gain, each_output),
    (
        "cubic-sensor",
        _curve(
            "cubic-sensor",
            "cubic characteristic",
            "{y}^3",
            lambda y, own: y**3,
            -2,
            {"gain": "is linear"},
        ),
        each_output,
    ),
    ("saturation-sensor", _saturation, each_output),
    (
        "rectification",
        _curve(
            "rectification",
            "rectification",
            "(|{y}| - {y})",
            lambda y, own: np.abs(y) - y,
            0,
            {"bias": "is constant"},
            limits=(0.0, 1.0),
        ),
        each_output,
    ),
]
