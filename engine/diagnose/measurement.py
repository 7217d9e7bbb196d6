"""Effects in the measurement equation: what a sensor does to the reading."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from engine.diagnose.effect import Effect, Split, add_to_output, identifier, on_base, per_point
from engine.diagnose.more_states import add_linear_states, beside
from engine.diagnose.setting import Kind, Maker, Setting, each_output
from engine.model import Array, MixedModel, Parameter
from engine.promote import promote

LONGEST_DELAY = 4  # samples


def _observers(model: MixedModel, output: str) -> list[str]:
    """The linear states that this output sees."""
    row = list(model.outputs).index(output)
    _, C, _ = model.observation(
        np.zeros((2, model.na)), np.zeros(model.nu), 0.0, model.record(model.theta())
    )
    seen = np.abs(C if C.ndim == 2 else C.max(axis=0))[row] > 0.0
    return [name for name, there in zip(model.linear, seen, strict=True) if there]


def _curve(
    kind: str,
    title: str,
    formula: str,
    curve: Callable[[Any, Sequence[Any]], Any],
    unit_power: float,
    look_alikes: dict[str, str],
    width: bool = False,
    limits: tuple[float, float] = (-np.inf, np.inf),
) -> Maker:
    """A kind ``reading = y + size * curve(y)``, y the noise-free output."""

    def make(setting: Setting, channel: str) -> Effect | None:
        if channel not in setting.model.outputs:
            return None
        name = identifier(kind, channel)
        scale = setting.size(channel)
        unit = setting.unit(channel)
        parameters = [
            Parameter(name, 0.0, f"{unit}^{unit_power:g}" if unit_power else "1", limits, title)
        ]
        if width:
            bounds = setting.limits(1e-3 * scale, 20.0 * scale, 1e-12)
            parameters.append(Parameter(f"{name}_limit", scale, unit, bounds, "where it bends"))

        def extend(model: MixedModel) -> MixedModel:
            base = promote(model, _observers(model, channel))
            split = Split(model)
            row = list(base.outputs).index(channel)

            def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
                own_base, own = split(theta)
                h, C, R = base.observation(a, u, t, own_base)
                h = h.copy()
                h[:, row] += own[0] * curve(h[:, row], own[1:])
                return h, C, R

            return on_base(base, split, measurement=measurement)

        return Effect(
            kind,
            channel,
            "measurement",
            f"{title} of the sensor {channel}",
            f"{channel} = y + {name} * {formula}",
            tuple(parameters),
            extend,
            probes=((0.7 * scale,), (1.5 * scale,)) if width else ((),),
            look_alikes=look_alikes,
        )

    return make


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
    )


def _offset(setting: Setting, channel: str) -> Effect | None:
    """Another word for it, at an output or an input."""
    from dataclasses import replace

    from engine.diagnose.inputs import input_offset

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
            Parameter(name, 0.0, f"{setting.unit(channel)}/s", description="sensor drift"),
            Parameter(f"{name}_start", start, "s", description="when it is zero"),
        ),
        lambda model: add_to_output(model, channel, lambda v, own: own[0] * (v.t - own[1])),
        probes=((start,),),
        look_alikes={"bias": "does not grow", "ramp": "moves the state"},
        held=(f"{name}_start",),
    )


def _gain(setting: Setting, channel: str) -> Effect | None:
    if channel not in setting.model.outputs:
        return None
    name = identifier("gain", channel)

    def extend(model: MixedModel) -> MixedModel:
        split = Split(model)
        row = list(model.outputs).index(channel)

        def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
            own_base, own = split(theta)
            h, C, R = model.observation(a, u, t, own_base)
            h, C = h.copy(), per_point(C, len(a), own[0])
            h[:, row] *= 1.0 + own[0]
            C[..., row, :] *= 1.0 + np.reshape(own[0], (-1, 1)) if np.ndim(own[0]) else 1.0 + own[0]
            return h, C, R

        return on_base(model, split, measurement=measurement)

    return Effect(
        "gain",
        channel,
        "measurement",
        f"gain error of the sensor {channel}",
        f"{channel} = (1 + {name}) * y",
        (Parameter(name, 0.0, "1", (-0.99, 10.0), "relative gain error"),),
        extend,
        look_alikes={"saturation-sensor": "acts on large readings only"},
    )


def _lag(setting: Setting, channel: str) -> Effect | None:
    """A share of the reading comes one sample late."""
    if channel not in setting.model.outputs:
        return None
    name = identifier("lag", channel)
    return Effect(
        "lag",
        channel,
        "measurement",
        f"lag of the sensor {channel}",
        f"{channel} = (1 - {name}) y_t + {name} y_(t-1)",
        (Parameter(name, 0.0, "1", (0.0, 1.0), "share that comes one sample late"),),
        lambda model: _late(model, setting, channel, 1, lambda own: [own[0]]),
        one_sided=True,
        look_alikes={
            "delay": "delays the input, or the reading by several samples",
            "colored": "is not driven by y",
        },
    )


def sensor_delay(setting: Setting, channel: str) -> Effect | None:
    """A share of the reading comes several samples late; all of it where the size is one."""
    if channel not in setting.model.outputs:
        return None
    name = identifier("delay", channel)

    def weights(own: Any) -> list[Any]:
        # held at a whole number, where one weight is the size; linear in between
        return [
            own[0] * np.maximum(1.0 - np.abs(own[1] - k), 0.0) for k in range(1, LONGEST_DELAY + 1)
        ]

    return Effect(
        "delay",
        channel,
        "measurement",
        f"delay of the sensor {channel}",
        f"{channel} = (1 - {name}) y_t + {name} y_(t-d),  d = {name}_samples",
        (
            Parameter(name, 0.0, "1", (0.0, 1.5), "share that comes late"),
            Parameter(f"{name}_samples", 2.0, "samples", (1.0, float(LONGEST_DELAY)), "how late"),
        ),
        lambda model: _late(model, setting, channel, LONGEST_DELAY, weights),
        probes=tuple((float(d),) for d in range(2, LONGEST_DELAY + 1)),
        look_alikes={"lag": "is over after one sample", "pole": "changes the motion itself"},
        held=(f"{name}_samples",),
        one_sided=True,
    )


def _late(
    model: MixedModel,
    setting: Setting,
    channel: str,
    depth: int,
    weights: Callable[[Any], list[Any]],
) -> MixedModel:
    """The reading (1 - sum w_k) y_t + sum w_k y_(t-k); the last ``depth`` values of y are states."""
    split = Split(model)
    row, nx, nz = list(model.outputs).index(channel), model.nx, model.nz
    shift = np.eye(depth, k=-1)

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        own_base, _ = split(theta)
        h, C, _ = model.observation(a, u, t, own_base)
        f, A, Q = beside(model.transition(a, u, t, dt, own_base), len(a), shift.tolist(), 0.0)
        f[:, nx] = h[:, row]
        if C.ndim == 3 and A.ndim == 2:
            A = np.repeat(A[None], len(a), axis=0)
        A[..., nx, :nz] = C[..., row, :]
        return f, A, Q

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        own_base, own = split(theta)
        h, C, R = model.observation(a, u, t, own_base)
        late = weights(own)
        now = 1.0 - sum(late)
        h = h.copy()
        C = np.concatenate([C, np.zeros((*C.shape[:-1], depth))], axis=-1)
        C = per_point(C, len(a), *late)
        h[:, row] *= now
        C[..., row, :] *= np.reshape(now, (-1, 1)) if np.ndim(now) else now
        for k, weight in enumerate(late):
            C[..., row, nz + k] = weight
        return h, C, R

    names = [f"last_{channel}", *(f"last_{channel}_{k}" for k in range(2, depth + 1))]
    states = dict.fromkeys(names, setting.unit(channel))
    return add_linear_states(model, split, states, dynamics, measurement=measurement)


KINDS: list[Kind] = [
    ("bias", _bias, each_output),
    ("offset", _offset, lambda setting: iter(())),  # by name only: listed as bias
    ("drift", _drift, each_output),
    ("gain", _gain, each_output),
    ("lag", _lag, each_output),
    (
        "cubic-sensor",
        _curve(
            "cubic-sensor",
            "cubic characteristic",
            "y^3",
            lambda y, own: y**3,
            -2,
            {"gain": "is linear"},
        ),
        each_output,
    ),
    (
        "saturation-sensor",
        _curve(
            "saturation-sensor",
            "saturation",
            "-(|y| - limit)+ sign(y)",
            lambda y, own: -np.sign(y) * np.maximum(np.abs(y) - own[0], 0.0),
            0,
            {"gain": "acts on small readings too", "cubic-sensor": "bends everywhere"},
            width=True,
            limits=(-1.0, 1.0),
        ),
        each_output,
    ),
    (
        "rectification",
        _curve(
            "rectification",
            "rectification",
            "(|y| - y)",
            lambda y, own: np.abs(y) - y,
            0,
            {"bias": "is constant"},
            limits=(-1.0, 1.0),
        ),
        each_output,
    ),
]
