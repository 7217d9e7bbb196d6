"""Times that may be others than they are taken for: across a change of clocks, or days of a spreadsheet."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta

import numpy as np

from engine.arrays import Array

HOUR, DAY = 3600.0, 86400.0
SUNDAY = 6
LATEST = 3  # o'clock, at which clocks are set forward somewhere
# Of a spreadsheet, which counts days: 1982 to 2064, in steps of so many seconds. Taken for seconds they are
# 24 Hz and more, at frequencies that few recorders have; steps of a day would be seconds.
DAYS = (30_000.0, 60_000.0)
USUAL_STEPS = (1, 2, 5, 10, 15, 20, 30, 60, 120, 300, 600, 900, 1800, 3600)
STEP_ERROR = 2e-4  # of the mean step, as days are rounded


def set_forward(dates: Sequence[datetime]) -> str:
    """A note of where dates without a zone leave out the hour that summer time does; "" where they do not.

    The step is longer than usual by just this hour, in a night to Sunday.
    """
    if len(dates) < 3 or dates[0].tzinfo is not None:
        return ""
    steps = np.diff(np.array(dates, dtype="datetime64[us]")) / np.timedelta64(1, "s")
    usual = float(np.median(steps))
    far = np.abs(steps - usual - HOUR) <= 0.1 * min(usual, HOUR)
    for row in np.flatnonzero(far).tolist():
        before, after = dates[row], dates[row + 1]
        left_out = (after - timedelta(hours=1)).replace(minute=0, second=0, microsecond=0)
        if before < left_out and left_out.weekday() == SUNDAY and left_out.hour <= LATEST:
            return (
                f"a gap of {steps[row]:g} s ends at row {row + 1} ({after}), an hour more than usual: if "
                "clocks were set forward to summer time there, write the time stamps with their zone, as in "
                "2024-03-31T03:00:00+02:00."
            )
    return ""


def days_of_spreadsheet(times: Array) -> str:
    """A note of numbers that look like the days that spreadsheets keep dates as; "" where they do not."""
    if len(times) < 3 or not (DAYS[0] <= times[0] < times[-1] <= DAYS[1]):
        return ""
    seconds = DAY * float(times[-1] - times[0]) / (len(times) - 1)
    nearest = min(USUAL_STEPS, key=lambda step: abs(step - seconds))
    if abs(seconds - nearest) > STEP_ERROR * nearest:
        return ""
    return (
        f"times from {times[0]:.10g} to {times[-1]:.10g} look like days of a spreadsheet, one row every "
        f"{nearest} s, and count as seconds: if they are days, write dates such as 2024-03-01 13:45:00, or "
        f"multiply them by {DAY:g}."
    )
