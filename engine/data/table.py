"""The columns of a file, as it has them: numbers, dates, and errors that name the line."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta

import numpy as np

from engine.arrays import Array
from engine.data.clock import about_zone, elapsed, zone_changes
from engine.data.dates import (
    DAY_FIRST,
    MONTH_FIRST,
    about_orders,
    date_of,
    in_order,
    order_of,
    with_slashes,
)
from engine.errors import SeriesError
from engine.units import named_with_unit

DATED = re.compile(r"\d+([./-])\d+\1\d+")  # how a date begins, in whatever order
LIKE_DATE = re.compile(
    r".*\d.*(?::|[^\W\d_]).*\d.*"
)  # 1. March 2024 or 12:30.5: as words and numbers go
TIME_OF_DAY = re.compile(r"\d{1,2}:\d\d(:\d\d([.,]\d+)?)?( ?[AP]M)?", re.IGNORECASE)
MISSING = frozenset(
    ["", "nan", "nat", "null", "<null>", "(null)", "na", "n/a", "n.a.", "none", "missing"]
)  # fmt: skip
# As loggers and statisticians write it, a spreadsheet in any language (#NV, #¡DIV/0!), and C on Windows.
NO_READING = re.compile(
    r"-+|\?+|\.|#[¡¿]?[^\W\d]+(/[^\W_])?[!?]?|-?1\.#(ind|[qs]nan)\d*|-?nan\((ind|snan)\)",
    re.IGNORECASE,
)


@dataclass
class Table:
    """Columns of one file.

    ``groups`` maps a name a user may ask for to the columns it stands for: itself in a CSV, all
    channels of a two-dimensional array in .mat and .npz. ``dt``, ``hold`` and ``time_unit`` as stored in the
    file. ``notes`` say what was read in one of several ways.
    """

    file: str
    columns: dict[str, Array | Sequence[str]]
    groups: dict[str, list[str]]
    lines: Sequence[int] = ()  # line of each CSV row, counted from 1
    dt: float | None = None
    hold: str | None = None  # of the inputs, where the file says it
    time_unit: str | None = None
    ignored: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def full(self, name: str) -> str:
        """``pressure [bar]`` of ``pressure``, where one column alone is called so; else the name itself."""
        found = self.with_unit(name)
        return found[0] if len(found) == 1 else name

    def with_unit(self, name: str) -> list[str]:
        """The columns that are called so but for a unit; none where one has exactly this name."""
        if name in self.groups:
            return []
        return [column for column in self.columns if named_with_unit(column)[0] == name]

    def column(self, name: str) -> Array:
        """One column (T,), missing cells as NaN."""
        values = self.columns[name]
        if isinstance(values, np.ndarray):
            return values
        try:
            if any("_" in cell for cell in values):  # Python reads 1_000 as a thousand
                raise ValueError
            return np.array([cell or "nan" for cell in values], dtype=float)
        except ValueError:
            return np.array([self._number(name, i, cell) for i, cell in enumerate(values)])

    def times(self, name: str) -> Array | list[datetime]:
        """A column of times (T,): numbers, dates, or hours such as 25:30:00.

        The latter are counted from the first day that there is: only what lies between them matters.
        """
        values = self.columns[name]
        first = "" if isinstance(values, np.ndarray) else next(filter(str.strip, values), "")
        if elapsed(first) is not None and not self._has_dates():
            return [datetime.min + one for one in self._elapsed(name)]
        slashed = not isinstance(values, np.ndarray) and with_slashes(values)
        if date_of(first) is None and not slashed:
            return self.column(name)
        found = self._slashed(name) if slashed else [date_of(cell) for cell in values]
        for i, (one, cell) in enumerate(zip(found, values, strict=True)):
            if one is None:
                raise SeriesError(
                    f"{self._place(name, i)}: '{cell.strip()[:40]}' is not a date such as 2024-03-01 13:45:00"
                    f"{self._repeated(name, cell)}"
                )
        dates = [one for one in found if one is not None]
        if (row := zone_changes(dates)) is not None:
            raise SeriesError(
                f"{self._place(name, row)}: '{values[row].strip()}' {about_zone(dates[row])}"
            )
        return dates

    def _slashed(self, name: str) -> list[datetime | None]:
        """The dates of a column with slashes (T,), None for those that are none."""
        cells = list(self.columns[name])
        order, sure = order_of(cells)
        if order:
            said = f"dates of column '{name}' are read as {order}, for so time goes on."
            if not sure and said not in self.notes:
                self.notes.append(said)
            return in_order(cells, order)
        if not sure:
            raise SeriesError(f"{self._place(name, 0)}: {about_orders(cells[0])}")
        # the order that reads the most tells the line that is none
        return max((in_order(cells, one) for one in (DAY_FIRST, MONTH_FIRST)), key=_read)

    def _has_dates(self) -> bool:
        """Whether a column begins with a date: hours beside it are those of several days."""
        texts = (cells for cells in self.columns.values() if not isinstance(cells, np.ndarray))
        return any(DATED.match(next(filter(str.strip, cells), "").strip()) for cells in texts)

    def _elapsed(self, name: str) -> list[timedelta]:
        """Times since a start (T,), which go on after a day."""
        out: list[timedelta] = []
        for i, cell in enumerate(self.columns[name]):
            one = elapsed(cell)
            if one is None:
                raise SeriesError(
                    f"{self._place(name, i)}: '{cell.strip()[:40]}' is not a time such as 25:30:00"
                )
            if out and one < out[-1]:
                raise SeriesError(
                    f"{self._place(name, i)}: '{cell.strip()}' is earlier than the time before it; times of "
                    "day that pass midnight are read with their date, both in one column: 2024-03-01 13:45:00"
                )
            out.append(one)
        return out

    def _repeated(self, name: str, cell: str) -> str:
        """What to do about a line that has the names of the columns once more."""
        if cell.strip() not in (name, named_with_unit(name)[0]):
            return ""
        return "; if this line repeats the names of the columns, delete it"

    def with_lines(self, text: str) -> str:
        """The text of an error with lines of the file in place of rows."""
        if not self.lines:
            return text

        def line(found: re.Match[str]) -> str:
            row = int(found[2])
            return f"{found[1]} line {self.lines[row]}" if row < len(self.lines) else found[0]

        return re.sub(r"\b(at|from|to) row (\d+)", line, text)

    def _place(self, name: str, row: int) -> str:
        return f"{self.file}, line {self.lines[row]}, column '{name}'"

    def _number(self, name: str, row: int, cell: str) -> float:
        text = cell.strip()
        if is_missing(text):
            return np.nan
        if is_number(text):
            return float(text)
        hint = ""
        if text.count(",") == 1 and is_number(text.replace(",", ".")):
            hint = "; if it has a decimal comma, write decimal points throughout"
        elif repeated := self._repeated(name, text):
            hint = repeated
        elif date_of(text) is not None:
            hint = "; only the column of times may hold dates"
        elif TIME_OF_DAY.fullmatch(text):
            hint = (
                "; times of day are read with seconds, 13:45:00, or with their date, both in one column: "
                "2024-03-01 13:45:00"
            )
        elif DATED.match(text) or LIKE_DATE.fullmatch(text):
            hint = "; dates of a column of times are read as 2024-03-01 13:45:00: write them so"
        elif not any(map(str.isdigit, text)) and row:
            hint = "; write a number, or nothing where there is no reading"
        elif row == 0 and not any(
            is_number(str(cells[0]).strip()) for cells in self.columns.values()
        ):
            hint = "; if this line holds units, write them behind the names, as in 't [s]', or delete it"
        raise SeriesError(f"{self._place(name, row)}: '{text[:40]}' is not a number{hint}")

    def there(self) -> str:
        """What the file holds, for errors."""
        text = ", ".join(f"'{name}'" for name in self.groups) or "nothing"
        return text + (f" (not usable: {', '.join(self.ignored)})" if self.ignored else "")


def _read(dates: Sequence[datetime | None]) -> int:
    return sum(one is not None for one in dates)


def is_missing(text: str) -> bool:
    """Whether a cell says that there is no reading."""
    return text.lower() in MISSING or NO_READING.fullmatch(text) is not None


def is_number(text: str) -> bool:
    """Whether a cell is one; Python would read 1_000, too."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text
