"""What may be wrong with a plant's equations or with what drives it; each is a kind of the catalogue.

States, inputs and outputs go by their place. ``zero`` is the natural zero of a channel in its unit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from tests.studies.foreign.plant import Array, Fault, Numbers, Own, Push

BETWEEN = (0.3, 0.7)  # of the training part: where times lie
PERIODS = (20.0, 60.0)  # samples of a harmonic's period
SHARP = 200.0  # sign(v) is tanh(SHARP v / scale): no chatter between fine steps

Term = Callable[[float, Numbers, Numbers, Own], float]


def at_some_time(rng: np.random.Generator, seconds: float, dt: float) -> dict[str, float]:
    """A sample's time within the middle of the record."""
    return {"time": round(float(rng.uniform(*BETWEEN)) * seconds / dt) * dt}


def at_some_frequency(rng: np.random.Generator, seconds: float, dt: float) -> dict[str, float]:
    """Cycles per second, and a phase."""
    return {
        "frequency": 1.0 / (float(rng.uniform(*PERIODS)) * dt),
        "phase": float(rng.uniform(0.0, 2.0 * math.pi)),
    }


def onto(state: int, of: int, term: Term) -> Push:
    """A push on one of the ``of`` states: size * term(t, x, u, own)."""

    def push(
        t: float, x: Numbers, m: Numbers, u: Numbers, s: float, own: Own
    ) -> tuple[list[float], list[float]]:
        dx = [0.0] * of
        dx[state] = s * term(t, x, u, own)
        return dx, []

    return push


def force(
    name: str, state: int, of: int, term: Term, first: float, most: float = math.inf
) -> Fault:
    """Any force that depends on the state: size * term."""
    return Fault(name, first, most, push=onto(state, of, term))


def sign(v: float, scale: float) -> float:
    """The sign of v, smooth within a fraction of the scale."""
    return math.tanh(SHARP * v / scale)


def step(name: str, state: int, of: int, first: float) -> Fault:
    """A constant force from some time on."""
    return Fault(
        name,
        first,
        push=onto(state, of, lambda t, x, u, own: float(t >= own["time"] - 1e-9)),
        draw=at_some_time,
    )


def harmonic(name: str, state: int, of: int, first: float) -> Fault:
    """A force that swings at one frequency."""

    def told(s: float, own: Own) -> dict[str, float]:
        phase = own["phase"]
        sine = s * math.cos(phase)
        return {"": s * math.sin(phase), "sine": sine, "frequency": own["frequency"]}

    return Fault(
        name,
        first,
        push=onto(
            state,
            of,
            lambda t, x, u, own: math.sin(2.0 * math.pi * own["frequency"] * t + own["phase"]),
        ),
        draw=at_some_frequency,
        told=told,
    )


def pole(name: str, source: int, state: int, of: int, seconds: float, first: float) -> Fault:
    """A lag l of a state acts back: dl = (x - l) / tau dt, dx = ... + size (l - x) dt."""

    def push(
        t: float, x: Numbers, m: Numbers, u: Numbers, s: float, own: Own
    ) -> tuple[list[float], list[float]]:
        dx = [0.0] * of
        dx[state] = s * (m[0] - x[source])
        return dx, [(x[source] - m[0]) / seconds]

    return Fault(
        name,
        first,
        begin=lambda x: [x[source]],
        push=push,
        told=lambda s, own: {"": s, "time": seconds},
    )


def hysteresis(name: str, source: int, state: int, of: int, width: float, first: float) -> Fault:
    """Bouc-Wen with n = 1: dm = (v - |v| m / width) dt, dx = ... + size m dt."""

    def push(
        t: float, x: Numbers, m: Numbers, u: Numbers, s: float, own: Own
    ) -> tuple[list[float], list[float]]:
        v = x[source]
        dx = [0.0] * of
        dx[state] = s * m[0]
        return dx, [v - abs(v) * m[0] / width]

    return Fault(
        name,
        first,
        begin=lambda x: [0.0],
        push=push,
        told=lambda s, own: {"": s, "width": width},
    )


def parameter_step(parameter: str, first: float, most: float = math.inf) -> Fault:
    """A parameter is larger by size (a share of its value) from some time on."""

    def changed(t: float, p: Mapping[str, float], s: float, own: Own) -> Mapping[str, float]:
        return {**p, parameter: p[parameter] * (1.0 + s)} if t >= own["time"] - 1e-9 else p

    return Fault(f"parameter-step:{parameter}", first, most, changed=changed, draw=at_some_time)


def parameter_drift(parameter: str, seconds: float, first: float, most: float = math.inf) -> Fault:
    """A parameter grows in a straight line, by size (a share) in so many seconds."""

    def changed(t: float, p: Mapping[str, float], s: float, own: Own) -> Mapping[str, float]:
        return {**p, parameter: p[parameter] * (1.0 + s * (t / seconds - 0.5))}

    return Fault(f"parameter-drift:{parameter}", first, most, changed=changed)


def input_offset(name: str, channel: int, first: float) -> Fault:
    """The plant gets u + size."""
    return Fault(name, first, drive=lambda u, s, own: _at(u, channel, u[:, channel] + s))


def input_dead_zone(name: str, channel: int, first: float) -> Fault:
    """Nothing happens within +-size."""
    return Fault(
        name,
        first,
        drive=lambda u, s, own: _at(
            u, channel, np.sign(u[:, channel]) * np.maximum(np.abs(u[:, channel]) - s, 0.0)
        ),
    )


def input_saturation(name: str, channel: int, top: float, first: float) -> Fault:
    """The actuator reaches top - size, in either direction."""
    return Fault(
        name,
        first,
        0.9 * top,
        drive=lambda u, s, own: _at(u, channel, np.clip(u[:, channel], s - top, top - s)),
        told=lambda s, own: {"": 1.0, "limit": top - s},
    )


def input_delay(name: str, channel: int, substeps: int, first: float) -> Fault:
    """The input arrives size samples late (of ``substeps`` fine steps each)."""

    def drive(u: Array, s: float, own: Own) -> Array:
        steps = s * substeps
        whole = int(steps)
        at = np.arange(len(u))
        early = u[np.maximum(at - whole, 0), channel]
        late = u[np.maximum(at - whole - 1, 0), channel]
        return _at(u, channel, early + (steps - whole) * (late - early))

    return Fault(name, first, 4.0, drive=drive)


def _at(u: Array, channel: int, values: Array) -> Array:
    out = u.copy()
    out[:, channel] = values
    return out
