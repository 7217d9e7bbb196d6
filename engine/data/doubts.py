"""Times that may be others than they are taken for: across a change of clocks, days or digits of a clock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import date, datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.arrays import Array
from engine.data.rounded_times import rounded_times

HOUR, DAY = 3600.0, 86400.0
SUNDAY = 6
LATEST = 3  # o'clock, at which clocks are set forward somewhere
# Of a spreadsheet, which counts days: 1982 to 2064, in steps of so many seconds. Taken for seconds they are
# 24 Hz and more, at frequencies that few recorders have; steps of a day would be seconds.
DAYS = (30_000.0, 60_000.0)
USUAL_STEPS = (1, 2, 5, 10, 15, 20, 30, 60, 120, 300, 600, 900, 1800, 3600)
STEP_ERROR = 2e-4  # of the mean step, as days are rounded
Whole = NDArray[np.int64]
SINCE_1970 = (3e8, 4.1e9)  # seconds: 1979 to 2099
PARTS = {1e3: "ms", 1e6: "us", 1e9: "ns"}  # of a second
YEARS = (1800, 2200)  # of dates in a number


def doubts_of(told: Any, times: Array, unit: str) -> list[str]:
    """Notes of times (T,) that may be others; ``told`` are they as given, and ``times`` count a ``unit``."""
    dates = _dates(told)
    rounded = rounded_times(times, unit)
    if dates:
        found = [set_forward(dates), rounded]
    elif np.asarray(told).dtype.kind == "m":
        found = [rounded]
    else:
        counted = (days_of_spreadsheet, since_1970) if unit in ("", "s") else ()
        found = [doubt(times) for doubt in (*counted, digits_of_a_clock)] + [rounded]
    return [said for said in found if said]


def _dates(told: Any) -> list[datetime]:
    """Times as dates, where they were given so; none of texts, whose order is read elsewhere."""
    array = np.asarray(told).ravel()
    if array.dtype.kind == "M":
        array = np.array(array.astype("datetime64[us]").tolist(), dtype=object)
    there = array.dtype.kind == "O" and all(isinstance(one, datetime) for one in array)
    return list(array) if there else []


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


def since_1970(times: Array) -> str:
    """A note of numbers that look like parts of seconds since 1970; "" where they do not."""
    for parts, unit in PARTS.items():
        if SINCE_1970[0] <= times[0] / parts < times[-1] / parts <= SINCE_1970[1]:
            return (
                f"times from {times[0]:.10g} to {times[-1]:.10g} look like {unit} since 1970, and count as "
                f"seconds: if they are, name their column 'time [{unit}]'; with the time unit s they are then "
                "converted."
            )
    return ""


def digits_of_a_clock(times: Array) -> str:
    """A note of numbers that are hours and minutes, or a date, in digits: 1430, 143000, 20240301 or 202403.

    As numbers they jump from 1459 to 1500. Told where they go on by their usual step over such places, read as
    what they are, and nowhere by it only as numbers; dates of several months need no usual step.
    """
    if len(times) < 3 or not 0.0 <= times[0] < times[-1] < 1e15 or (times != np.round(times)).any():
        return ""
    whole = times.astype(np.int64)
    for read, example, meant in _IN_DIGITS:
        counted = read(whole)
        if counted is None:
            continue
        as_number, as_meant = (_usual(steps) for steps in (np.diff(whole), np.diff(counted)))
        carried = int(np.sum(as_meant & ~as_number))
        dated = read is _stamps or (read is _days and np.unique(whole // 100).size > 1)
        if dated or (carried > 1 and not (as_number & ~as_meant).any()):
            return (
                f"times from {whole[0]} to {whole[-1]} look like {meant}, as {example}, and count as plain "
                "numbers, whose steps are not even: write them as in 2024-03-01 14:30:00, or as numbers of one "
                "unit."
            )
    return ""


def _usual(steps: Whole) -> NDArray[np.bool_]:
    """Which steps are the most frequent one."""
    values, counts = np.unique(steps, return_counts=True)
    found: NDArray[np.bool_] = steps == values[np.argmax(counts)]
    return found


def _clock(whole: Whole) -> Whole | None:
    """Minutes of 1430, or seconds of 143000; None of other numbers."""
    parts = [whole // 100**k % 100 for k in range(3)]
    if whole.max() >= 240_000 or max(parts[0].max(), parts[1].max()) >= 60:
        return None
    return np.asarray(parts[0] + 60 * parts[1] + 3600 * parts[2])


def _months(whole: Whole) -> Whole | None:
    """Months of 202403; None of other numbers."""
    year, month = whole // 100, whole % 100
    there = (
        year.min() >= YEARS[0] and year.max() < YEARS[1] and month.min() >= 1 and month.max() <= 12
    )
    return np.asarray(12 * year + month) if there else None


def _days(whole: Whole) -> Whole | None:
    """Days of 20240301; None of other numbers."""
    if whole[0] // 10_000 < YEARS[0] or whole[-1] // 10_000 >= YEARS[1]:
        return None
    try:
        return np.array(
            [date(n // 10_000, n // 100 % 100, n % 100).toordinal() for n in whole.tolist()]
        )
    except ValueError:  # no such day
        return None


def _stamps(whole: Whole) -> Whole | None:
    """Seconds of 202403011430 or 20240301143000; None of other numbers."""
    whole = whole * (100 if whole[0] < 10**12 else 1)
    hour, minute, second = (whole // 100**k % 100 for k in (2, 1, 0))
    days = _days(whole // 10**6)
    if days is None or hour.max() >= 24 or max(minute.max(), second.max()) >= 60:
        return None
    return np.asarray(86400 * days + 3600 * hour + 60 * minute + second)


_IN_DIGITS: tuple[tuple[Callable[[Whole], Whole | None], str, str], ...] = (
    (_clock, "1430 for 14:30 or 143000 for 14:30:00", "the time of day"),
    (_months, "202403 for March 2024", "months"),
    (_days, "20240301 for 2024-03-01", "dates"),
    (_stamps, "202403011430 for 2024-03-01 14:30", "dates"),
)
