"""Which column of a table has the times: one called so, or the only one that holds dates."""

from __future__ import annotations

import re
from collections.abc import Collection

import numpy as np

from engine.arrays import Array
from engine.data.clock import elapsed, times_in
from engine.data.counters import MOSTLY, uneven_counter
from engine.data.dates import date_of, order_of, with_slashes
from engine.data.table import LIKE_DATE, TIME_OF_DAY, Table, is_number
from engine.errors import SeriesError
from engine.units import SECOND, times_among

ANY_DATE = re.compile(r"\d{1,4}([./-])\d{1,2}\1\d{1,4}([ T].*)?")


def candidates(table: Table, channels: Collection[str] = (), dates: bool = True) -> list[str]:
    """The columns that are read as times where none is asked for, the first of them is; ``channels`` are none.

    They are those called so, else, with ``dates``, the only one that holds dates.
    """
    named = times_among(table.groups, channels)
    if named or table.dt is not None or not dates:
        return named
    dated = [name for name in table.columns if name not in channels and holds_dates(table, name)]
    return dated if len(dated) == 1 and _goes_on(table, dated[0]) else []


def holds_dates(table: Table, name: str) -> bool:
    """Whether each cell of a column is a date."""
    values = table.columns[name]
    if not isinstance(values, np.ndarray) and with_slashes(values):
        return order_of(values) != ("", True)
    return date_of(_first_cell(table, name)) is not None and all(
        date_of(cell) is not None for cell in values
    )


def _begins_with_any_date(table: Table, name: str) -> bool:
    """Whether the first cell that is not empty is a date, in whatever order, which is told but not read."""
    first = _first_cell(table, name)
    return date_of(first) is not None or ANY_DATE.fullmatch(first.strip()) is not None


def _begins_with_hours(table: Table, name: str) -> bool:
    """Whether the first cell that is not empty is 0:30 or 0:30:00: times of day, or since a start."""
    first = _first_cell(table, name)
    return elapsed(first) is not None or TIME_OF_DAY.fullmatch(first.strip()) is not None


def _may_be_dates(table: Table, name: str) -> bool:
    """Whether a column of words may hold dates that are not read: no two of them are the same."""
    cells, first = [str(cell).strip() for cell in table.columns[name]], _first_cell(table, name)
    like_date = LIKE_DATE.fullmatch(first.strip()) is not None and not is_number(first)  # 1.5e-3
    return like_date and len(set(cells)) == len(cells)


def _first_cell(table: Table, name: str) -> str:
    values = table.columns[name]
    return "" if isinstance(values, np.ndarray) else next(filter(str.strip, values), "")


def _goes_on(table: Table, name: str) -> bool:
    """Whether dates mostly increase; a day of delivery, or one without the time of day, does not."""
    try:
        steps = np.diff(times_in(table.times(name), SECOND))
    except SeriesError:  # is told where they are read
        return True
    return bool(steps.size and np.mean(steps > 0.0) > 0.5)


def like_times(table: Table, taken: Collection[str]) -> tuple[str, str]:
    """A column that may well have the times, and why; "" where none does."""
    left = [name for name in table.columns if name not in taken]
    for test, why in (
        (_begins_with_any_date, "holds dates"),
        (_begins_with_hours, "holds hours and minutes"),
        (column_counts, "counts up evenly"),
        (_may_be_dates, "may hold dates"),
        (_rises, "rises like times"),
        (_rises_mostly, "rises like times at most rows, though not at all"),
    ):
        for name in left:
            if test(table, name):
                return name, why
    return "", ""


def _rises(table: Table, name: str, least: float = 1.0) -> bool:
    try:
        rises = np.diff(table.column(name)) > 0.0
        return bool(rises.size and rises.mean() >= least)
    except SeriesError:
        return False


def _rises_mostly(table: Table, name: str) -> bool:
    """Whether it would rise but for a logger that began anew, or wrote a row twice."""
    return _rises(table, name, MOSTLY)


def column_counts(table: Table, name: str) -> bool | None:
    """Whether a column of numbers just counts, as years and sample numbers do; None of words."""
    try:
        return counts(table.column(name))
    except SeriesError:
        return None


def counts(values: Array) -> bool:
    """Whether values go up by the same step throughout: a clock, or a number of the row."""
    steps = np.diff(values)
    return bool(steps.size and steps[0] > 0.0 and np.allclose(steps, steps[0], rtol=1e-6, atol=0.0))


def rows_missing(table: Table, taken: Collection[str]) -> list[str]:
    """A note where a column that is not ``taken`` counts rows of which some are not there."""
    for name in table.columns:
        if name in taken:
            continue
        try:
            numbers = table.column(name)
        except SeriesError:  # words
            continue
        if (row := uneven_counter(numbers)) is not None:
            steps = np.diff(numbers)
            return [
                f"column '{name}' goes up by {steps.min():g}, but from {numbers[row - 1]:.10g} to "
                f"{numbers[row]:.10g} at row {row}: where rows are missing, give their times (t=), or put them "
                "in again with empty readings."
            ]
    return []
