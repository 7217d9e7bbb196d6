"""Series from pandas tables: columns by name, units from the names, from ``attrs``, or as given."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from engine.data.clock import converted, index_of
from engine.data.doubts import doubts_of
from engine.data.series import Series
from engine.data.stamps import candidates, holds_dates, like_times, rows_missing
from engine.data.table import Table
from engine.errors import OptionError, ReadingWarning, SeriesError
from engine.units import SECOND, clock_of, named_with_unit


def from_frame(
    table: Any,
    y: Sequence[str],
    u: Sequence[str] = (),
    t: str | None = None,
    units: str | Mapping[str, str] | None = None,
    time_unit: str | None = None,
    **more: Any,
) -> Series:
    """A series of columns of a pandas table.

    Parameters
    ----------
    table : pandas.DataFrame
        A row for each sample; an index of dates, durations or decimal numbers tells the times, and with
        ``units`` one whose name has a unit of time.
    y, u : sequence of str
        Columns of outputs and inputs, in the model's order: by their names, or by these without the unit.
    t : str, optional
        Column of time stamps, instead of the index.
    units : {"names", "attrs"} or mapping, optional
        Where units are: behind the names (``pressure [bar]``, ``pressure (bar)``; the channel is then called
        ``pressure``), in ``table.attrs["units"]`` by column, or as given by column. None: there are none.
    time_unit : str, optional
        The unit of times; with ``units`` also told by ``table.attrs["time_unit"]`` or by the name of the column
        or index of times (``time [min]``, ``year``) and converted to the one that is given; else seconds.
        Dates and durations are in seconds.
    **more
        ``dt``, ``hold`` and the others of :class:`engine.Series`; ``extra`` as column names.

    Returns
    -------
    Series
        The series, with ``units`` where they were asked for.

    Raises
    ------
    SeriesError
        A column is not there, or its values cannot be used.
    OptionError
        ``units`` is another word.
    """
    if isinstance(units, str) and units not in ("names", "attrs"):
        raise OptionError(f"units = {units!r}; 'names', 'attrs' or a mapping is needed", "units")
    known = _Columns(table, units)
    extra = list(more.pop("extra", ()))
    channels = {"y": list(y), "u": list(u), "extra": extra}
    taken = {key: [known.column(name) for name in names] for key, names in channels.items()}
    found = {known.name(column): known.unit(column) for one in taken.values() for column in one}
    arguments: dict[str, Any] = {"y": table[taken["y"]]}
    for key in ("u", "extra"):
        if taken[key]:
            arguments[key] = table[taken[key]]
    for key, columns in taken.items():
        if columns:
            arguments[f"{key}_names"] = [known.name(column) for column in columns]
    clock = None if t is None else known.column(t)
    if clock is not None:
        arguments["t"] = table[clock]
    dated = _is_dated(table if clock is None else table[clock])
    notes: list[str] = []
    if units is not None and not dated:
        named = str(clock if clock is not None else table.index.name or "")
        told = table.attrs.get("time_unit") or clock_of(named)
        counts = clock_of(named) and table.index.dtype.kind in "iu"  # 0, 10, 20 called time [ms]
        times = table.index if counts else index_of((table,))
        times = table[clock] if clock is not None else times if more.get("dt") is None else None
        if times is not None:
            arguments["t"], said = _counted(times, told, time_unit or told)
            notes += [said] if said else []
        time_unit = time_unit or told
    if "t" not in arguments and more.get("t") is None:
        notes += _about_rows(
            table, [c for one in taken.values() for c in one], more.get("dt"), time_unit
        )
    series = Series(
        **arguments,
        time_unit=time_unit or SECOND,
        units={name: unit for name, unit in found.items() if unit},
        **more,
    )
    if isinstance(arguments.get("t"), np.ndarray):  # others are looked at by the series
        notes += doubts_of(arguments["t"], series.t, series.time_unit)
    for note in notes:
        warnings.warn(note, ReadingWarning, stacklevel=3)
    return series


def _about_rows(table: Any, taken: Sequence[str], dt: Any, time_unit: str | None) -> list[str]:
    """Notes of columns that may have the times, or that count rows of which some are missing."""
    cells: dict[str, Any] = {}
    for i, name in enumerate(map(str, table.columns)):
        values = table.iloc[:, i]
        numbers = values.dtype.kind in "fiu" and isinstance(values.dtype, np.dtype)
        cells[name] = values.to_numpy(float) if numbers else [str(one) for one in values]
    as_file = Table("table", cells, {name: [name] for name in cells}, range(len(table)))
    if dt is not None:
        return rows_missing(as_file, taken)
    if index_of((table,)) is not None:
        return []
    named = candidates(as_file, taken)
    column, why = (named[0], "is called so") if named else like_times(as_file, taken)
    if named and holds_dates(as_file, column):
        why = "holds dates"
    if not column:
        return []
    return [
        f"no column of times: a step of 1 {time_unit or SECOND} is assumed; as '{column}' {why}, give "
        f"t='{column}', or dt."
    ]


class _Columns:
    """The columns of a table by their names, with or without the units in them."""

    def __init__(self, table: Any, units: str | Mapping[str, str] | None) -> None:
        self.there = list(map(str, table.columns))
        self.in_names = units == "names"
        given = table.attrs.get("units", {}) if units == "attrs" else units
        self.given: Mapping[str, str] = given if isinstance(given, Mapping) else {}
        unknown = [name for name in self.given if name not in self.there]
        if unknown and units != "attrs":
            raise SeriesError(f"units: there is no column '{unknown[0]}'; {self._listed()}")

    def column(self, name: str) -> str:
        """The column of that name, or of that name with a unit behind it."""
        if name in self.there:
            return name
        found = [one for one in self.there if self.in_names and named_with_unit(one)[0] == name]
        if len(found) != 1:
            raise SeriesError(f"there is no column '{name}'; {self._listed()}")
        return found[0]

    def name(self, column: str) -> str:
        """What the channel of a column is called."""
        return named_with_unit(column)[0] if self.in_names else column

    def unit(self, column: str) -> str:
        """Its unit; "" where none is known."""
        return named_with_unit(column)[1] if self.in_names else self.given.get(column, "")

    def _listed(self) -> str:
        return f"there are {', '.join(self.there)}"


def _counted(times: Any, told: str, unit: str) -> tuple[Any, str]:
    """Numbers that count ``told`` as ones that count a ``unit``, and what is to be said; dates as they are."""
    try:
        return converted(np.asarray(times, dtype=float), told, unit, "table")
    except (TypeError, ValueError):
        return times, ""


def _is_dated(values: Any) -> bool:
    """Whether times are dates or durations, which become seconds."""
    index = getattr(values, "index", values) if hasattr(values, "columns") else values
    return getattr(getattr(index, "dtype", None), "kind", "") in "Mm"
