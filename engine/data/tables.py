"""The file formats behind :mod:`engine.data.files`: bytes of a CSV, .mat or .npz to columns.

Nothing is ever unpickled. Every error is a SeriesError that names the file and the place.
"""

from __future__ import annotations

import csv
import io
import math
import re
import subprocess
import sys
import zipfile
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from itertools import islice
from pathlib import Path

import numpy as np

from engine.arrays import Array
from engine.data.clock import about_zone, date_of, zone_changes
from engine.errors import SeriesError
from engine.units import clock_of, is_unit, named_with_unit

# Comments at the head of a CSV.
HOLD = re.compile(r"#\s*hold\s*[:=]\s*(\S+)\s*", re.IGNORECASE)
TIME_UNIT = re.compile(r"#\s*time[ _]unit\s*[:=]\s*(\S+)\s*", re.IGNORECASE)
DATED = re.compile(r"\d+([./-])\d+\1\d+")  # how a date begins, in whatever order
TIME_OF_DAY = re.compile(r"\d{1,2}:\d\d(:\d\d([.,]\d+)?)?( ?[AP]M)?", re.IGNORECASE)
MISSING = frozenset(("", "nan", "null", "na", "n/a", "#n/a", "none", "-"))
# Which count before the others: a comma may stand in a name or a number.
DELIMITERS = (";", "\t", ",")
EXCEL = re.compile(r'"?sep=(.)"?', re.IGNORECASE)  # the first line of its files, which it hides
LOOKED_AT = 100  # rows, for the delimiter
DECIMAL_COMMA = re.compile(r"\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*")
THOUSANDS = re.compile(r"\s*[+-]?[1-9]\d{0,2},\d{3}\s*")  # or three decimals
LARGEST_BYTES = 4 << 30  # an .npz may unpack to, and memory for reading a .mat
MAT_TO_NPZ = Path(__file__).with_name("mat_to_npz.py")  # a program of its own
LONGEST_CELL = 131_072  # characters of a cell; as csv has it, whose own limit anybody may change
_TOO_LONG = f"a cell has more than {LONGEST_CELL} characters; is a quotation mark left open?"


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
        """A column of times (T,): numbers, or dates as ISO 8601 writes them."""
        values = self.columns[name]
        if isinstance(values, np.ndarray) or date_of(next(filter(str.strip, values), "")) is None:
            return self.column(name)
        found = [date_of(cell) for cell in values]
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
        if text.lower() in MISSING:
            return np.nan
        if _is_number(text):
            return float(text)
        hint = ""
        if text.count(",") == 1 and _is_number(text.replace(",", ".")):
            hint = "; if it has a decimal comma, write decimal points throughout"
        elif repeated := self._repeated(name, text):
            hint = repeated
        elif date_of(text) is not None:
            hint = "; only the column of times may hold dates"
        elif DATED.match(text):
            hint = "; dates of a column of times are read as 2024-03-01 13:45:00: write them so"
        elif TIME_OF_DAY.fullmatch(text):
            hint = (
                "; times of day are read with their date, both in one column: 2024-03-01 13:45:00"
            )
        elif row == 0 and not any(_is_number(cells[0].strip()) for cells in self.columns.values()):
            hint = "; if this line holds units, write them behind the names, as in 't [s]', or delete it"
        raise SeriesError(f"{self._place(name, row)}: '{text[:40]}' is not a number{hint}")

    def there(self) -> str:
        """What the file holds, for errors."""
        text = ", ".join(f"'{name}'" for name in self.groups) or "nothing"
        return text + (f" (not usable: {', '.join(self.ignored)})" if self.ignored else "")


def read_csv(data: bytes, file: str) -> Table:
    """A CSV with one header line; delimiter comma, semicolon or tab; leading # lines skipped.

    Where commas do not part cells they may be those of decimals. Units may have a second line of their own.
    """
    wide = data.startswith((BOM_UTF16_LE, BOM_UTF16_BE))  # as Excel's "Unicode text" does
    try:
        text = data.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        kind = "UTF-16" if wide else "UTF-8"
        raise SeriesError(
            f"{file}, line {line}: not {kind} text; save the file as UTF-8"
        ) from error
    if "\0" in text:
        raise SeriesError(f"{file} is not a text file; a CSV is needed")
    lines = text.splitlines()
    first = 0
    while first < len(lines) and (not lines[first].strip() or lines[first].startswith("#")):
        first += 1
    if first == len(lines):
        raise SeriesError(f"{file} is empty; a header line and rows of numbers are needed")
    hold, time_unit = (
        [found[1] for line in lines[:first] if (found := what.fullmatch(line.strip()))]
        for what in (HOLD, TIME_UNIT)
    )
    last = len(lines)
    while not lines[last - 1].strip():  # the file's end, however many lines it has
        last -= 1
    if told := EXCEL.fullmatch(lines[first].strip(" ")):
        if told[1] not in DELIMITERS:
            raise SeriesError(
                f"{file}, line {first + 1}: separated by '{told[1]}'; a comma, semicolon or tab is needed"
            )
        first += 1
        if first >= last:
            raise SeriesError(f"{file} is empty; a header line and rows of numbers are needed")
    delimiter = told[1] if told else _delimiter(lines[first:last])
    below = _names_below(lines, first, last)
    reader = csv.reader(lines[first:last], delimiter=delimiter)
    rows: list[list[str]] = []
    numbers: list[int] = []
    try:
        each = _short_cells(reader)
        names = [name.strip() for name in next(each)]
        # Lines may end with delimiters; columns without a name and a value are none.
        named = len(names)
        while named > 1 and not names[named - 1]:
            named -= 1
        _check_header(names[:named], file, first + 1, below)
        for row in each:
            # An empty line is a missing value where there is one column, nothing otherwise.
            if not row and len(names) == 1:
                row = [""]
            if not row:
                continue
            if len(row) != len(names):
                raise _ragged(row, names, file, first + reader.line_num, below)
            for i in range(named, len(row)):
                if row[i].strip():
                    raise _nameless(i, file, first + 1, below)
            rows.append(row[:named])
            numbers.append(first + reader.line_num)
    except csv.Error as error:
        reason = _TOO_LONG if "field limit" in str(error) else str(error)
        raise SeriesError(f"{file}, line {first + reader.line_num}: {reason}") from error
    names = names[:named]
    if rows and (units := _units_in(rows[0])):
        names = [
            f"{name} [{unit}]" if unit and not named_with_unit(name)[1] else name
            for name, unit in zip(names, units, strict=True)
        ]
        del rows[0], numbers[0]
    if not rows:
        raise SeriesError(f"{file} has a header and no rows of numbers")
    if delimiter != "," and _has_decimal_commas(rows):
        rows = [[_pointed(cell) for cell in row] for row in rows]
    columns = dict(zip(names, zip(*rows, strict=True), strict=True))
    table = Table(file, dict(columns), {name: [name] for name in names}, numbers)
    table.hold = hold[-1] if hold else None
    table.time_unit = time_unit[-1] if time_unit else None
    return table


def _delimiter(lines: Sequence[str]) -> str:
    """That by which most of the first rows have as many cells as the header, which has several."""

    def agreeing(delimiter: str) -> int:
        try:
            rows = [row for row in islice(csv.reader(lines, delimiter=delimiter), LOOKED_AT) if row]
        except csv.Error:  # is told where the rows are read
            return 0
        return sum(len(row) == len(rows[0]) > 1 for row in rows)

    best = max(DELIMITERS, key=agreeing)
    return best if agreeing(best) else ","


def _units_in(row: Sequence[str]) -> list[str]:
    """The units that a second line of the header holds; empty where a cell is anything else."""
    units = [re.sub(r"^[\[(]\s*(.*?)\s*[\])]$", r"\1", cell.strip()) for cell in row]
    if not all(unit in ("", "-") or _is_unit(unit) for unit in units):
        return []
    return ["" if unit == "-" else unit for unit in units] if any(map(_is_unit, units)) else []


def _is_unit(text: str) -> bool:
    return text.lower() not in MISSING and (is_unit(text) or clock_of(text) != "")


def _has_decimal_commas(rows: Iterable[Iterable[str]]) -> bool:
    """Whether commas in the cells are those of decimals, of which one at least cannot part thousands.

    False where a number has a decimal point.
    """
    surely = False
    for row in rows:
        for cell in row:
            if "," in cell:
                surely = surely or (
                    DECIMAL_COMMA.fullmatch(cell) is not None and THOUSANDS.fullmatch(cell) is None
                )
            elif "." in cell and _is_number(cell.strip()):
                return False
    return surely


def _pointed(cell: str) -> str:
    return cell.replace(",", ".") if DECIMAL_COMMA.fullmatch(cell) else cell


def _short_cells(rows: Iterable[list[str]]) -> Iterator[list[str]]:
    for row in rows:
        if any(len(cell) > LONGEST_CELL for cell in row):
            raise csv.Error(_TOO_LONG)
        yield row


def read_npz(data: bytes, file: str) -> Table:
    """Arrays y, u, t, dt (or others by name) of an .npz archive."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(info.file_size for info in archive.infolist())
            if size > LARGEST_BYTES:
                raise SeriesError(
                    f"{file} unpacks to {size} bytes; at most {LARGEST_BYTES} are read"
                )
            for info in archive.infolist():
                _check_array(archive, info)
        with np.load(io.BytesIO(data), allow_pickle=False) as stored:
            found = {}
            for name in stored.files:
                try:
                    found[name] = stored[name]
                except ValueError:  # an object array: it would have to be unpickled
                    found[name] = None
    except SeriesError:
        raise
    except Exception as error:
        raise SeriesError(f"{file} is not a readable .npz archive: {error}") from error
    return _from_arrays(found, file)


def _check_array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> None:
    """Raise ValueError for an array whose header claims more than there is; room would be made for it."""
    with archive.open(info) as stream:
        if stream.read(6) != b"\x93NUMPY":
            return
        stream.seek(0)
        version = np.lib.format.read_magic(stream)
        readers = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }
        # (3, 0) is for tables with named fields, which are not used here
        if version not in readers:
            return
        shape, _, dtype = readers[version](stream)
        there = info.file_size - stream.tell()
    needed = math.prod(shape) * dtype.itemsize
    if needed > there and not dtype.hasobject:
        raise ValueError(f"the array '{info.filename}' claims {needed} bytes and has fewer")


def read_mat(data: bytes, file: str) -> Table:
    """Arrays y, u, t, dt (or others by name) of a MATLAB file, version 4 to 7."""
    if data[:4] == b"\x89HDF" or data[512:516] == b"\x89HDF" or data[:10] == b"MATLAB 7.3":
        raise SeriesError(f"{file} is a MATLAB 7.3 file; save it with -v7: save('{file}', '-v7')")
    program = [sys.executable, "-P", str(MAT_TO_NPZ), str(LARGEST_BYTES >> 20)]
    read = subprocess.run(program, input=data, capture_output=True, check=False)
    if read.returncode:
        complaint = read.stderr.decode(errors="replace").strip().splitlines()
        reason = complaint[-1] if complaint and read.returncode > 0 else "its reader crashed on it"
        raise SeriesError(f"{file} is not a readable MATLAB file: {reason}")
    return _from_arrays(dict(np.load(io.BytesIO(read.stdout), allow_pickle=False)), file)


def _from_arrays(found: dict[str, object], file: str) -> Table:
    """A table of the numeric arrays: one column per channel of a (T, n) array."""
    table = Table(file, {}, {})
    for name, value in found.items():
        if name.endswith("_names"):
            continue
        told = name.lower()
        text = _stored_text(value) if told in ("hold", "time_unit") else None
        if text is not None:
            setattr(table, told, text)
            continue
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiub" or value.ndim > 2:
            table.ignored.append(f"'{name}' is not a table of real numbers")
            continue
        array = np.asarray(value, dtype=float)
        if array.size == 1 and name.lower() in ("dt", "ts"):
            table.dt = float(array.ravel()[0])
            continue
        if array.ndim < 2 or array.shape[0] == 1:  # vectors, MATLAB's rows among them
            array = array.reshape(-1, 1)
        n = array.shape[1]
        names = _stored_names(found.get(f"{name}_names"))
        if len(names) != n:
            names = [f"{name}{i + 1}" for i in range(n)] if n > 1 else [name]
        table.groups[name] = names
        for i, column in enumerate(names):
            table.columns[column] = np.ascontiguousarray(array[:, i])
            table.groups.setdefault(column, [column])
    return table


def _stored_text(value: object) -> str | None:
    """A text as an array holds it; None for other arrays."""
    if not isinstance(value, np.ndarray) or value.dtype.kind != "U":
        return None
    return str(value.ravel()[0]) if value.size else ""


def _stored_names(value: object) -> list[str]:
    """Channel names stored beside an array."""
    return list(map(str, value.ravel())) if isinstance(value, np.ndarray) else []


def _names_below(lines: Sequence[str], first: int, last: int) -> str:
    """A hint where not the first line has the names of the columns but one below, as loggers write them."""
    head = lines[first : min(first + LOOKED_AT, last)]
    for i, line in enumerate(head[:-1]):
        for delimiter in DELIMITERS:
            names, row = (text.split(delimiter) for text in (line, head[i + 1]))
            if len(names) > 1 and len(row) == len(names) and _are_names(names) and _are_values(row):
                return (
                    f"; if line {first + i + 1} has the names, delete the lines above it"
                    if i
                    else ""
                )
    return ""


def _are_names(cells: Sequence[str]) -> bool:
    names = [cell.strip(' "') for cell in cells]
    return all(names) and len(set(names)) == len(names) and not any(map(_is_number, names))


def _are_values(cells: Sequence[str]) -> bool:
    """Whether cells are those of a row: numbers, dates and empty ones, and one number at least."""
    told = [cell.strip(' "') for cell in cells]
    numbers = [_is_number(_pointed(cell)) and cell.lower() not in MISSING for cell in told]
    return any(numbers) and all(
        number or cell.lower() in MISSING or date_of(cell) is not None or DATED.match(cell)
        for number, cell in zip(numbers, told, strict=True)
    )


def _nameless(column: int, file: str, line: int, hint: str) -> SeriesError:
    return SeriesError(f"{file}, line {line}: column {column + 1} has no name{hint}")


def _check_header(names: list[str], file: str, line: int, hint: str) -> None:
    if all(_is_number(name) for name in names if name) and any(names):
        raise SeriesError(
            f"{file}, line {line}: the first line holds numbers; it must name the columns, "
            "like t,u,y"
        )
    for i, name in enumerate(names):
        if not name and len(names) > 1:
            raise _nameless(i, file, line, hint)
        if names.count(name) > 1:
            raise SeriesError(f"{file}, line {line}: two columns are named '{name}'{hint}")


def _ragged(row: list[str], names: list[str], file: str, line: int, below: str) -> SeriesError:
    hint = below
    if not hint and len(row) == 2 * len(names):
        hint = "; are these decimal commas? write decimal points, or separate by semicolons"
    elif not hint and len(row) > len(names) and not any(map(str.strip, row[len(names) :])):
        hint = "; the line ends with a separator, and that of the names does not"
    return SeriesError(
        f"{file}, line {line}: {len(row)} cells for {len(names)} columns ({', '.join(names)}){hint}"
    )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text
