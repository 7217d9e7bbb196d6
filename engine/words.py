"""Numbers, units and shares as people write them."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from difflib import get_close_matches
from typing import Self

MOST_DIGITS = 12  # of an estimate, however small the error that is stated of it
ROUNDED = 0.05  # of an interval's width, the most by which its ends are rounded
TIME_DIGITS = 5  # of a time at least

SYMBOL = r"[^\W\d]|[%‰°]"  # a character of the name of a unit


def number(value: float | None, digits: int = 3) -> str:
    """``digits`` significant digits; "?" for what is not a finite number."""
    if value is None or not math.isfinite(value):
        return "?" if value is None or math.isnan(value) else ("inf" if value > 0 else "-inf")
    text = f"{value:.{digits}g}"
    return text if "e" not in text or not 1e-3 <= abs(value) < 1e6 else f"{value:.0f}"


def digits(value: float | None, error: float | None, least: int = 3) -> int:
    """How many digits show a value to the second one of its error, ``least`` at the fewest."""
    if not value or not error or not (math.isfinite(value) and 0.0 < error < math.inf):
        return least
    needed = math.floor(math.log10(abs(value))) - math.floor(math.log10(error)) + 2
    return min(max(least, needed), MOST_DIGITS)


class Told(float):
    """A number that tables show with so many ``digits``."""

    digits: int

    def __new__(cls, value: float, digits: int = 4) -> Self:
        """The number, which knows its digits."""
        self = super().__new__(cls, value)
        self.digits = digits
        return self


def tidy(unit: str) -> str:
    """A unit built from others without what says nothing in it; "" for a pure number.

    ``1/s/(1^2)`` is ``1/s``, and so is ``/s/(^2)``, where the unit of a pure number was left empty.
    """
    # (), (1), (^2), ()^2
    text = re.sub(r"\((?:1(?:\^-?\d+)?|\^-?\d+)?\)(?:\^-?\d+)?", "1", unit.strip())
    text = re.sub(r"(?:^|(?<=[(/* ]))1?\^-?\d+", "1", text)  # powers of one
    text = re.sub(r"(?<![\w.])1[ *](?=\S)|(?<=\S)[ *]1(?![\w./^])", "", text)  # factors of one
    text = re.sub(r"\^1(?![\d.])", "", text)
    text = re.sub(r"/1(?![\w.^])", "", text)
    text = re.sub(
        rf"/\((({SYMBOL})+(?:\^\d+)?)\)(?!\^)", r"/\1", text
    )  # brackets around a single unit
    text = re.sub(rf"\((({SYMBOL})+)\)\^", r"\1^", text)
    text = re.sub(r"(^|\()/", r"\g<1>1/", text)
    return "" if text in ("1", "(1)") else text


def factor(unit: str) -> bool:
    """Whether a unit begins with a number that multiplies: ``1e8 m^3``, ``0.001/m``; not ``1/rad``."""
    begins = re.match(r"[\d.]+(?:e[+-]?\d+)?(?=\s*[*/\s]|$)", tidy(unit))
    return begins is not None and begins[0] != "1"


def with_unit(value: float | None, unit: str, digits: int = 3) -> str:
    """A number and its unit; a pure number has none."""
    times = "x " if factor(unit) else ""
    return f"{number(value, digits)} {times}{tidy(unit)}".strip()


def moment(t: float, step: float | None = None, unit: str = "") -> str:
    """A time and its unit, with the digits that tell it from one a ``step`` later, also of clocks since 1970.

    ``step`` is None where samples are at no common one.
    """
    digits = MOST_DIGITS
    if step and math.isfinite(t):
        digits = TIME_DIGITS if t == 0.0 else math.ceil(math.log10(abs(t) / step)) + 2
    return with_unit(t, unit, min(max(digits, TIME_DIGITS), 15))


def estimate(value: float | None, error: float | None, unit: str = "") -> str:
    """``0.52 +- 0.03 N``; in words what the data do not determine.

    An estimate below its own standard error is no number to rely on, one without a standard error says so.
    """
    if value is None or not math.isfinite(value):
        return "not determined by these data"
    if error is None or not math.isfinite(error) or not error > 0.0:
        return f"{with_unit(value, unit)}, its standard error not determined by these data"
    if abs(value) < error:
        return f"of no certain size (standard error {with_unit(error, unit, 2)})"
    digits = min(max(3, int(math.log10(abs(value) / error)) + 2), MOST_DIGITS)
    return f"{number(value, digits)} +- {with_unit(error, unit, 2)}"


def fit_quality(fit: float | None) -> str:
    """``fit 91 %``; in words where the readings' mean would fit better, or where they do not vary."""
    if fit is None or math.isnan(fit):
        return "fit not defined"
    return f"fit {number(fit)} %" if fit >= 0.0 else "no better than a constant"


def bounds(low: float, high: float, unit: str = "") -> tuple[str, str]:
    """Both ends of an interval, with as many digits as tell them apart and show where it lies.

    Each is rounded by a twentieth of the width at most: of levels between 173.4 and 174.4 m, 173 and 174 m
    would be the ends of another interval.
    """
    most = ROUNDED * abs(high - low)
    for digits in range(3, 16):
        near = all(abs(float(number(end, digits)) - end) <= most for end in (low, high))
        if not most > 0.0 or not math.isfinite(most) or near:
            break
    if (
        digits > TIME_DIGITS
    ):  # far from zero, as times since 1970: not to be rounded by their distance
        digits += 2
    return with_unit(low, unit, digits), with_unit(high, unit, digits)


def ends(low: float | None, high: float | None, unit: str = "", least: int = 4) -> tuple[str, str]:
    """Both ends of an interval that tells how sure a value is, to the second digit of half its width."""
    shown = digits_of_ends(low, high, least)
    return with_unit(low, unit, shown), with_unit(high, unit, shown)


def digits_of_ends(low: float | None, high: float | None, least: int = 4) -> int:
    """How many digits show the ends of an interval to the second one of half its width."""
    if low is None or high is None:
        return least
    return digits(max(abs(low), abs(high)), 0.5 * (high - low), least)


def percent(share: float) -> str:
    """A share as ``41 %``; small ones keep a digit."""
    if not math.isfinite(share):
        return "? %"
    value = 100.0 * share
    if 0.0 < value < 0.05:
        return "less than 0.1 %"
    return f"{value:.0f} %" if value >= 9.95 or value == 0.0 else f"{value:.1f} %"


def probability(p: float, at_floor: bool = False) -> str:
    """``p = 0.03``, ``p < 0.0001``; ``p <= 0.0029`` of the least that simulation can give, ``at_floor``."""
    if not math.isfinite(p):
        return "p = ?"
    if p < 1e-4:
        return "p < 0.0001"
    return f"p {'<=' if at_floor else '='} {p:.2g}"


def enumerated(parts: list[str], last: str = "and") -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    if len(parts) < 2:
        return "".join(parts)
    return f"{', '.join(parts[:-1])} {last} {parts[-1]}"


def meant(word: str, known: Iterable[str]) -> str:
    """`` (did you mean 'delay'?)`` of a word that is not among the known ones; "" where none is near."""
    near = get_close_matches(word.partition(":")[0], list(known), 1)
    return f" (did you mean '{near[0]}'?)" if near else ""


def errors_in_words(errors: Mapping[str, float | None], units: Mapping[str, str]) -> str:
    """``0.2 mm``, of several outputs ``0.2 mm of position and 31 kPa of pressure``."""
    several = len(errors) > 1
    said = {name: with_unit(value, units.get(name, "")) for name, value in errors.items()}
    return enumerated([f"{text} of {name}" if several else text for name, text in said.items()])


def held_by_bounds(
    names: Sequence[str], none: Collection[str] = (), little: Collection[str] = ()
) -> str:
    """A sentence about parameters that a bound has stopped; empty where there are none.

    Of those in ``none`` there can be no less, as of a variance that is 0; those in ``little`` are at a lower
    bound that is next to nothing.
    """
    nothing, hardly = ([name for name in names if name in some] for some in (none, little))
    names = [name for name in names if name not in {*none, *little}]
    asked = []
    if nothing:
        many = "these are" if len(nothing) > 1 else "it is"
        asked.append(f"{' and no '.join(nothing)}: {many} at 0, the least there is.")
    if hardly:
        many = "these are at bounds" if len(hardly) > 1 else "it is at a bound"
        asked.append(f"{' and no '.join(hardly)}: {many} next to 0.")
    if asked:
        return " ".join(
            [held_by_bounds(names), *(f"The data ask for no {one}" for one in asked)]
        ).lstrip()
    if not names:
        return ""
    said = f"Stopped by a bound: {', '.join(names)}. The data draw"
    if len(names) == 1:
        return (
            f"{said} it there or beyond, so its value is the bound's more than the data's. Widen the bound "
            "where physics allows it (Parameter(bounds=)), else hold the parameter fixed (free=)."
        )
    return (
        f"{said} them there or beyond, so their values are the bounds' more than the data's. Widen the bounds "
        "where physics allows it (Parameter(bounds=)), else hold the parameters fixed (free=)."
    )


def hardly_told(names: Sequence[str]) -> str:
    """A sentence about parameters whose standard errors reach over all their bounds; empty for none."""
    if not names:
        return ""
    its, them = ("its", "it") if len(names) == 1 else ("their", "them")
    return (
        f"These data hardly tell {', '.join(names)}: {its} standard error is larger than what the bounds "
        f"allow. Keep {them} fixed at what is known, or record what shows more of {them}."
    )
