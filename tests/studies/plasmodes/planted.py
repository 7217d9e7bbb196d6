"""What is put into a record: into its readings, or into what it says of its input.

The plant is not asked again. So an effect of the input is put in by changing the record of the input, such
that the measured input is what the model's input with the effect would be: an offset of the input by taking the
offset from the record, a delay by recording the input earlier than it acted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from engine.data.series import Series
from engine.statespace.model import Array

BETWEEN = (0.3, 0.7)  # of the window: where times lie
PERIODS = (15.0, 60.0)  # samples of a harmonic's period
OUTLIERS, GROWING = "outliers", "growing"
NOISE = 0.7  # of the standard deviation of noisy readings
OUTLYING = 0.03  # of the readings ...
SEARCHED = 0.8  # ... before what a diagnosis holds out, since seed 6, of which some had one that was searched


@dataclass(frozen=True)
class Place:
    """A random place: a time in the window, a phase, the seed of what is scattered; each of (0, 1)."""

    time: float
    phase: float
    scattered: int

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Place:
        """One at random."""
        return cls(float(rng.random()), float(rng.random()), int(rng.integers(2**31)))


@dataclass(frozen=True)
class Put:
    """What is put in: ``change(x, t, size, place)`` of the channel's values x (T,) at samples t (T,).

    Times are in samples. ``truth`` are words for it, with {y} and {u} for channels and {gain} for the
    parameter that an input is multiplied by; the first is its name. ``first`` is a size to start from, as a
    share of the channel's standard deviation or, if ``plain``, in samples or in log variances; ``most`` the
    largest.
    ``scatter``: it adds none of a course but ``outliers``, or noise that is ``growing``. ``among_noise``: it
    makes sense where what readings show from one to the next is noise, as what depends on time or on the
    reading alone does.
    """

    truth: tuple[str, ...]
    on_input: bool
    change: Callable[[Array, Array, float, Place], Array]
    first: float = 0.1
    most: float = 3.0
    plain: bool = False
    scatter: str = ""
    among_noise: bool = False


def put_in(what: Put, series: Series, size: float, place: Place) -> Series:
    """The series with it: of a size in the channel's own standard deviations, or plain."""
    t = np.arange(len(series), dtype=float)
    if what.on_input:
        u = series.u.copy()
        scale = 1.0 if what.plain else float(np.std(u[:, 0]))
        u[:, 0] = what.change(u[:, 0], t, size * scale, place)
        return series.replace(u=u)
    y = series.y.copy()
    scale = 1.0 if what.plain else float(np.nanstd(y[:, 0]))
    y[:, 0] = what.change(y[:, 0], t, size * scale, place)
    return series.replace(y=y)


def _at(t: Array, place: Place) -> float:
    return float(round((BETWEEN[0] + (BETWEEN[1] - BETWEEN[0]) * place.time) * len(t)))


def _step(x: Array, t: Array, size: float, place: Place) -> Array:
    return x + size * (t >= _at(t, place))


def _drift(x: Array, t: Array, size: float, place: Place) -> Array:
    return np.asarray(x + size * t / t[-1])


def _offset(x: Array, t: Array, size: float, place: Place) -> Array:
    return x + size


def _harmonic(x: Array, t: Array, size: float, place: Place) -> Array:
    period = PERIODS[0] + (PERIODS[1] - PERIODS[0]) * place.time
    return np.asarray(x + size * np.sin(2.0 * np.pi * (t / period + place.phase)))


def _cubic(x: Array, t: Array, size: float, place: Place) -> Array:
    """Of the size at the ends of the range, counted from its middle."""
    low, high = np.nanmin(x), np.nanmax(x)
    return np.asarray(x + size * ((x - 0.5 * (low + high)) / (0.5 * (high - low))) ** 3)


def _clipped(x: Array, t: Array, size: float, place: Place) -> Array:
    return np.asarray(np.minimum(x, np.nanmax(x) - size))


def _late(x: Array, t: Array, size: float, place: Place) -> Array:
    """Of a dead time; before the record began it is not known."""
    seen = np.isfinite(x)
    y = np.interp(t - size, t[seen], x[seen])
    return np.where(seen & (t >= t[seen][0] + size), y, np.nan)


def _slow(x: Array, t: Array, size: float, place: Place) -> Array:
    """Through a lag of first order, readings joined by straight lines."""
    y, seen = np.array(x), np.flatnonzero(np.isfinite(x))
    for i, j in pairwise(seen):
        T = float(t[j] - t[i])
        slope, decay = (x[j] - x[i]) / T, np.exp(-T / size)
        y[j] = x[j] - slope * size + (y[i] - x[i] + slope * size) * decay
    return y


def _play(x: Array, t: Array, size: float, place: Place) -> Array:
    """Of this width: the reading is moved by whichever flank is touched."""
    y, now = np.array(x), np.nan
    for k in np.flatnonzero(np.isfinite(x)):
        now = x[k] if np.isnan(now) else np.clip(now, x[k] - 0.5 * size, x[k] + 0.5 * size)
        y[k] = now
    return y


def _outliers(x: Array, t: Array, size: float, place: Place) -> Array:
    rng = np.random.default_rng(place.scattered)
    seen = np.flatnonzero(np.isfinite(x))
    seen = seen[seen < SEARCHED * len(x)]  # of others a search knows nothing
    hit = rng.choice(seen, int(np.ceil(OUTLYING * len(seen))), replace=False)
    y = np.array(x)
    # of normal sizes one alone would be seen, and be a pulse
    way = rng.choice([-1.0, 1.0], len(hit))
    y[hit] += size * way * rng.uniform(0.7, 1.3, len(hit))
    return y


def _pulse(x: Array, t: Array, size: float, place: Place) -> Array:
    """One reading alone, the next that is there."""
    y, seen = np.array(x), np.flatnonzero(np.isfinite(x))
    y[seen[np.searchsorted(seen, _at(t, place))]] += size if place.phase < 0.5 else -size
    return y


def _noisier(x: Array, t: Array, size: float, place: Place) -> Array:
    """Scatter that makes noise grow, once half of all that is seen: its log variance by so much in the end."""
    scatter = np.random.default_rng(place.scattered).standard_normal(len(x))
    return np.asarray(x + NOISE * np.nanstd(x) * np.sqrt(np.expm1(size * t / t[-1])) * scatter)


def _early(x: Array, t: Array, size: float, place: Place) -> Array:
    return np.asarray(np.interp(t + size, t, x))


def _less(x: Array, t: Array, size: float, place: Place) -> Array:
    return x - size


def _beyond_dead_zone(x: Array, t: Array, size: float, place: Place) -> Array:
    """What must have been asked for, if so much of it is swallowed on either side of zero."""
    return np.asarray(x + size * np.sign(x))


def _less_gain(x: Array, t: Array, size: float, place: Place) -> Array:
    """The plant answers ``1 + size / std`` times as much from a time on."""
    scale = float(np.std(x))
    return np.asarray(x / (1.0 + size / scale * (t >= _at(t, place))))


PUTS: dict[str, Put] = {
    put.truth[0]: put
    for put in (
        Put(("step:{y}",), False, _step, among_noise=True),
        Put(("drift:{y}",), False, _drift, among_noise=True),
        Put(("bias:{y}",), False, _offset, among_noise=True),
        # a wave of a level that nothing else moves is a wave of its readings, said since seed 6
        Put(("harmonic:{y}", "harmonic:level"), False, _harmonic, among_noise=True),
        Put(("cubic-sensor:{y}",), False, _cubic),
        Put(("saturation-sensor:{y}",), False, _clipped),
        Put(("delay:{y}",), False, _late, 0.2, 10.0, plain=True),
        Put(("slow-sensor:{y}", "lag:{y}"), False, _slow, 0.2, 20.0, plain=True),
        Put(("play:{y}",), False, _play),
        Put(("heavy-tails:{y}",), False, _outliers, most=20.0, scatter=OUTLIERS, among_noise=True),
        Put(("pulse:{y}",), False, _pulse, most=20.0, among_noise=True),
        Put(("variance:{y}->time",), False, _noisier, 1.0, 8.0, True, GROWING, True),
        Put(("input-offset:{u}",), True, _less),
        Put(("delay:{u}",), True, _early, 0.2, 10.0, plain=True),
        Put(("input-deadzone:{u}",), True, _beyond_dead_zone, most=1.0),
        Put(("parameter-step:{gain}",), True, _less_gain, most=0.9, among_noise=True),
    )
}
