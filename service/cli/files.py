"""Data files as a model's series."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from engine.errors import SeriesError
from engine.model import MixedModel
from engine.series import Series
from engine.series_files import READERS, TIME, is_channel, read_series
from engine.series_tables import Table
from service.cli.ending import wrong


@dataclass(frozen=True)
class Columns:
    """Which columns are which: {channel: column}, that of times or the step in s, extra ones."""

    of: Mapping[str, str] = field(default_factory=dict)
    time: str | None = None
    dt: float | None = None
    extra: Sequence[str] = ()


def series_of(path: Path, model: MixedModel, columns: Columns) -> tuple[Series, str]:
    """A data file as the model's series, and a line that says what was read as what.

    Channels are columns of their own name (or with ``y_``, ``u_`` before it), unless ``columns`` says
    otherwise; where none of them is found, the columns named y..., u....
    """
    table = _table(path, model, columns)
    y = _assigned(table, model.outputs, columns, "y")
    u = _assigned(table, model.inputs, columns, "u")
    try:
        found = read_series(
            path, y=y, u=u if model.inputs else [], t=columns.time, dt=columns.dt
        ).check(model)
        series = Series(
            found.y,
            found.u if model.nu else None,
            t=found.t,
            y_names=tuple(model.outputs),
            u_names=tuple(model.inputs),
            extra=np.column_stack([table.column(name) for name in columns.extra])
            if columns.extra
            else None,
            extra_names=tuple(columns.extra) or None,
        )
    except SeriesError as error:
        text = str(error)
        raise wrong(text if path.name in text else f"{path.name}: {text}") from None
    read = [*(y.values() if y else found.y_names), *(u.values() if u else found.u_names)]
    return series, _said(path, series, read, table, columns)


def inputs_of(path: Path, model: MixedModel, columns: Columns) -> Series:
    """Times and inputs of a data file; y is missing throughout."""
    table = _table(path, model, columns)
    u = _assigned(table, model.inputs, columns, "u")
    some = next(iter(table.groups))  # a file needs no outputs here; read_series wants one
    try:
        found = read_series(
            path, y=[some], u=u if model.inputs else [], t=columns.time, dt=columns.dt
        )
        blank = np.full((len(found), model.ny), np.nan)
        return Series(blank, found.u if model.nu else None, t=found.t)
    except SeriesError as error:
        raise wrong(str(error)) from None


def _table(path: Path, model: MixedModel, columns: Columns) -> Table:
    """The file's columns, once what is asked of them is known to make sense."""
    for channel, column in columns.of.items():
        if channel not in {**model.outputs, **model.inputs}:
            there = ", ".join([*model.outputs, *model.inputs])
            raise wrong(
                f"--map {channel}={column}: model '{model.name}' has no output or input "
                f"'{channel}'; it has {there}"
            )
    suffix = path.suffix.lower()
    if suffix not in READERS:
        raise wrong(f"{path}: the ending must be .csv, .mat or .npz, not '{suffix}'")
    try:
        table = READERS[suffix](path.read_bytes(), path.name)
    except SeriesError as error:
        raise wrong(str(error)) from None
    asked = [(f"--map {channel}={column}", column) for channel, column in columns.of.items()]
    asked += [(f"--extra {column}", column) for column in columns.extra]
    for option, column in asked:
        if column not in table.columns:
            there = ", ".join(table.columns)
            raise wrong(f"{option}: {path.name} has no column '{column}'; there are {there}")
    return table


def _assigned(
    table: Table, channels: Mapping[str, str], columns: Columns, prefix: str
) -> dict[str, str] | None:
    """{channel: column}, or None to take the columns named y... or u...."""
    out, missing = {}, []
    for channel in channels:
        names = [columns.of[channel]] if channel in columns.of else [channel, f"{prefix}_{channel}"]
        column = next((name for name in names if name in table.columns), None)
        if column is None:
            missing.append(channel)
        else:
            out[channel] = column
    if not missing:
        return out
    recognised = [name for name in table.columns if is_channel(name, prefix)]
    if not out and len(recognised) == len(missing):
        return None
    what = "output" if prefix == "y" else "input"
    raise wrong(
        f"{table.file}: no column for the {what} '{missing[0]}'; say which it is with "
        f"--map {missing[0]}=COLUMN. There are {', '.join(table.columns)}"
    )


def _said(path: Path, series: Series, read: Sequence[str], table: Table, columns: Columns) -> str:
    every = f"every {series.dt:g} s" if series.dt is not None else "at irregular times"
    channels = [*series.y_names, *series.u_names]
    told = [
        channel if channel == column else f"{channel} from column {column}"
        for channel, column in zip(channels, read, strict=True)
    ]
    text = f"{path.name}: {len(series)} samples {every}; {', '.join(told)}"
    missing = int((~series.observed).sum())
    text += f"; {missing} missing" if missing else ""
    clock = columns.time or columns.dt or table.dt or any(map(TIME.fullmatch, table.groups))
    return text + ("" if clock else " (no column of times: a step of 1 s is assumed, see --dt)")
