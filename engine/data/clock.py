"""Times in a unit: of numbers, of dates, and of the index of a table such as pandas'."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from itertools import combinations
from typing import Any

import numpy as np

from engine.arrays import Array
from engine.data.counters import uneven
from engine.data.dates import about_orders, date_of, in_order, order_of, with_slashes
from engine.data.rounded_times import EVEN, evened, rounding_of
from engine.errors import SeriesError
from engine.units import clock_of, time_size

WHOLE = "iu"  # kinds of whole numbers
SECOND = np.timedelta64(1, "s")
# Of a step given beside times: how far the mean of theirs may be from it, and each, as loggers round.
SAME_STEP, JITTER = 1e-3, 0.1
DIGITS = 12  # that a common step has at most
NOON = 1200.0  # in the digits of a clock, after which it passes midnight
ELAPSED = re.compile(r"\s*(\d+):([0-5]\d):([0-5]\d(?:[.,]\d+)?)\s*")


def times_in(times: Any, unit: str) -> Array:
    """Time stamps (T,) in a unit; dates count from the first of them, durations are as long as they are.

    ``times`` holds numbers, which are in the unit, or dates: datetime64, datetime objects, text as ISO 8601 has
    it, or an index of dates, with a time zone or without. A missing date is NaN, and what is behind a mask.
    Raises SeriesError for anything else, and for dates in a unit of which it is not known how long it is.
    """
    found = _times_in(times, unit)
    if isinstance(times, np.ma.MaskedArray):  # NumPy keeps what is behind the mask
        found[np.ma.getmaskarray(times).ravel()] = np.nan
    return found


def _times_in(times: Any, unit: str) -> Array:
    array = np.asarray(times)
    if array.dtype.kind in "UO" and array.size and all(isinstance(x, str) for x in array.ravel()):
        array = np.array(_dates_of(array.ravel().tolist()), dtype=object)
    if array.dtype.kind == "O" and array.size and all(map(_is_date, array.ravel())):
        if (row := zone_changes(list(array.ravel()))) is not None:
            raise SeriesError(
                f"t: {array.ravel()[row]} at row {row} {about_zone(array.ravel()[row])}"
            )
        array = np.array([_utc(one) for one in array.ravel()], dtype="datetime64[ns]")
    if array.dtype.kind == "M":
        since = array.ravel() - array.ravel()[:1]
        return np.asarray(since / SECOND, dtype=float) / _seconds_of(unit)
    if array.dtype.kind == "m":
        return np.asarray(array.ravel() / SECOND, dtype=float) / _seconds_of(unit)
    try:
        if np.iscomplexobj(times):
            raise ValueError("they are complex")
        return np.array(times, dtype=float).ravel()
    except (TypeError, ValueError) as error:
        raise SeriesError(f"t is neither numbers nor dates: {error}") from error


def _dates_of(texts: Sequence[str]) -> list[datetime | str]:
    """Each text that is a date as one, the others as they are. Raises SeriesError where two orders may be."""
    if not with_slashes(texts):
        return [date_of(text) or text for text in texts]
    order, sure = order_of(texts)
    if not (order or sure):
        raise SeriesError(f"t: {about_orders(texts[0])}")
    return [date or text for date, text in zip(in_order(texts, order), texts, strict=True)]


def zone_changes(dates: Sequence[Any]) -> int | None:
    """The first row that has a time zone where those before have none, or the other way round; else None."""
    there = [row for row, one in enumerate(dates) if one == one]
    zoned = [getattr(dates[row], "tzinfo", None) is not None for row in there]
    return next((row for row, one in zip(there, zoned, strict=True) if one is not zoned[0]), None)


def about_zone(date: Any) -> str:
    """What is wrong with a date where zones change."""
    has, have = ("no", "one") if getattr(date, "tzinfo", None) is None else ("a", "none")
    return (
        f"has {has} time zone, and those before have {have}: write all time stamps with their zone, or all "
        "without"
    )


def _seconds_of(unit: str) -> float:
    """How many seconds a unit of time has. Raises SeriesError where that is not known."""
    size = time_size(unit)
    if size is None:
        raise SeriesError(
            f"t are dates and time_unit is '{unit}', of which it is not known how many seconds it has: give "
            "numbers, or a time_unit such as s, min, h or day"
        )
    return size


def converted(times: Any, told: str, unit: str, by: str = "file") -> tuple[Any, str]:
    """Numbers that count ``told``, if there are any, as ones that count ``unit``, and what is to be said of it.

    ``by`` is what tells it.

    Where it is not known how long one of the two is they stay as they are.
    """
    if times is None:
        return None, ""
    own, wanted = time_size(told), time_size(unit)
    if own == wanted and (own is not None or told == unit):
        return times, ""
    if own is None or wanted is None:
        return times, f"times count {told} by the {by}, and are taken for {unit}, as asked."
    said = f"times are converted from {told} to {unit}."
    return (times / (wanted / own) if wanted > own else times * (own / wanted)), said


def times_of(t: Any, dt: float | None, T: int, unit: str, begins: Sequence[int] = ()) -> Array:
    """Times (T,) of rows: ``t``, as :func:`times_in` takes it, or else from 0 at the step ``dt``, 1 by default.

    Given both, t counts and must have that step: on average, and nearly each. Where it explains all of t but
    their digits, t are made even. At ``begins`` t may fall back. Raises SeriesError.
    """
    if t is None:
        dt = 1.0 if dt is None else _step_in(dt, unit)
        if not (np.isfinite(dt) and dt > 0):
            raise SeriesError(f"dt = {dt}; a positive time step is needed")
        return float(dt) * np.arange(T, dtype=np.float64)
    times = times_in(t, unit)
    if times.size != T:
        raise SeriesError(f"t has {times.size} time stamps and y has {T} rows")
    bad = np.flatnonzero(~np.isfinite(times))
    if bad.size:
        raise SeriesError(f"t is not finite at row {bad[0]}")
    falls = np.diff(times) <= 0
    falls[np.array(begins, dtype=np.intp) - 1] = False
    bad = np.flatnonzero(falls)
    if bad.size:
        row = int(bad[0]) + 1
        kind = "repeats" if times[row] == times[row - 1] else "decreases"
        shown = np.asarray(t).ravel()
        dated = shown.dtype.kind not in "fiub"
        text = str(shown[row]) if dated else f"{times[row]:.12g}"
        hint = (
            (_winter(times, row, shown[row], unit) or _swapped(times, row, shown, unit))
            if dated
            else ""
        )
        if len(falls) > 1 and (np.diff(times) < 0).all():
            hint = "; the last row was measured first: turn their order around"
        elif kind == "repeats" and text.endswith(" 00:00:00"):
            hint = "; if another column has the time of day, write both in one: 2024-03-01 13:45:00"
        elif kind == "repeats" and not dated:
            hint = "; of readings that were taken at one time give the mean"
        elif not dated and times[row - 1] >= NOON and _of_the_day(times):
            hint = (
                "; if this is the time of day, 1430 for 14:30, write it with its day in one: "
                "2024-03-01 14:30:00"
            )
        elif kind == "decreases" and not hint and times[row] <= times[0]:
            hint = "; if several records stand one below the other, give each by itself"
        elif kind == "decreases" and not hint:
            hint = "; if the rows are of one record, sort them by time"
        elif kind == "repeats" and not hint and (np.diff(times) >= 0).all():
            hint = "; if its stamps are rounded, name their column otherwise and give the step, dt"
        raise SeriesError(f"t {kind} at row {row} ({text}); time must increase{hint}")
    if dt is None:
        return times
    step = _step_in(dt, unit)
    even = evened(times, step, unit)
    if even is None:
        _check_step(times, step)
    return times if even is None else even


def _winter(times: Array, row: int, date: Any, unit: str) -> str:
    """What to do where dates without a zone go back as clocks do at the end of summer time; else ""."""
    zone = getattr(date, "tzinfo", None) or re.search(r":\d\d.*(Z|[+-]\d\d:?\d\d)$", str(date))
    if zone is not None:
        return ""
    hour, usual = 3600.0 / _seconds_of(unit), float(np.median(np.diff(times)))
    back = times[row - 1] - times[row]
    if not (usual > 0.0 and abs(back + usual - hour) <= usual):
        return ""
    return (
        "; if the clock was set back to winter time here, write the time stamps with their zone, as in "
        "2024-10-27T02:00:00+01:00"
    )


def _swapped(times: Array, row: int, shown: Array, unit: str) -> str:
    """What to look at where the row before follows with day and month in each other's place; else ""."""
    try:
        before, after = (datetime.fromisoformat(str(one)) for one in shown[row - 1 : row + 1])
        other = before.replace(month=before.day, day=before.month)
        gap = (after - other).total_seconds() / _seconds_of(unit)
    except (ValueError, TypeError):  # no such day, or not written so
        return ""
    if not 0.0 < gap <= 1.5 * float(np.median(np.diff(times))):
        return ""
    return (
        f"; it follows on {other:%Y-%m-%d}, which the row before has with day and month in each other's place: "
        "look at all rows whose day is 12 or less"
    )


def _step_in(dt: Any, unit: str) -> float:
    """A time step in a unit: a number, or a duration such as timedelta. Raises SeriesError."""
    if isinstance(dt, timedelta | np.timedelta64):
        return float(times_in(np.array([dt], dtype="timedelta64[ns]"), unit)[0])
    if np.ndim(dt):
        shape = " x ".join(map(str, np.shape(dt)))
        raise SeriesError(f"dt has {shape} values; one positive number is needed. Times are t=")
    if isinstance(dt, str):
        raise SeriesError(f"dt = {dt!r}; one positive number is needed")
    try:
        return float(dt)
    except (TypeError, ValueError) as error:
        raise SeriesError(f"dt = {dt!r}; a positive number is needed, or a duration") from error


def elapsed(text: str) -> timedelta | None:
    """Hours, minutes and seconds such as 25:30:00, as simulators and stop watches count; None of all else.

    Two parts, 25:30, may be hours and minutes or minutes and seconds, and are none.
    """
    found = ELAPSED.fullmatch(text)
    if found is None:
        return None
    seconds = float(found[3].replace(",", "."))
    return timedelta(hours=int(found[1]), minutes=int(found[2]), seconds=seconds)


def _of_the_day(times: Array) -> bool:
    """Whether times may be hours and minutes of a clock in one number, as 1430."""
    minutes = np.mod(times, 100.0)
    whole = np.array_equal(times, np.round(times))
    return bool(whole and times.min() >= 0.0 and times.max() < 2400.0 and minutes.max() < 60.0)


def common_step(t: Array, begins: Sequence[int] = ()) -> float | None:
    """The step at which all times t (T,) go on, but for those of rows ``begins``; None where there is none.

    Of the step that the times show the fewest digits, up to DIGITS, that leave each within its rounding.
    """
    parts = np.split(t, begins) if len(begins) else [t]
    steps = np.concatenate([np.diff(one) for one in parts])
    if not steps.size:
        return None
    mean = float(steps.mean()) if len(begins) else float((t[-1] - t[0]) / len(steps))
    rounding = rounding_of(t)

    def on_time(step: float) -> bool:
        off = (one - one[0] - step * np.arange(len(one)) for one in parts)
        return all(bool((np.abs(x) <= rounding).all()) for x in off)

    for digits in range(1, DIGITS + 1):
        short = float(f"{mean:.{digits}g}")
        if on_time(short):
            return short
    if not (on_time(mean) or np.allclose(steps, mean, rtol=EVEN, atol=0.0)):
        return None
    # as of times that were added up, where each step is rounded
    return short if (np.abs(steps - short) <= rounding).all() else mean


def _check_step(times: Array, dt: float) -> None:
    steps = np.diff(times)
    rounding = 4.0 * np.finfo(float).eps * np.abs(times).max()
    bad = np.flatnonzero(np.abs(steps - dt) > JITTER * dt + rounding)
    if bad.size:
        row = int(bad[0])
        raise SeriesError(
            f"t and dt are both given and differ: from row {row} to row {row + 1} t goes on by {steps[row]:g}, "
            f"and dt = {dt:g}; give one of them"
        )
    mean = float(times[-1] - times[0]) / len(steps)
    if abs(mean - dt) > (SAME_STEP + 2.0 * JITTER / len(steps)) * dt + rounding:
        raise SeriesError(
            f"t and dt are both given and differ: t goes on by {mean:g} on average, and dt = {dt:g}; give one "
            "of them"
        )


def index_of(tables: Iterable[Any]) -> Any:
    """The first index that says when rows of tables were measured, None where none does.

    Dates, also as text, periods, durations and decimal numbers say so; whole numbers count rows, and other
    texts name them.
    """
    for table in tables:
        labels = _labels(table)
        if labels is None:
            continue
        if callable(periods := getattr(table.index, "to_timestamp", None)):
            return periods()
        objects = labels.dtype.kind in "OU" and labels.size
        dates = objects and (all(map(_is_date, labels)) or _are_texts_of_dates(labels))
        if dates or labels.dtype.kind in "Mmf":
            return table.index
    return None


def about_index(tables: Iterable[Any], dt: Any, unit: str) -> str:
    """A note where whole numbers in the index of a table, which count rows, do not count these; else ""."""
    every = [labels for table in tables if (labels := _labels(table)) is not None]
    numbers = next((one for one in every if one.dtype.kind in WHOLE and len(one) > 1), None)
    if numbers is None:
        return ""
    if (row := uneven(numbers.astype(np.int64))) is not None:
        return (
            f"the index goes from {numbers[row - 1]} to {numbers[row]} at row {row}, and rows are taken as one "
            "step apart, as they stand: where some were left out, put them in again with empty readings (NaN), "
            "or give times, t=; others sort, or give as records of their own."
        )
    if dt is not None or numbers[1] - numbers[0] in (0, 1):
        return ""
    shown = ", ".join(map(str, numbers[:3]))
    return f"the index counts {shown}: no times, and a step of 1 {unit} is assumed; give t=, or dt."


def about_name(times: Any, unit: str) -> str:
    """A note where the name of a table's column or index says that its numbers count another unit; else ""."""
    name, kind = getattr(times, "name", None), getattr(getattr(times, "dtype", None), "kind", "")
    told = clock_of(str(name or ""))
    if kind not in "fiu" or not told or told == unit or (time_size(told) or 0.0) == time_size(unit):
        return ""
    return (
        f"times '{name}' count {told} by its name, and are taken for {unit}: say time_unit='{told}', "
        "or convert them."
    )


def _are_texts_of_dates(labels: Any) -> bool:
    texts = list(labels)
    if not all(isinstance(one, str) for one in texts):
        return False
    return with_slashes(texts) or all(date_of(one) is not None for one in texts)


def check_same_rows(tables: Mapping[str, Any]) -> None:
    """Raise SeriesError where two of the tables, which are by name, have indices that differ.

    Rows are taken as they come. An index that counts them from 0, as tables have that were given none, says
    nothing beside dates, decimal numbers or texts.
    """
    known = {name: one for name, table in tables.items() if (one := _labels(table)) is not None}
    for (first, one), (second, other) in combinations(known.items(), 2):
        counts = [_counts(one), _counts(other)]
        whole = one.dtype.kind in WHOLE and other.dtype.kind in WHOLE
        if all(counts) or (any(counts) and not whole):
            continue
        place = ""
        if len(one) == len(other):
            differ = (one != other) & ((one == one) | (other == other))  # none is as none
            if not differ.any():
                continue
            row = int(np.argmax(differ))
            place = f" (row {row} is {one[row]} in {first} and {other[row]} in {second})"
        raise SeriesError(
            f"{first} and {second} have different indices{place}; join them first, or give {second} as an "
            "array, whose rows are taken as they come"
        )


def _labels(table: Any) -> Any:
    """The index of a table (T,), None where it has none."""
    index = getattr(table, "index", None)
    if index is None or callable(index):  # of a list
        return None
    labels = np.asarray(index)
    return labels if labels.ndim == 1 else None


def _counts(labels: Any) -> bool:
    return labels.dtype.kind in WHOLE and np.array_equal(labels, np.arange(len(labels)))


def _is_date(value: Any) -> bool:
    return callable(getattr(value, "timestamp", None))


def _utc(value: Any) -> Any:
    """A date without its zone, for datetime64 has none."""
    if getattr(value, "tzinfo", None) is None:
        return np.datetime64(value)
    return np.datetime64(value.astimezone(UTC).replace(tzinfo=None))
