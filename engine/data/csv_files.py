"""A CSV to columns: whatever parts its cells and decimals, with units and comments at its head."""

from __future__ import annotations

import csv
import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice

from engine.data.dates import date_of
from engine.data.table import DATED, Table, is_missing, is_number
from engine.errors import SeriesError
from engine.units import clock_spelled, is_unit, named_with_unit

# Comments at the head of a CSV.
HOLD = re.compile(r"#\s*hold\s*[:=]\s*(\S+)\s*", re.IGNORECASE)
TIME_UNIT = re.compile(r"#\s*time[ _]unit\s*[:=]\s*(\S+)\s*", re.IGNORECASE)
# Which count before the others: a comma may stand in a name or a number.
DELIMITERS = (";", "\t", ",")
EXCEL = re.compile(r'"?sep=(.)"?', re.IGNORECASE)  # the first line of its files, which it hides
LOOKED_AT = 100  # rows, for the delimiter
FIRST = (
    "column 1"  # the name of a first column without one, of which nothing is used unasked but dates
)
DECIMAL_COMMA = re.compile(r"\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*")
THOUSANDS = re.compile(r"\s*[+-]?[1-9]\d{0,2},\d{3}\s*")  # or three decimals
CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f\x7f]")  # in no text
LONGEST_CELL = 131_072  # characters of a cell; as csv has it, whose own limit anybody may change
_TOO_LONG = f"a cell has more than {LONGEST_CELL} characters; is a quotation mark left open?"


def read_csv(data: bytes, file: str) -> Table:
    """A CSV with one header line; delimiter comma, semicolon, tab or blanks; leading # lines skipped.

    Where commas do not part cells they may be those of decimals. Units may have a second line of their own, and
    the header may be the last of the # lines.
    """
    text, note = _decoded(data, file)
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
    lines_above = [line for line in lines[:first] if line.strip()]
    commented = "" if told or not first else _commented(lines[:first], lines[first])
    if commented:
        first -= 1
        lines[first] = commented
    _without_comments(lines, first, last)
    delimiter = told[1] if told else _delimiter(lines[first:last])
    if not told and delimiter == "," and _in_blanks(lines[first:last]):
        lines[first:last] = ["\t".join(line.split()) for line in lines[first:last]]
        delimiter = "\t"
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
        if not below and named > 1 and all(names[1:named]):
            names[0] = names[0] or FIRST  # as R and pandas write the names of rows, which have none
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
    table.notes += [note] if note else []
    farther = commented and lines_above and lines_above[-1].removeprefix("#").strip() != commented
    if farther or (commented and delimiter != "," and " ".join(names) == commented):
        # so many words may be any comment
        table.notes.append(f"the columns are named as the comment above them says: {commented}.")
    table.hold = hold[-1] if hold else None
    table.time_unit = time_unit[-1] if time_unit else None
    return table


def _decoded(data: bytes, file: str) -> tuple[str, str]:
    """The text of a file, and a note where its encoding is a guess: that of older programs on Windows.

    There only names and units can be wrong: numbers are written in ASCII.
    """
    wide = data.startswith((BOM_UTF16_LE, BOM_UTF16_BE))  # as Excel's "Unicode text" does
    try:
        return data.decode("utf-16" if wide else "utf-8-sig"), ""
    except UnicodeDecodeError as error:
        try:
            text = "\0" if wide else data.decode("cp1252")
        except UnicodeDecodeError:
            text = "\0"
        if not CONTROL.search(text):
            return text, "not UTF-8 text, but read as such of Windows (cp1252)."
        line = data.count(b"\n", 0, error.start) + 1
        kind = "UTF-16" if wide else "UTF-8"
        raise SeriesError(
            f"{file}, line {line}: not {kind} text; save the file as UTF-8"
        ) from error


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


def _commented(above: Sequence[str], first: str) -> str:
    """The names where a comment above the first row has them, as ``numpy.savetxt`` writes; else empty.

    Blanks part names in the last comment only, as in others so many words may be anything.
    """
    comments = [line for line in above if line.strip()]
    for line in reversed(comments):
        if HOLD.fullmatch(line.strip()) or TIME_UNIT.fullmatch(line.strip()):
            continue
        names = line.removeprefix("#").strip()
        for parted in (None, *DELIMITERS) if line is comments[-1] else DELIMITERS:
            row, told = first.split(parted), names.split(parted)
            if len(row) == len(told) > 1 and _are_names(told) and _are_values(row):
                return names
    return ""


def _without_comments(lines: list[str], first: int, last: int) -> None:
    """Empty the comments right below the line of names ``first``: # lines that are no row of as many cells."""
    marks = [mark for mark in (None, *DELIMITERS) if _cells(lines[first], mark) > 1]
    for i in range(first + 1, last if marks else 0):
        if lines[i].strip() and not lines[i].startswith("#"):
            return
        if all(_cells(lines[first], mark) != _cells(lines[i], mark) for mark in marks):
            lines[i] = ""


def _cells(line: str, mark: str | None) -> int:
    return len(line.split(mark))


def _in_blanks(lines: Sequence[str]) -> bool:
    """Whether blanks part the cells, as in tables that simulators print: a number for each name in each row."""
    names = lines[0].split()
    rows = [row for line in lines[1:] if (row := line.split())]
    return (
        len(names) > 1
        and bool(rows)
        and "," not in lines[0]
        and _are_names(names)
        and all(len(row) == len(names) and all(map(is_number, row)) for row in rows)
    )


def _units_in(row: Sequence[str]) -> list[str]:
    """The units that a second line of the header holds; empty where a cell is anything else."""
    units = [re.sub(r"^[\[(]\s*(.*?)\s*[\])]$", r"\1", cell.strip()) for cell in row]
    units[0] = units[0].removeprefix("#").strip()  # the line is a comment to other programs
    if not all(unit in ("", "-") or _is_unit(unit) for unit in units):
        return []
    return ["" if unit == "-" else unit for unit in units] if any(map(_is_unit, units)) else []


def _is_unit(text: str) -> bool:
    return not is_missing(text) and (is_unit(text) or clock_spelled(text) != "")


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
            elif "." in cell and is_number(cell.strip()):
                return False
    return surely


def _pointed(cell: str) -> str:
    return cell.replace(",", ".") if DECIMAL_COMMA.fullmatch(cell) else cell


def _short_cells(rows: Iterable[list[str]]) -> Iterator[list[str]]:
    for row in rows:
        if any(len(cell) > LONGEST_CELL for cell in row):
            raise csv.Error(_TOO_LONG)
        yield row


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
    return all(names) and len(set(names)) == len(names) and not any(map(is_number, names))


def _are_values(cells: Sequence[str]) -> bool:
    """Whether cells are those of a row: numbers, dates and empty ones, and one number at least."""
    told = [cell.strip(' "') for cell in cells]
    numbers = [is_number(_pointed(cell)) and not is_missing(cell) for cell in told]
    return any(numbers) and all(
        number or is_missing(cell) or date_of(cell) is not None or DATED.match(cell)
        for number, cell in zip(numbers, told, strict=True)
    )


def _nameless(column: int, file: str, line: int, hint: str) -> SeriesError:
    return SeriesError(f"{file}, line {line}: column {column + 1} has no name{hint}")


def _check_header(names: list[str], file: str, line: int, hint: str) -> None:
    words = " ".join(names).split()  # blanks may part them
    if words and all(map(is_number, words)):
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
