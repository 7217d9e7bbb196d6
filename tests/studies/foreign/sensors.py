"""What may be wrong with a sensor; outputs go by their place."""

from __future__ import annotations

import math

import numpy as np

from tests.studies.foreign.faults import at_some_frequency, at_some_time
from tests.studies.foreign.plant import LEVELS, Array, Fault, Numbers, Own

OUTLIER = 4.0


def _at(y: Array, channel: int, values: Array) -> Array:
    out = y.copy()
    out[:, channel] = values
    return out


def bias(name: str, channel: int, first: float) -> Fault:
    """It reads size too much."""
    return Fault(name, first, read=lambda y, h, s, own: _at(y, channel, y[:, channel] + s))


def gain(name: str, channel: int, zero: float, first: float) -> Fault:
    """It reads (1 + size) times what is above its zero."""
    return Fault(
        name,
        first,
        5.0,
        read=lambda y, h, s, own: _at(y, channel, y[:, channel] + s * (y[:, channel] - zero)),
    )


def drift(name: str, channel: int, first: float) -> Fault:
    """It reads more and more, by size per second."""
    return Fault(
        name,
        first,
        read=lambda y, h, s, own: _at(y, channel, y[:, channel] + s * h * np.arange(len(y))),
        told=lambda s, own: {"": s, "start": 0.0},
    )


def step(name: str, channel: int, first: float) -> Fault:
    """It reads size more from some time on."""
    return Fault(
        name,
        first,
        read=lambda y, h, s, own: _at(
            y, channel, y[:, channel] + s * (h * np.arange(len(y)) >= own["time"] - 1e-9)
        ),
        draw=at_some_time,
    )


def harmonic(name: str, channel: int, first: float) -> Fault:
    """Hum on the reading."""

    def read(y: Array, h: float, s: float, own: Own) -> Array:
        angle = 2.0 * math.pi * own["frequency"] * h * np.arange(len(y)) + own["phase"]
        return _at(y, channel, y[:, channel] + s * np.sin(angle))

    def told(s: float, own: Own) -> dict[str, float]:
        phase = own["phase"]
        sine = s * math.cos(phase)
        return {"": s * math.sin(phase), "sine": sine, "frequency": own["frequency"]}

    return Fault(name, first, read=read, draw=at_some_frequency, told=told)


def lag(name: str, channel: int, dt: float, first: float) -> Fault:
    """A first-order lag of size seconds, which has settled when the record begins."""

    def read(y: Array, h: float, s: float, own: Own) -> Array:
        out = np.empty(len(y))
        level, keep = float(y[0, channel]), math.exp(-h / s) if s > 0.0 else 0.0
        for k, value in enumerate(y[:, channel].tolist()):
            level = value + keep * (level - value)
            out[k] = level
        return _at(y, channel, out)

    return Fault(
        name,
        first,
        0.5 * dt,
        LEVELS[1],  # a lag that is long beside a sample is not one of the catalogue's
        read=read,
        told=lambda s, own: {"": math.exp(-dt / max(s, 1e-9 * dt))},
    )


def clip(name: str, channel: int, top: float, first: float, most: float) -> Fault:
    """It reads nothing above top - size."""
    return Fault(
        name,
        first,
        most,
        read=lambda y, h, s, own: _at(y, channel, np.minimum(y[:, channel], top - s)),
        told=lambda s, own: {"": 1.0, "limit": top - s},
    )


def outliers(name: str, channel: int, first: float) -> Fault:
    """A share (the size) of the readings has OUTLIER times the usual noise."""

    def noisy(e: Array, std: Numbers, s: float, own: Own, rng: np.random.Generator) -> Array:
        hit = rng.random(len(e)) < s
        return _at(e, channel, np.where(hit, OUTLIER * e[:, channel], e[:, channel]))

    return Fault(
        name,
        first,
        0.3,
        noisy=noisy,
        level=LEVELS[0],
        told=lambda s, own: {"": s, "share": s, "ratio": OUTLIER},
    )


def coloured(name: str, channel: int, samples: float, std: float, first: float) -> Fault:
    """More noise, of size times the standard deviation ``std``, that lasts so many samples."""

    def noisy(e: Array, all_std: Numbers, s: float, own: Own, rng: np.random.Generator) -> Array:
        keep = math.exp(-1.0 / samples)
        slow, more = 0.0, np.empty(len(e))
        kicks = rng.standard_normal(len(e)).tolist()
        slow = kicks[0]
        for k, kick in enumerate(kicks):
            if k:
                slow = keep * slow + math.sqrt(1.0 - keep * keep) * kick
            more[k] = s * std * slow
        return _at(e, channel, e[:, channel] + more)

    return Fault(
        name,
        first,
        noisy=noisy,
        level=LEVELS[0],
        draw=lambda rng, seconds, dt: {"time": samples * dt},
        told=lambda s, own: {**own, "": (s * std) ** 2},
    )


def rounded(name: str, channel: int, first: float) -> Fault:
    """Readings in steps of size."""
    return Fault(
        name,
        first,
        level=LEVELS[0],
        finish=lambda y, s: _at(
            y, channel, s * np.round(y[:, channel] / s) if s > 0.0 else y[:, channel]
        ),
        told=lambda s, own: {"": s * s / 12.0},
    )


def play(name: str, channel: int, first: float) -> Fault:
    """Backlash of the half-width size between the plant and its sensor."""

    def read(y: Array, h: float, s: float, own: Own) -> Array:
        out = y.copy()
        at = float(y[0, channel])
        for k, value in enumerate(y[:, channel].tolist()):
            at = min(max(at, value - s), value + s)
            out[k, channel] = at
        return out

    return Fault(name, first, read=read)
