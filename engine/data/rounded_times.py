"""Times that are those of an even clock, written with too few digits: 0.03, 0.07, 0.1 at 30 Hz.

Taken as they are, the model makes steps of 0.03 and 0.04 s, and what its states move in the difference is
noise of the readings.
"""

from __future__ import annotations

import numpy as np

from engine.arrays import Array
from engine.data.clock import EVEN, rounding_of, size_of

LEAST_ROWS = 10  # below which an uneven clock may look so by chance
TELLING = 0.02  # of the step, from which the rounding tells
COARSEST = 0.5  # of it, beyond which a longer step may be a gap
WRITTEN = ("s", "min", "h", "day")  # units beside the times' own; thousandths have the same digits
DIGITS = range(-3, 10)  # at which times may be rounded, behind the point
ONE_OFF = 1.05  # of the rounding, within which times lie around a clock whose step is estimated
LONG = 1.5  # usual steps: a gap
MOST_DIGITS = 12  # of the step


def rounded_times(t: Array, unit: str) -> str:
    """A note of times (T,) that an even clock explains, but for the digits they have; "" of all others.

    Gaps are whole numbers of steps. Digits show in the unit in which times were written,
    hours that a file is converted from or seconds of dates that count as minutes.
    """
    steps = np.diff(t)
    if len(t) < LEAST_ROWS or not (steps > 0.0).all():
        return ""
    short = steps[steps < LONG * np.median(steps)]
    if np.allclose(short, short.mean(), rtol=EVEN, atol=rounding_of(t)):
        return ""
    own = size_of(unit)
    sizes = {unit: 1.0} | ({one: (size_of(one) or own) / own for one in WRITTEN} if own else {})
    said = (_rounded_in(one, size, t, unit) for one, size in sizes.items())
    return next(filter(None, said), "")


def _rounded_in(written: str, size: float, t: Array, unit: str) -> str:
    """The note where times (T,) in a ``unit`` are rounded in another, which has ``size`` of it; else ""."""
    counted = t / size
    digits = next(
        (d for d in DIGITS if np.abs(counted - counted.round(d)).max() <= rounding_of(counted)),
        None,
    )
    if digits is None:
        return ""
    resolution = size * 10.0**-digits
    steps = np.diff(t)
    short = steps[steps < LONG * np.median(steps)]
    usual = float(short.mean())
    if not TELLING * usual <= resolution <= COARSEST * usual:
        return ""
    rows = np.concatenate([[0.0], np.cumsum((steps / usual).round())])
    exact = float(np.polyfit(rows - rows.mean(), t - t[0], 1)[0])

    def explains(step: float) -> bool:
        return bool(np.ptp(t - t[0] - step * rows) <= ONE_OFF * resolution)

    if not explains(exact):
        return ""
    fewer = (float(f"{exact:.{n}g}") for n in range(1, MOST_DIGITS))
    step = f"{next((one for one in fewer if explains(one)), exact):.{MOST_DIGITS}g}"
    found = size * np.unique((short / size).round(digits))
    of, by = (f" {one}" if one else "" for one in (unit, written))
    return (
        f"times are rounded to {10.0**-digits:g}{by}: one even step of {step}{of} explains all of them. Taken "
        f"as they are, steps are of {' and '.join(f'{x:g}' for x in found)}{of}, and what the states move in "
        f"the difference counts as noise: give dt={step} and no times, or times with more digits."
    )
