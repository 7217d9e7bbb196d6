"""What an uploaded data file holds, so that its columns can be given to a model's channels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from engine.data.by_column import names_records, parts_of
from engine.data.clock import converted, times_in, times_of
from engine.data.files import ENDINGS, READERS
from engine.data.stamps import candidates, counts, holds_dates
from engine.data.table import Table
from engine.errors import SeriesError
from engine.statespace.model import Array
from engine.units import SECOND, clock_of
from service.downsample import keep
from service.problems import invalid
from service.responses import ColumnOut, PreviewOut, TimeOut
from service.settings import Settings
from service.strict_json import finite
from service.uploads import check_size

COLUMN_POINTS = 2000  # about so many values of each column
COLUMN_GAPS = 200  # the longest gaps of each column
COLUMNS_SHOWN = 200


def preview(
    data: bytes,
    filename: str,
    time: str | None,
    unit: str | None,
    settings: Settings,
    by: str | None = None,
) -> PreviewOut:
    """Columns with their range, thinned values and gaps. Raises Problem 422 about ``file``, ``t`` or ``by``.

    ``time`` names the column of time stamps; None takes that which a job would. ``unit`` is what times count,
    None for what the file says. Where ``by`` names the column that tells records apart, the times are those of
    the first.
    """
    table, max_samples = _read(data, filename, settings.max_values), settings.max_samples
    longest = max((len(column) for column in table.columns.values()), default=0)
    if longest > max_samples:
        raise invalid("file", f"{longest} rows; this service allows {max_samples}")
    if not table.columns:
        raise invalid("file", f"holds no columns of numbers; there is {table.there()}")
    if time is None and table.dt is None:
        time = next((name for name in candidates(table) if name in table.columns), None)
    time = table.full(time) if time else time
    if by and table.full(by) not in table.columns:
        raise invalid("by", f"there is no column '{by}'; there are {table.there()}")
    if time and time not in table.columns:
        raise invalid("t", f"there is no column '{time}'; there are {table.there()}")
    told = table.time_unit or clock_of(time or "")
    unit = unit or told or SECOND
    return PreviewOut(
        file=filename,
        rows=longest,
        dt=converted(table.dt, told or unit, unit)[0],
        time_unit=unit,
        time=_time(table, time, told or unit, unit, by) if time else None,
        columns=[_column(table, name, unit) for name in list(table.columns)[:COLUMNS_SHOWN]],
        ignored=[*table.ignored, *(f"'{name}'" for name in list(table.columns)[COLUMNS_SHOWN:])],
    )


def _read(data: bytes, filename: str, max_values: int) -> Table:
    suffix = Path(filename).suffix.lower()
    if suffix not in READERS:
        sheet = "; a spreadsheet can be saved as CSV" if suffix in (".xls", ".xlsx", ".ods") else ""
        raise invalid("file", f"'{filename}': {ENDINGS}{sheet}")
    check_size(data, filename, "file", max_values)
    try:
        return READERS[suffix](data, Path(filename).name)
    except SeriesError as error:
        raise invalid("file", str(error)) from None


def _time(table: Table, name: str, told: str, unit: str, by: str | None) -> TimeOut:
    """The times as a job has them; what it would be refused for is the problem. The file counts ``told``."""
    values, problem, part = np.zeros(0), None, table
    try:
        each = []
        for part in parts_of(table, [by]) if by else [table]:
            stamps = part.times(name)
            stamps = stamps if isinstance(stamps, list) else converted(stamps, told, unit)[0]
            each.append(times_of(stamps, None, len(stamps), unit))
        values = each[0]
    except SeriesError as error:
        problem = part.with_lines(str(error).removeprefix("t "))
        column = "" if by else names_records(table, name, ())
        problem += (
            f". If the column '{column}' names the records, choose it as such" if column else ""
        )
    steps = np.diff(values)
    good = problem is None and steps.size > 0
    return TimeOut(
        column=name,
        problem=problem,
        first=float(values[0]) if good else None,
        last=float(values[-1]) if good else None,
        step=float(np.median(steps)) if good else None,
        regular=bool(good and np.allclose(steps, steps[0], rtol=1e-6, atol=0.0)),
    )


def _column(table: Table, name: str, unit: str) -> ColumnOut:
    dates = holds_dates(table, name)
    values, problem = _dates(table, name, unit) if dates else _numbers(table, name)
    missing = np.isnan(values)
    there = values[~missing & (not dates)]
    gaps = _gaps(missing)
    rows = keep(values[:, None], COLUMN_POINTS)
    # The first row of a gap is kept, so that a line drawn through the values breaks there.
    rows = np.union1d(rows, np.array([first for first, _ in gaps], dtype=np.intp))
    return ColumnOut(
        name=name,
        rows=len(values),
        missing=int(missing.sum()),
        minimum=finite(float(there.min())) if there.size else None,
        maximum=finite(float(there.max())) if there.size else None,
        problem=problem,
        dates=dates,
        counts=not dates and counts(values),
        row=rows.tolist(),
        value=[finite(x) for x in values[rows].tolist()],
        gaps=gaps,
    )


def _numbers(table: Table, name: str) -> tuple[Array, str | None]:
    """A column, and what is wrong with it if it is not all numbers."""
    try:
        return table.column(name), None
    except SeriesError as error:
        return np.zeros(0), str(error)


def _dates(table: Table, name: str, unit: str) -> tuple[Array, str]:
    """A column of dates as times, where they can be, and why it is no channel."""
    try:
        return times_in(table.times(name), unit), "it holds dates"
    except SeriesError as error:
        return np.zeros(0), str(error)


def _gaps(missing: np.ndarray[Any, np.dtype[np.bool_]]) -> list[tuple[int, int]]:
    """First and last row of the longest gaps, in order."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], missing, [False]))))
    found = list(zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True))
    return sorted(sorted(found, key=lambda gap: gap[0] - gap[1])[:COLUMN_GAPS])
