"""What an uploaded data file holds, so that its columns can be given to a model's channels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from engine.data.files import READERS
from engine.data.tables import Table
from engine.errors import SeriesError
from engine.statespace.model import Array
from engine.units import SECOND, clock_of, times_among
from service.columns import counts
from service.downsample import keep
from service.problems import invalid
from service.responses import ColumnOut, PreviewOut, TimeOut
from service.settings import Settings
from service.strict_json import finite
from service.uploads import check_size

COLUMN_POINTS = 2000  # about so many values of each column
COLUMN_GAPS = 200  # the longest gaps of each column
COLUMNS_SHOWN = 200


def preview(data: bytes, filename: str, time: str | None, settings: Settings) -> PreviewOut:
    """Columns with their range, thinned values and gaps. Raises Problem 422 about ``file`` or ``t``.

    ``time`` names the column of time stamps; None takes one that is called time.
    """
    table, max_samples = _read(data, filename, settings.max_values), settings.max_samples
    longest = max((len(column) for column in table.columns.values()), default=0)
    if longest > max_samples:
        raise invalid("file", f"{longest} rows; this service allows {max_samples}")
    if not table.columns:
        raise invalid("file", f"holds no columns of numbers; there is {table.there()}")
    if time is None and table.dt is None:
        time = next(iter(times_among(table.columns)), None)
    time = table.full(time) if time else time
    if time and time not in table.columns:
        raise invalid("t", f"there is no column '{time}'; there are {table.there()}")
    clock = _time(table, time) if time else None
    return PreviewOut(
        file=filename,
        rows=longest,
        dt=table.dt,
        time_unit=table.time_unit or clock_of(time or "") or SECOND,
        time=clock,
        columns=[_column(table, name) for name in list(table.columns)[:COLUMNS_SHOWN]],
        ignored=[*table.ignored, *(f"'{name}'" for name in list(table.columns)[COLUMNS_SHOWN:])],
    )


def _read(data: bytes, filename: str, max_values: int) -> Table:
    suffix = Path(filename).suffix.lower()
    if suffix not in READERS:
        sheet = "; a spreadsheet can be saved as CSV" if suffix in (".xls", ".xlsx", ".ods") else ""
        raise invalid("file", f"must be a .csv, .mat or .npz file, not '{filename}'{sheet}")
    check_size(data, filename, "file", max_values)
    try:
        return READERS[suffix](data, Path(filename).name)
    except SeriesError as error:
        raise invalid("file", str(error)) from None


def _numbers(table: Table, name: str) -> tuple[Array, str | None]:
    """A column, and what is wrong with it if it is not all numbers."""
    try:
        return table.column(name), None
    except SeriesError as error:
        return np.zeros(0), str(error)


def _time(table: Table, name: str) -> TimeOut:
    values, problem = _numbers(table, name)
    steps = np.diff(values)
    wrong = np.flatnonzero(~np.isfinite(values))
    if problem is None and wrong.size:
        problem = f"is not a number at row {wrong[0]}"
    elif problem is None and (backward := np.flatnonzero(~(steps > 0.0))).size:
        row = int(backward[0]) + 1
        problem = f"does not increase at row {row} ({values[row]:g} after {values[row - 1]:g})"
    good = problem is None and steps.size > 0
    return TimeOut(
        column=name,
        problem=problem and table.with_lines(problem),
        first=float(values[0]) if good else None,
        last=float(values[-1]) if good else None,
        step=float(np.median(steps)) if good else None,
        regular=bool(good and np.allclose(steps, steps[0], rtol=1e-6, atol=0.0)),
    )


def _column(table: Table, name: str) -> ColumnOut:
    values, problem = _numbers(table, name)
    missing = np.isnan(values)
    there = values[~missing]
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
        counts=counts(values),
        row=rows.tolist(),
        value=[finite(x) for x in values[rows].tolist()],
        gaps=gaps,
    )


def _gaps(missing: np.ndarray[Any, np.dtype[np.bool_]]) -> list[tuple[int, int]]:
    """First and last row of the longest gaps, in order."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], missing, [False]))))
    found = list(zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True))
    return sorted(sorted(found, key=lambda gap: gap[0] - gap[1])[:COLUMN_GAPS])
