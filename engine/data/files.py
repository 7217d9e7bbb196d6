"""Series in and out of files: .csv (or .txt, .tsv, .dat and other text), .mat (version 4 to 7) and .npz.

Which columns are which channels:

- ``y`` and ``u`` are lists of column names, or mappings {model channel: column}; the unit in a column's name
  may be left out (``indoor`` of ``indoor [degC]``), where one column alone is called so;
- left out, they are all columns named y or u, alone or followed by something that is not a letter
  (``y``, ``y2``, ``u_V``, ``Y [mm]``, but not ``year``);
- ``extra`` are columns that the model does not use, in the same way: a diagnosis tests whether they belong;
- ``t`` names the column of time stamps: numbers, dates such as ``2024-03-01 13:45:00``, ``1.3.2024 13:45``
  or ``01-Mar-2024``, or hours, minutes and seconds that go on after a day, ``25:30:00``; left out, a column
  named ``t`` or ``time`` is used, also with a unit of time behind it (``t [h]``, ``time_min``, ``t_s``), unless
  it is one of ``y`` or ``u``. ``T`` is none, which may be a temperature. Where there are several,
  :class:`engine.ReadingWarning` says which it is. Where none is called so and no step is given, the only column
  that holds dates is used;
- ``dt`` is the time step where no column has the times; in .mat and .npz a scalar named ``dt`` or ``Ts`` is.
  Given beside times it must be their step, but that of a file where ``t`` is named; it makes times even that
  have too few digits, 0.03, 0.07, 0.1 at 30 Hz. Where nothing tells it,
  it is 1; a :class:`engine.ReadingWarning` names a column that looks like times, if there is one;
- ``time_unit`` says what times count (see :class:`engine.Series`); left out, what the file says: a text
  ``time_unit`` in .mat and .npz, a line ``# time unit: min`` at the head of a CSV, or the name of the column of
  times, such as ``time [min]`` or ``year``; else seconds. Where the file says another one than is given, its
  times are converted, which a :class:`engine.ReadingWarning` says;
- ``hold`` says what inputs do between samples (see :class:`engine.Series`); left out, what the file says: a
  text ``hold`` in .mat and .npz, a line ``# hold: foh`` at the head of a CSV; else they are held.

Empty cells and NaN, null, NA, none, ---, ? and a spreadsheet's errors are missing measurements. Nothing is
ever unpickled.
"""

from __future__ import annotations

import csv
import io
import warnings
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from engine.arrays import Array
from engine.data.array_files import read_mat, read_npz
from engine.data.by_column import gather, names_and_times, names_records, parts_of
from engine.data.clock import converted
from engine.data.csv_files import read_csv
from engine.data.doubts import doubts_of
from engine.data.series import Series
from engine.data.stamps import candidates, like_times, rows_missing
from engine.data.table import Table
from engine.errors import OptionError, ReadingWarning, SeriesError
from engine.units import (
    SECOND,
    clock_of,
    is_unit,
    named_with_unit,
    unit_behind,
)
from engine.words import enumerated

Channels: TypeAlias = "Sequence[str] | Mapping[str, str] | None"

TEXT = (".csv", ".txt", ".tsv", ".tab", ".dat", ".data", ".asc", ".prn", ".out")
READERS = {**dict.fromkeys(TEXT, read_csv), ".mat": read_mat, ".npz": read_npz}
ENDINGS = "the ending must be .csv, .mat or .npz (of text also .txt, .tsv or .dat)"


def read_series(
    path: str | Path,
    y: Channels = None,
    u: Channels = None,
    t: str | None = None,
    dt: float | None = None,
    hold: str | None = None,
    time_unit: str | None = None,
    extra: Channels = None,
) -> Series:
    """Read a file; see the module's docstring for which columns are read.

    Raises SeriesError naming the file, the line and the column, and what the file holds.
    """
    table = _table_at(Path(path))
    series = _series_of(table, y, u, t, dt, hold, time_unit, extra)
    _warn_of(table)
    return series


def read_records(
    path: str | Path,
    by: str | Sequence[str],
    y: Channels = None,
    u: Channels = None,
    t: str | None = None,
    dt: float | None = None,
    hold: str | None = None,
    time_unit: str | None = None,
    extra: Channels = None,
) -> list[Series]:
    """Read a file in which several records stand: those rows are one that are alike in the column ``by``.

    Or in several columns, a subject and a day, say. Records come in the order in which they first appear, each
    on its own clock; the other arguments are those of :func:`read_series`.
    """
    table = _table_at(Path(path))
    names = [by] if isinstance(by, str) else list(by)
    parts = parts_of(table, names)
    other = [table.full(name) for name in names]
    found = [_series_of(part, y, u, t, dt, hold, time_unit, extra, other) for part in parts]
    gather(table, parts)
    _warn_of(table)
    return found


def _table_at(path: Path) -> Table:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SeriesError(f"{path} cannot be read: {error.strerror or error}") from error
    return read_table(data, path.name)


def _series_of(
    table: Table,
    y: Channels,
    u: Channels,
    t: str | None,
    dt: float | None,
    hold: str | None,
    time_unit: str | None,
    extra: Channels,
    other: Sequence[str] = (),
) -> Series:
    """The series of a table, with its extra channels; ``other`` columns are none."""
    names, columns = _channels(table, extra or (), "extra")
    series = series_from(table, y, u, t, dt, hold, time_unit, [*columns, *other])
    if columns:
        series = series.replace(extra=_stacked(table, "extra", columns), extra_names=names)
    if t is None and dt is None and table.dt is None:
        taken = {*_channels(table, y, "y")[1], *_channels(table, u, "u")[1], *columns, *other}
        if not candidates(table, taken):
            column, why = like_times(table, taken)
            if column:
                table.notes.append(
                    f"no column of times: a step of 1 {series.time_unit} is assumed; as '{column}' {why}, "
                    f"give t='{column}', or dt."
                )
            elif not other and (names := names_and_times(table, taken))[0]:
                table.notes.append(
                    "no column of times: a step of 1 {2} is assumed; as '{1}' rises in each record if '{0}' "
                    "names them, try Series.read_records(..., by='{0}', t='{1}').".format(
                        *names, series.time_unit
                    )
                )
    return series


def _warn_of(table: Table) -> None:
    for note in table.notes:
        warnings.warn(f"{table.file}: {note}", ReadingWarning, stacklevel=3)


def read_table(data: bytes, filename: str) -> Table:
    """The columns of a file; the name's ending tells the format. Raises SeriesError."""
    suffix, file = Path(filename).suffix.lower(), Path(filename).name
    if suffix not in READERS:
        raise SeriesError(f"{file}: {ENDINGS}, not '{suffix}'")
    return READERS[suffix](data, file)


def series_from(
    table: Table,
    y: Channels = None,
    u: Channels = None,
    t: str | None = None,
    dt: float | None = None,
    hold: str | None = None,
    time_unit: str | None = None,
    other: Collection[str] = (),
    advice: str = "Series.read_records(..., by='{}')",
) -> Series:
    """The series that columns of a table make, see :func:`read_series`; ``other`` ones are no times either.

    ``advice`` is how to name the column that tells records apart, where times fall back and one may.
    """
    y_names, y_columns = _channels(table, y, "y")
    u_names, u_columns = _channels(table, u, "u")
    step = dt if dt is not None or t is not None else table.dt
    if t is None:
        t = _times_of(table, {*y_columns, *u_columns, *other}, dt is None)
    times = None
    if t is not None:
        t = _lookup(table, "t", t)[0]
        times = table.times(t)
    told = table.time_unit or clock_of(t or "")
    unit = (time_unit or told).strip()
    if told and not isinstance(times, list):
        times, said = converted(times, told, unit)
        if dt is None and step is not None:
            step, said = converted(step, told, unit)
        table.notes += [said] if said else []
    channels, inputs = _stacked(table, "y", y_columns), _stacked(table, "u", u_columns)
    try:
        series = Series(
            channels,
            inputs if u_columns else None,
            dt=None if step is None else float(step),
            t=times,
            y_names=y_names,
            u_names=u_names,
            hold=hold or table.hold or "zoh",
            time_unit=unit or SECOND,
            units=_units(y_names, y_columns) | _units(u_names, u_columns),
        )
    except (SeriesError, OptionError) as error:
        text = table.with_lines(str(error))
        if "time must increase" in text:
            text += _by_which(table, t, {*y_columns, *u_columns, *other}, advice)
        raise SeriesError(f"{table.file}: {text}") from error
    if times is not None:
        table.notes += [table.with_lines(said) for said in doubts_of(times, series.t, unit)]
    elif step is not None:
        missing = rows_missing(table, {*y_columns, *u_columns, *other})
        table.notes += [table.with_lines(said) for said in missing]
    return series


def _by_which(table: Table, t: str | None, taken: Collection[str], advice: str) -> str:
    """What to do where a column tells the records apart that stand in one file; else ""."""
    column = names_records(table, t, taken)
    return (
        f". If the column '{column}' names the records, say {advice.format(column)}"
        if column
        else ""
    )


def _times_of(table: Table, channels: Collection[str], dates: bool) -> str | None:
    """The group of columns that has the times, None where there is none; of several, it is noted."""
    found = candidates(table, channels, dates)
    if len(found) > 1:
        rest = enumerated([f"'{name}'" for name in found[1:]], "and")
        table.notes.append(f"times are those of column '{found[0]}', not of {rest}.")
    return found[0] if found else None


def write_series(series: Series, path: str | Path) -> None:
    """Write t, y, u to .csv, .mat or .npz so that reading with the defaults gives them back.

    In a CSV a channel whose name would not be recognised gets the prefix ``y_`` or ``u_``.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in (".npz", ".mat"):
        text = np.str_ if suffix == ".npz" else object
        arrays: dict[str, Any] = {"t": series.t, "hold": series.hold, "time_unit": series.time_unit}
        for name, values in (("y", series.y), ("u", series.u)):
            if values.shape[1] or suffix == ".npz":
                arrays[name] = values
                arrays[f"{name}_names"] = np.array(getattr(series, f"{name}_names"), dtype=text)
        if suffix == ".npz":
            np.savez_compressed(path, **arrays)
        else:
            from scipy.io import savemat

            savemat(path, arrays, oned_as="column")
    elif suffix == ".csv":
        path.write_text(csv_text(series), encoding="utf-8")
    else:
        raise SeriesError(f"{path.name}: the ending must be .csv, .mat or .npz, not '{suffix}'")


def csv_text(series: Series) -> str:
    """What :func:`write_series` writes into a .csv."""
    header = ["t"]
    for prefix, names in (("y", series.y_names), ("u", series.u_names)):
        header += [name if is_channel(name, prefix) else f"{prefix}_{name}" for name in names]
    table = np.column_stack((series.t, series.y, series.u))
    out = io.StringIO()
    if series.hold != "zoh":
        out.write(f"# hold: {series.hold}\n")
    if series.time_unit != SECOND:
        out.write(f"# time unit: {series.time_unit}\n")
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(header)
    for row in table.tolist():
        writer.writerow(["" if value != value else repr(value) for value in row])
    return out.getvalue()


def _units(names: Sequence[str] | None, columns: Sequence[str]) -> dict[str, str]:
    """{channel: unit} where its column tells one that is known: ``pressure [bar]``, or ``pressure_bar``.

    An index is none, ``y[0]``, and round brackets may hold other things: a letter or ``in`` there says nothing.
    """
    out = {}
    for name, column in zip(names or (), columns, strict=True):
        unit = named_with_unit(column)[1]
        plain = column.rstrip().endswith(")") and (len(unit) == 1 or unit == "in")
        if is_unit(unit) and not plain:
            out[name] = unit
        elif not unit and (behind := unit_behind(column, name)):
            out[name] = behind
    return out


def is_channel(name: str, prefix: str) -> bool:
    """Whether a column is read as one of y or u without being named."""
    return name[:1].lower() == prefix and not name[1:2].isalpha()


def _channels(
    table: Table, wanted: Channels, prefix: str
) -> tuple[tuple[str, ...] | None, list[str]]:
    """Names of the channels and the columns they are read from."""
    if isinstance(wanted, str):
        wanted = [wanted]
    if wanted is None:
        columns: list[str] = []
        for name in (prefix, prefix.upper()):  # the array itself, where there is one
            columns = columns or list(table.groups.get(name, []))
        if not columns or columns == [prefix] or columns == [prefix.upper()]:
            columns = [name for name in table.columns if is_channel(name, prefix)]
        if not columns and prefix == "y":
            raise SeriesError(
                f"{table.file}: no column is named y...; name the measured ones with y=[...]. "
                f"There are {table.there()}"
            )
        return (tuple(columns) if columns else None), columns
    if isinstance(wanted, Mapping):
        columns = []
        for channel, name in wanted.items():
            found = _lookup(table, prefix, name)
            if len(found) != 1:
                raise SeriesError(
                    f"{table.file}: '{name}' has {len(found)} columns ({', '.join(found)}); "
                    f"name one of them for {prefix} channel '{channel}'"
                )
            columns += found
        return tuple(wanted), columns
    names: list[str] = []
    columns = []
    for name in wanted:
        found = _lookup(table, prefix, name)
        columns += found
        names += found if name in table.groups else [name]
    return tuple(names), columns


def _lookup(table: Table, prefix: str, name: str) -> list[str]:
    full = table.full(name)
    if full in table.groups:
        return table.groups[full]
    if several := table.with_unit(name):
        raise SeriesError(
            f"{table.file}: '{name}' (asked for as {prefix}) may be any of {enumerated(several, 'or')}; "
            "write the one that is meant with its unit"
        )
    raise SeriesError(
        f"{table.file} has no column '{name}' (asked for as {prefix}); there are {table.there()}"
    )


def _stacked(table: Table, prefix: str, names: Sequence[str]) -> Array:
    """Columns beside each other (T, n)."""
    columns = [table.column(name) for name in names]
    sizes = {column.size for column in columns}
    if len(sizes) > 1:
        lengths = ", ".join(f"'{n}' {c.size}" for n, c in zip(names, columns, strict=True))
        raise SeriesError(f"{table.file}: the channels of {prefix} differ in length: {lengths}")
    return np.column_stack(columns) if columns else np.zeros((0, 0))
