"""Times in a unit: of numbers, of dates, and of the index of a table such as pandas'."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC
from typing import Any

import numpy as np

from engine.arrays import Array
from engine.errors import SeriesError
from engine.units import meanings

SECOND = np.timedelta64(1, "s")


def times_in(times: Any, unit: str) -> Array:
    """Time stamps (T,) in a unit; dates count from the first of them, durations are as long as they are.

    ``times`` holds numbers, which are in the unit, or dates: datetime64, datetime objects, or an index of
    dates, with a time zone or without. A missing date is NaN. Raises SeriesError for anything else, and for
    dates in a unit of which it is not known how long it is.
    """
    array = np.asarray(times)
    if array.dtype.kind == "O" and array.size and all(map(_is_date, array.ravel())):
        array = np.array([_utc(one) for one in array.ravel()], dtype="datetime64[ns]")
    if array.dtype.kind == "M":
        since = array.ravel() - array.ravel()[:1]
        return np.asarray(since / SECOND, dtype=float) / _seconds_of(unit)
    if array.dtype.kind == "m":
        return np.asarray(array.ravel() / SECOND, dtype=float) / _seconds_of(unit)
    try:
        return np.array(times, dtype=float).ravel()
    except (TypeError, ValueError) as error:
        raise SeriesError(f"t is neither numbers nor dates: {error}") from error


def _seconds_of(unit: str) -> float:
    """How long a unit of time is. Raises SeriesError where that is not known."""
    sizes = [size for size, powers in meanings(unit) if powers == {"s": 1.0}]
    if not sizes:
        raise SeriesError(
            f"t are dates and time_unit is '{unit}', of which it is not known how many seconds it has: give "
            "numbers, or a time_unit such as s, min, h or day"
        )
    return sizes[0]


def index_of(tables: Iterable[Any]) -> Any:
    """The index that says when rows of tables were measured, None where they have none.

    Dates, durations and decimal numbers say so; whole numbers count rows. Raises SeriesError where two tables
    have different ones.
    """
    found = None
    for table in tables:
        index = getattr(table, "index", None)
        if index is None or callable(index):  # of a list
            continue
        values = np.asarray(index)
        dates = values.dtype.kind == "O" and values.size and all(map(_is_date, values.ravel()))
        if not dates and values.dtype.kind not in "Mmf":
            continue
        if found is not None and not np.array_equal(np.asarray(found), values):
            raise SeriesError("y and u have different indices of times; join them first")
        found = index
    return found


def _is_date(value: Any) -> bool:
    return callable(getattr(value, "timestamp", None))


def _utc(value: Any) -> Any:
    """A date without its zone, for datetime64 has none."""
    if getattr(value, "tzinfo", None) is None:
        return np.datetime64(value)
    return np.datetime64(value.astimezone(UTC).replace(tzinfo=None))
