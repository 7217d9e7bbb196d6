"""Times that are those of an even clock, written with too few digits: 0.03, 0.07, 0.1 at 30 Hz.

Taken as they are, the model makes steps of 0.03 and 0.04 s, and what its states move in the difference is
noise of the readings.
"""

from __future__ import annotations

import numpy as np

from engine.arrays import Array
from engine.data.clock import EVEN, rounding_of

LEAST_ROWS = 10  # below which an uneven clock may look so by chance
TELLING = 0.02  # of the step, from which the rounding tells
COARSEST = 0.5  # of it, beyond which a longer step may be a gap
DIGITS = range(-3, 10)  # at which times may be rounded, behind the point
ONE_OFF = 1.05  # of the rounding, within which times lie around a clock whose step is estimated
LONG = 1.5  # usual steps: a gap
MOST_DIGITS = 12  # of the step


def rounded_times(t: Array, unit: str) -> str:
    """A note of times (T,) that an even clock explains, but for the digits they have; "" of all others.

    Gaps are whole numbers of steps.
    """
    steps = np.diff(t)
    if len(t) < LEAST_ROWS or not (steps > 0.0).all():
        return ""
    digits = next((d for d in DIGITS if np.abs(t - t.round(d)).max() <= rounding_of(t)), None)
    if digits is None:
        return ""
    resolution = 10.0**-digits
    short = steps[steps < LONG * np.median(steps)]
    usual = float(short.mean())
    if not TELLING * usual <= resolution <= COARSEST * usual:
        return ""
    if np.allclose(short, usual, rtol=EVEN, atol=rounding_of(t)):
        return ""
    rows = np.concatenate([[0.0], np.cumsum((steps / usual).round())])
    exact = float(np.polyfit(rows - rows.mean(), t - t[0], 1)[0])

    def explains(step: float) -> bool:
        return bool(np.ptp(t - t[0] - step * rows) <= ONE_OFF * resolution)

    if not explains(exact):
        return ""
    fewer = (float(f"{exact:.{n}g}") for n in range(1, MOST_DIGITS))
    step = f"{next((one for one in fewer if explains(one)), exact):.{MOST_DIGITS}g}"
    found = np.unique(short.round(digits))
    of = f" {unit}" if unit else ""
    return (
        f"times are rounded to {resolution:g}{of}: one even step of {step}{of} explains all of them. Taken as "
        f"they are, steps are of {' and '.join(f'{x:g}' for x in found)}{of}, and what the states move in the "
        f"difference counts as noise: give dt={step} and no times, or times with more digits."
    )
