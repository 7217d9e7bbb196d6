"""Dates as text: as ISO 8601 writes them, with dots, and with slashes, where the column tells their order."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime
from itertools import pairwise

# Day, month and year with dots between them have this order everywhere; with slashes two are usual.
DOTTED = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4})(?:[ T]+(\d{1,2})(:[0-5]\d.*))?")
YEAR_FIRST = re.compile(r"(\d{4})/(\d{1,2})/(\d{1,2})(?:[ T]+(\d{1,2})(:[0-5]\d.*))?")
SLASHED = re.compile(
    r"(\d{1,2})/(\d{1,2})/(\d{4})(?:[ T,]+(\d{1,2})(:[0-5]\d(?::[0-5]\d(?:[.,]\d+)?)?)(?: ?([AP])M)?)?",
    re.IGNORECASE,
)
NAMED = re.compile(
    r"(\d{1,2})[-./ ]+([a-z]{3})[a-z]*[-./ ]+(\d{4})(?:[ T]+(\d{1,2})(:[0-5]\d.*))?", re.IGNORECASE
)
MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
ZONE = re.compile(r"\s*(?:UTC|GMT)$|\s+(?=[+-]\d\d:?\d\d$)")  # set apart, or by its name
OF_A_DAY = re.compile(r"(\d{4}-\d\d-\d\d)(Z|[+-]\d\d:?\d\d)")  # Python reads it as a time of day
EVEN = 0.9  # the shortest step as a share of the longest, from which on steps are even
DAY_FIRST, MONTH_FIRST = "day/month/year", "month/day/year"


def date_of(text: str) -> datetime | None:
    """A date such as 2024-03-01T13:45:00+01:00, 2024/03/01, 1.3.2024 13:45 or 01-Mar-2024; None of others.

    A number is none.
    """
    try:
        float(text)
    except ValueError:
        pass
    else:
        return None
    text = ZONE.sub(lambda found: "+00:00" if found[0].strip() else "", text.strip())
    if dotted := DOTTED.fullmatch(text):
        day, month, year, hour, rest = dotted.groups()
        return _date(year, month, day, hour, rest)
    if slashed := YEAR_FIRST.fullmatch(text):
        return _date(*slashed.groups())
    if (named := NAMED.fullmatch(text)) and named[2].lower() in MONTHS:
        day, month, year, hour, rest = named.groups()
        return _date(year, str(1 + MONTHS.index(month.lower())), day, hour, rest)
    try:
        return datetime.fromisoformat(OF_A_DAY.sub(r"\1T00:00\2", text))
    except ValueError:
        return None


def with_slashes(cells: Sequence[str]) -> bool:
    """Whether the first cell that is not empty is a date such as 3/1/2024 1:45 PM, in either order."""
    return SLASHED.fullmatch(next(filter(str.strip, cells), "").strip()) is not None


def in_order(cells: Sequence[str], order: str) -> list[datetime | None]:
    """The dates of cells with slashes in an order, None for those that are none."""
    return [_slashed(cell, order) for cell in cells]


def order_of(cells: Sequence[str]) -> tuple[str, bool]:
    """The order of dates with slashes, "" where neither reads all or nothing tells which; whether that is sure.

    A day after the 12th tells. Else it is the one in which time goes on, or goes on by even steps.
    """
    steps = {}
    for order in (DAY_FIRST, MONTH_FIRST):
        dates = [one for one in in_order(cells, order) if one is not None]
        if len(dates) == len(cells):
            steps[order] = [(b - a).total_seconds() for a, b in pairwise(dates)]
    if len(steps) < 2:
        return next(iter(steps), ""), True
    if steps[DAY_FIRST] == steps[MONTH_FIRST]:
        return DAY_FIRST, True  # the same times either way
    for least in (lambda own: 0.0, lambda own: EVEN * max(own)):
        left = [order for order, own in steps.items() if own and min(own) > least(own)]
        if len(left) == 1:
            return left[0], False
    return "", False


def about_orders(text: str) -> str:
    """What to do where dates with slashes may be of either order."""
    return (
        f"'{text.strip()}' may have its day or its month first, and nothing tells which: write dates as "
        "2024-03-01 13:45:00"
    )


def _slashed(cell: str, order: str) -> datetime | None:
    found = SLASHED.fullmatch(cell.strip())
    if found is None:
        return None
    first, second, year, hour, rest, half = found.groups()
    if half:
        if not 1 <= int(hour) <= 12:
            return None
        hour = str(int(hour) % 12 + (12 if half.upper() == "P" else 0))
    day, month = (first, second) if order == DAY_FIRST else (second, first)
    return _date(year, month, day, hour, rest)


def _date(year: str, month: str, day: str, hour: str | None, rest: str | None) -> datetime | None:
    text = f"{year}-{month:0>2}-{day:0>2}" + (f" {hour:0>2}{rest}" if hour else "")
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None
