"""Times that are those of an even clock, written with too few digits: 0.03, 0.07, 0.1 at 30 Hz.

Taken as they are, the model makes steps of 0.03 and 0.04 s, and what its states move in the difference is
noise of the readings.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from engine.arrays import Array
from engine.units import time_size

EVEN = 1e-6  # of a step, by which those at one common step may differ
LEAST_ROWS = 10  # below which an uneven clock may look so by chance
TELLING = 0.02  # of the step, from which the rounding tells
COARSEST = 0.5  # of it, beyond which a longer step may be a gap
WRITTEN = ("s", "min", "h", "day")  # units beside the times' own; thousandths have the same digits
DIGITS = range(-3, 10)  # at which times may be rounded, behind the point
ONE_OFF = 1.05  # of the rounding, within which times lie around a clock whose step is estimated
LONG = 1.5  # usual steps: a gap
MOST_DIGITS = 12  # of the step


def rounding_of(t: Any) -> float:
    """By how much differences of times t may be off: a clock that counts since 1970 tells 2e-7 s at best."""
    return float(2.0 * np.finfo(float).eps * np.abs(t).max())


def rounded_times(t: Array, unit: str) -> str:
    """A note of times (T,) that an even clock explains, but for the digits they have; "" of all others.

    Gaps are whole numbers of steps. Digits show in the unit in which times were written, hours
    that a file is converted from or seconds of dates that count as minutes.
    """
    steps = np.diff(t)
    if len(t) < LEAST_ROWS or not (steps > 0.0).all():
        return ""
    short = steps[steps < LONG * np.median(steps)]
    usual = float(short.mean())
    if np.allclose(short, usual, rtol=EVEN, atol=rounding_of(t)):
        return ""
    rows = _rows(steps, usual)
    exact = float(np.polyfit(rows - rows.mean(), t - t[0], 1)[0])
    for written, size, digits in _digits(t, unit):
        resolution = size * 10.0**-digits
        tells = TELLING * usual <= resolution <= COARSEST * usual
        if not (tells and _explains(exact, t, rows, resolution)):
            continue
        fewer = (float(f"{exact:.{n}g}") for n in range(1, MOST_DIGITS))
        step = next((one for one in fewer if _explains(one, t, rows, resolution)), exact)
        found = size * np.unique((short / size).round(digits))
        of, by = (f" {one}" if one else "" for one in (unit, written))
        return (
            f"times are rounded to {10.0**-digits:g}{by}: one even step of {step:.{MOST_DIGITS}g}{of} explains "
            f"all of them. Taken as they are, steps are of {' and '.join(f'{x:g}' for x in found)}{of}, and "
            "what the states move in the difference counts as noise: "
            f"give dt={step:.{MOST_DIGITS}g} as well, or times with more digits."
        )
    return ""


def evened(t: Array, dt: float, unit: str) -> Array | None:
    """Times (T,) of an even clock with this step, where it explains all but their digits; else None."""
    steps = np.diff(t)
    if len(t) < LEAST_ROWS or not (dt > 0.0 and (steps > 0.0).all()):
        return None
    if np.allclose(steps, dt, rtol=EVEN, atol=rounding_of(t)):
        return None  # they are even
    rows = _rows(steps, dt)
    for _, size, digits in _digits(t, unit):
        resolution = size * 10.0**-digits
        if resolution <= COARSEST * dt and _explains(dt, t, rows, resolution):
            return np.asarray(t[0] + dt * rows)
    return None


def _rows(steps: Array, step: float) -> Array:
    """Numbers (T,) of a clock's steps before each row."""
    return np.concatenate([[0.0], np.cumsum((steps / step).round())])


def _explains(step: float, t: Array, rows: Array, resolution: float) -> bool:
    return bool(np.ptp(t - t[0] - step * rows) <= ONE_OFF * resolution)


def _digits(t: Array, unit: str) -> Iterator[tuple[str, float, int]]:
    """Units in which times may have been written, the size of each in their own, and the digits there are."""
    own = time_size(unit)
    sizes = {unit: 1.0}
    if own is not None:
        sizes |= {one: (time_size(one) or own) / own for one in WRITTEN}
    for written, size in sizes.items():
        counted = t / size
        off = rounding_of(counted)
        found = (d for d in DIGITS if np.abs(counted - counted.round(d)).max() <= off)
        if (digits := next(found, None)) is not None:
            yield written, size, digits
