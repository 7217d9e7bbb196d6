"""Data files as a model's series."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from engine.data.by_column import gather, in_order, parts_of
from engine.data.channels import check_units
from engine.data.files import read_table, series_from
from engine.data.series import Series
from engine.data.stamps import candidates
from engine.data.table import Table
from engine.errors import SeriesError
from engine.statespace.model import MixedModel
from service.cli.ending import wrong
from service.columns import match, noted


@dataclass(frozen=True)
class Columns:
    """Which columns are which, {channel: column}; that of times or the step; what inputs do between."""

    of: Mapping[str, str] = field(default_factory=dict)
    time: str | None = None
    dt: float | None = None
    extra: Sequence[str] = ()
    hold: str | None = None
    time_unit: str | None = None
    by: Sequence[str] = ()  # columns that tell the records in one file apart

    @property
    def clock(self) -> tuple[str | None, float | None, str | None, str | None]:
        """As ``engine.data.files.series_from`` takes them."""
        return self.time, self.dt, self.hold, self.time_unit


def json_object(path: Path, otherwise: str) -> dict[str, Any]:
    """The object in a JSON file; ``otherwise`` is said of a file that holds none."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise wrong(f"{path}: {otherwise} ({error})") from None
    if not isinstance(document, dict):
        raise wrong(f"{path}: {otherwise}")
    return document


def series_of(
    path: Path, model: MixedModel, columns: Columns
) -> tuple[list[Series], str, list[str]]:
    """A data file as the model's series, a line that says what was read as what, and what to know of it.

    Which column is which channel, ``columns`` says, else ``service.columns.match``. One series, unless columns
    tell the records in it apart.
    """
    table, columns = _table(path, model, columns)
    y, u = _assigned(table, model, columns)
    try:
        parts = parts_of(table, columns.by) if columns.by else [table]
    except SeriesError as error:
        raise wrong(str(error)) from None
    every = [_one(part, model, columns, y, u) for part in parts]
    if columns.by:
        gather(table, parts)
        table.notes.append(in_order(table, parts))
    notes = _notes(table, every[0], model, y | u, columns, parts[0])
    return every, _said(path, every, [*y.values(), *u.values()]), notes


def _one(
    table: Table, model: MixedModel, columns: Columns, y: dict[str, str], u: dict[str, str]
) -> Series:
    try:
        other = [*columns.extra, *columns.by]
        series = series_from(table, y, u, *columns.clock, other, "--by '{}'").check(model)
        if columns.extra:
            extra = np.column_stack([table.column(name) for name in columns.extra])
            series = series.replace(extra=extra, extra_names=tuple(columns.extra))
    except SeriesError as error:
        text = table.with_lines(str(error))
        raise wrong(text if table.file in text else f"{table.file}: {text}") from None
    return series


def inputs_of(path: Path, model: MixedModel, columns: Columns) -> tuple[Series, list[str]]:
    """Times and inputs of a data file, y is missing throughout; and what to know of them."""
    table, columns = _table(path, model, columns)
    _, u = _assigned(table, model, columns, "u")
    # A file needs no outputs here, and series_from wants one: an input, or what may not have the times.
    times = candidates(table, u.values())
    some = next(iter([*u.values(), *(name for name in table.groups if name not in times), *times]))
    try:
        found = series_from(table, [some], u, *columns.clock)
        inputs = found.replace(y=np.full((len(found), model.ny), np.nan), y_names=None)
        check_units(inputs, model)
        return inputs, _notes(table, inputs, model, u, columns, table)
    except SeriesError as error:
        raise wrong(str(error)) from None


def _table(path: Path, model: MixedModel, columns: Columns) -> tuple[Table, Columns]:
    """The file's columns, and which are which by their full names, once what is asked of them makes sense."""
    for channel, column in columns.of.items():
        if channel not in {**model.outputs, **model.inputs}:
            there = ", ".join([*model.outputs, *model.inputs])
            raise wrong(
                f"--map {channel}={column}: model '{model.name}' has no output or input "
                f"'{channel}'; it has {there}"
            )
    try:
        table = read_table(path.read_bytes(), path.name)
    except SeriesError as error:
        raise wrong(str(error)) from None
    asked = [(f"--map {channel}={column}", column) for channel, column in columns.of.items()]
    asked += [(f"--extra {column}", column) for column in columns.extra]
    asked += [(f"--by {column}", column) for column in columns.by]
    for option, column in asked:
        if table.full(column) not in table.columns:
            there = ", ".join(table.columns)
            raise wrong(f"{option}: {path.name} has no column '{column}'; there are {there}")
    columns = replace(
        columns,
        of={channel: table.full(column) for channel, column in columns.of.items()},
        time=table.full(columns.time) if columns.time else None,
        extra=[table.full(column) for column in columns.extra],
        by=[table.full(column) for column in columns.by],
    )
    return table, columns


def _assigned(
    table: Table, model: MixedModel, columns: Columns, members: str = "yu"
) -> tuple[dict[str, str], dict[str, str]]:
    """{output: column}, {input: column}; members tells whether both are needed."""
    outputs = list(model.outputs) if "y" in members else []
    other = {*columns.extra, *columns.by, columns.time or ""}
    found = match(table, outputs, model.inputs, columns.of, other)
    for what, channels in (("output", outputs), ("input", model.inputs)):
        for channel in channels:
            if channel not in found:
                raise wrong(
                    f"{table.file}: no column for the {what} '{channel}'; say which it is with "
                    f"--map {channel}=COLUMN. There are {table.there()}"
                )
    return {one: found[one] for one in outputs}, {one: found[one] for one in model.inputs}


def _notes(
    table: Table,
    series: Series,
    model: MixedModel,
    read: Mapping[str, str],
    columns: Columns,
    first: Table,
) -> list[str]:
    clock = bool(columns.time or columns.dt), [*columns.extra, *columns.by]
    advice = "--dt STEP", "--time '{}'", "--by '{}'"
    told = noted(table, series, model, read, clock, advice, first)
    return [f"{table.file}: {one}" for one in told]


def _said(path: Path, records: Sequence[Series], read: Sequence[str]) -> str:
    series = records[0]
    even = all(one.dt == series.dt for one in records) and series.dt is not None
    every = f"every {series.dt:g} {series.time_unit}" if even else "at irregular times"
    several = f" in {len(records)} records" if len(records) > 1 else ""
    channels = [*series.y_names, *series.u_names]
    channels_read = [
        channel if channel == column else f"{channel} from column {column}"
        for channel, column in zip(channels, read, strict=True)
    ]
    samples = sum(map(len, records))
    text = f"{path.name}: {samples} samples{several} {every}; {', '.join(channels_read)}"
    missing = sum(int((~one.observed).sum()) for one in records)
    text += f"; {missing} missing" if missing else ""
    text += f"; inputs between samples: {series.hold}" if series.hold != "zoh" else ""
    return text
