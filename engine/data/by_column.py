"""One file with the rows of several records, and a column that says which record each row belongs to."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from engine.data.clock import times_in
from engine.data.table import Table, is_missing
from engine.errors import SeriesError
from engine.units import SECOND

SHOWN = 30  # records whose names a note tells
WORDS = 40  # letters of a name


def parts_of(table: Table, by: Sequence[str]) -> list[Table]:
    """The rows of each record, in the order in which records first appear; ``by`` names the columns that tell.

    Each part is called by its record, for errors. One of a single row holds no step, and is left out with a
    note. Raises SeriesError.
    """
    columns = [_column(table, name) for name in by]
    names = [_cells(table, column) for column in columns]
    groups = _rows_by(list(zip(*names, strict=True)))
    parts, single = list[Table](), list[str]()
    for key, rows in groups.items():
        what = ", ".join(f"{c} {cell[:WORDS]}" for c, cell in zip(columns, key, strict=True))
        if len(rows) < 2:
            single.append(what)
            continue
        parts.append(
            _part(table, np.array(rows, dtype=np.intp), f"{table.file}, {what}", len(names[0]))
        )
    if not parts:
        raise SeriesError(f"{table.file}: no record of column {_quoted(columns)} has two rows")
    if single:
        table.notes.append(f"left out, as they have one row: {_listed(single)}.")
    return parts


def gather(table: Table, parts: Sequence[Table]) -> None:
    """Take the notes of the parts into those of the table, each once."""
    for part in parts:
        table.notes += [note for note in part.notes if note not in table.notes]


def in_order(table: Table, parts: Sequence[Table]) -> str:
    """Which records the parts are, as results count them."""
    called = [part.file.removeprefix(f"{table.file}, ") for part in parts]
    return f"{len(parts)} records, counted from 0 as {_listed(called)}."


def names_records(table: Table, times: str | None, taken: Collection[str]) -> str:
    """A column by which times that fall back would increase in each part; "" where there is none.

    It is none of the columns ``taken``, and has as few values as any that is one.
    """
    if times is None:
        return ""
    try:
        t = times_in(table.times(times), SECOND)
    except SeriesError:
        return ""
    found = []
    for name in table.columns:
        if name in taken or name == times or len(table.columns[name]) != len(t):
            continue
        try:
            groups = _rows_by(_cells(table, name))
        except SeriesError:
            continue
        if 1 < len(groups) <= len(t) // 2 and all(
            (np.diff(t[r]) > 0.0).all() for r in groups.values()
        ):
            found.append((len(groups), name))
    return min(found, key=lambda one: one[0])[1] if found else ""


def names_and_times(table: Table, taken: Collection[str]) -> tuple[str, str]:
    """A column that may name records, and one that rises in each of them; "" where there are none."""
    for times in table.columns:
        if times not in taken and (names := names_records(table, times, taken)):
            return names, times
    return "", ""


def _column(table: Table, name: str) -> str:
    full = table.full(name)
    if full not in table.columns:
        raise SeriesError(
            f"{table.file} has no column '{name}' (asked for as the name of records); there are {table.there()}"
        )
    return full


def _cells(table: Table, name: str) -> list[str]:
    """Each cell as text; numbers alike whether written 1 or 1.0."""
    values = table.columns[name]
    if isinstance(values, np.ndarray):
        cells = ["" if value != value else f"{value:.12g}" for value in values.tolist()]
    else:
        cells = [_text(cell) for cell in values]
    for row, cell in enumerate(cells):
        if is_missing(cell):
            place = table.with_lines(f"at row {row}")
            raise SeriesError(f"{table.file}: column '{name}' does not name the record {place}")
    return cells


def _text(cell: str) -> str:
    text = cell.strip()
    try:
        return text if "_" in text else f"{float(text):.12g}"
    except ValueError:
        return text


def _rows_by(keys: Sequence[Any]) -> dict[Any, list[int]]:
    groups: dict[Any, list[int]] = {}
    for row, key in enumerate(keys):
        groups.setdefault(key, []).append(row)
    return groups


def _part(table: Table, rows: np.ndarray[Any, np.dtype[np.intp]], file: str, n: int) -> Table:
    """Some rows of a table; columns of another length than ``n`` stay as they are, and are told by readers."""
    columns = {
        name: values
        if len(values) != n
        else values[rows]
        if isinstance(values, np.ndarray)
        else [values[row] for row in rows]
        for name, values in table.columns.items()
    }
    lines = [table.lines[row] for row in rows] if table.lines else ()
    return replace(table, file=file, columns=columns, lines=lines, notes=[])


def _quoted(names: Sequence[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return f"{'; '.join(names[:SHOWN])}{more}"
