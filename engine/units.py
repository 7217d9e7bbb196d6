"""Products of units as people write them: ``product("m/s", ("s", -1))`` is ``m/s^2``."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable
from functools import lru_cache

_FACTOR = re.compile(r"\s*(?:(\()|([^\s()/*·^]+))")
_POWER = re.compile(r"\s*(?:\^|\*\*)\s*(-?\d+(?:\.\d+)?)")

# What a logarithm is of is no factor beside it: a rate of log ppb is (log ppb)/s, its inverse no 1/log/ppb.
_LOGARITHM = re.compile(r"\s*(log(?:10|2)?|ln)(?:\s+([^\s()/*·^]+)|\s*\(([^()]+)\))")

Powers = dict[str, float]

SECOND = "s"
# As the name of a column tells them: {spelling: unit of time}.
_CLOCKS = {
    **dict.fromkeys(("ns", "us", "µs", "ms", "min", "h"), ""),
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("mins", "minute", "minutes"), "min"),
    **dict.fromkeys(("hr", "hrs", "hour", "hours"), "h"),
    "d": "day",
    **{word + end: word for word in ("day", "week", "month", "year") for end in ("", "s")},
}
_CLOCK = re.compile(r"(?:(?:t|time)[ _]*/?)?[\[(]?\s*([a-zµ]+)\s*[\])]?", re.IGNORECASE)
# Behind the name of whatever else has the times: ``Zeit [ms]``, ``elapsed_ms``; ``day_of_year`` counts days.
_BEHIND_TIMES = re.compile(
    r".*[^\W_][_/ ]+([nuµm]?s|secs?|mins?|hr?s?|(?:second|minute|hour|day|week|year)s)",
    re.IGNORECASE,
)
_SPELLED = "|".join(_CLOCKS)
# Without brackets ``t_min``, ``t_h`` and ``T`` may as well be temperatures. static/start/match.js has the same.
TIMES = re.compile(
    rf"(?!(?-i:T)([sS]|[ _]+\w+)?$)((t|time)(s|[ _]*([\[(]\s*({_SPELLED})\s*[\])]|/\s*({_SPELLED})))?"
    rf"|time[ _]+({_SPELLED})|t[ _]+([nuµm]?s|sec|seconds?))",
    re.IGNORECASE,
)
_IN_BRACKETS = re.compile(r"(.*\S)\s*[\[(]\s*([^\[\]()]+(?:\([^()]*\)[^\[\]()]*)*)\s*[\])]\s*")


Meaning = tuple[float, Powers]  # size in SI units, powers of them
_BEHIND = re.compile(r"(?:_|\s*/\s*|\s+in\s+|\s+)([^\s()\[\]]+)\s*")
_NO_SUFFIX = frozenset(("in", "t"))  # as flow_in and y_t have them
_DEGREES = re.compile(r"\bdeg\.?\s+([CF])\b")
_SUPERSCRIPTS = str.maketrans("⁻¹²³⁴⁵⁶⁷⁸⁹", "-123456789")
_SUPERSCRIPT = re.compile("[⁻¹²³⁴⁵⁶⁷⁸⁹]+")
_DIGIT = re.compile(r"(?<![\w^.])([^\W\d_]+)(-?[1-9])(?![\w.])")  # of m3 and s-1
_PREFIXES = {
    "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "c": 1e-2, "d": 0.1, "h": 100.0, "k": 1e3,
    "M": 1e6, "G": 1e9,
}  # fmt: skip
# C and F may also be a coulomb and a farad, g what things weigh, and turns a minute are written 1/min, too.
_CELSIUS, _FAHRENHEIT = (1.0, {"degC": 1.0}), (1.0, {"degF": 1.0})
_DEGREE = {"degC": 1.0, "degF": 5.0 / 9.0}  # in K
_NOTHING = {"degC": -273.15, "degF": -459.67}
_NEWTON: Powers = {"kg": 1.0, "m": 1.0, "s": -2.0}
_JOULE: Powers = {"kg": 1.0, "m": 2.0, "s": -2.0}
_PASCAL: Powers = {"kg": 1.0, "m": -1.0, "s": -2.0}
_OHM: Powers = {"kg": 1.0, "m": 2.0, "s": -3.0, "A": -2.0}
_SYMBOLS: dict[str, tuple[Meaning, ...]] = {
    "m": ((1.0, {"m": 1.0}),), **dict.fromkeys(("in", "inch"), ((0.0254, {"m": 1.0}),)),
    "ft": ((0.3048, {"m": 1.0}),), **dict.fromkeys(("s", "sec"), ((1.0, {"s": 1.0}),)),
    "g": ((1e-3, {"kg": 1.0}), (9.80665, {"m": 1.0, "s": -2.0})),
    "A": ((1.0, {"A": 1.0}),), "K": ((1.0, {"K": 1.0}),), "mol": ((1.0, {"mol": 1.0}),),
    "t": ((1e3, {"kg": 1.0}),), "lb": ((0.45359237, {"kg": 1.0}),),
    "min": ((60.0, {"s": 1.0}),), **dict.fromkeys(("h", "hr"), ((3600.0, {"s": 1.0}),)),
    **dict.fromkeys(("d", "day"), ((86400.0, {"s": 1.0}),)), "week": ((604800.0, {"s": 1.0}),),
    "Hz": ((1.0, {"s": -1.0}),), "N": ((1.0, _NEWTON),),
    **dict.fromkeys(("Nm", "J"), ((1.0, _JOULE),)), "Nmm": ((1e-3, _JOULE),), "Ncm": ((1e-2, _JOULE),),
    "Wh": ((3600.0, _JOULE),), "Ah": ((3600.0, {"A": 1.0, "s": 1.0}),),
    "W": ((1.0, {"kg": 1.0, "m": 2.0, "s": -3.0}),), "Pa": ((1.0, _PASCAL),), "bar": ((1e5, _PASCAL),),
    "psi": ((6894.757293168, _PASCAL),), "atm": ((101325.0, _PASCAL),), "torr": ((101325.0 / 760.0, _PASCAL),),
    "V": ((1.0, {"kg": 1.0, "m": 2.0, "s": -3.0, "A": -1.0}),),
    **dict.fromkeys(("Ohm", "ohm", "Ω", "\u2126"), ((1.0, _OHM),)),
    "L": ((1e-3, {"m": 3.0}),), "l": ((1e-3, {"m": 3.0}),),
    "rad": ((1.0, {}),), **dict.fromkeys(("deg", "°"), ((math.pi / 180.0, {}),)),
    **dict.fromkeys(("rev", "U"), ((2.0 * math.pi, {}), (1.0, {}))),  # U/min is German for rpm
    "rpm": ((math.pi / 30.0, {"s": -1.0}), (1.0 / 60.0, {"s": -1.0})),
    "%": ((0.01, {}),), "‰": ((1e-3, {}),), "ppm": ((1e-6, {}),),
    **dict.fromkeys(("degC", "°C", "Celsius"), (_CELSIUS,)),
    **dict.fromkeys(("degF", "°F", "Fahrenheit"), (_FAHRENHEIT,)),
    "C": (_CELSIUS, (1.0, {"A": 1.0, "s": 1.0})),
    "F": (_FAHRENHEIT, (1.0, {"A": 2.0, "s": 4.0, "kg": -1.0, "m": -2.0})),
}  # fmt: skip
_PREFIXED = {
    "m", "g", "s", "A", "K", "mol", "Hz", "N", "Nm", "J", "W", "Pa", "bar", "V", "Ohm", "ohm", "Ω", "\u2126",
    "L", "l", "rad", "F", "Wh", "Ah",
}  # fmt: skip


def clock_of(column: str) -> str:
    """The unit that the name of a column of times tells, ``Zeit [min]``, ``t_ms``, ``year``; "" if none."""
    text = column.strip()
    found = _CLOCK.fullmatch(text) or _BEHIND_TIMES.fullmatch(text)
    return clock_spelled(named_with_unit(text)[1] or (found[1] if found else ""))


def clock_spelled(text: str) -> str:
    """The unit of time that a word is, ``hours``, ``Sec``, ``year``; "" if none."""
    word = text.strip().lower()
    return _CLOCKS[word] or word if word in _CLOCKS else ""


def time_column(clock: str) -> str:
    """The name of a column of times that tells their unit, ``t [min]``; ``t`` of seconds, or where none can."""
    named = f"t [{clock}]"
    return named if clock != SECOND and clock_of(named) == clock else "t"


def times_among(columns: Iterable[str], channels: Collection[str] = ()) -> list[str]:
    """The columns that are called as times are, ``t`` and ``time`` first; none that is a model's channel."""
    found = [one for one in columns if TIMES.fullmatch(one) and one not in channels]
    return sorted(found, key=lambda one: one not in ("t", "time"))


def frequency_in(clock: str) -> str:
    """The unit of a frequency where times are in ``clock``: Hz, or one over it."""
    return "Hz" if clock == SECOND else product((clock, -1.0))


def named_with_unit(column: str) -> tuple[str, str]:
    """Name and unit of ``pressure [bar]`` or ``pressure (bar)``; the unit is "" where there is none."""
    found = _IN_BRACKETS.fullmatch(column)
    return (found[1], found[2].strip()) if found else (column, "")


def is_per(unit: str, clock: str) -> bool:
    """Whether a unit of time occurs in a unit."""
    symbols = _read(unit)[1]
    known = {_CLOCKS.get(one) or one for one in symbols}  # d is day, and S no second
    return (_CLOCKS.get(clock) or clock) in known or (clock == SECOND and "Hz" in symbols)


def rate_of(unit: str) -> str:
    """The unit of time other than the second that something is counted per, as in ``L/min``; "" if none."""
    below = (symbol for symbol, power in _read(unit)[1].items() if power < 0.0)
    return next((symbol for symbol in below if symbol != SECOND and symbol in _CLOCKS), "")


def is_per_time(unit: str) -> bool:
    """Whether it tells how fast something goes or flows, as m/s, rpm and L/min do: at 0 it is at rest."""
    return any(kinds.get(SECOND) == -1.0 for _, kinds in meanings(unit))


def alike(one: str, other: str) -> bool:
    """Whether two units are the same up to how they are written."""
    return product(one) == product(other)


@lru_cache(maxsize=4096)  # each pass of a filter asks for all its channels
def differ(one: str, other: str) -> bool:
    """Whether two units are surely not the same: by their size and kind where both are known, else as written.

    Where only one of them is known nothing is sure.
    """
    if alike(one, other):
        return False
    own, wanted = meanings(one), meanings(other)
    if own and wanted:
        return not any(_equal(a, b) for a in own for b in wanted)
    return not own and not wanted


class Suffix(str):
    """A unit that stands behind a name without brackets, ``y_mm``: it may as well be a part of the name."""

    __slots__ = ()


def same_kind(one: str, other: str) -> bool:
    """Whether two units may measure the same, as mm and m."""
    return any(a[1] == b[1] for a in meanings(one) for b in meanings(other))


def unit_behind(column: str, channel: str) -> str:
    """The unit that a column has behind a channel's name, ``y_mm``, ``y/mm`` or ``y in mm``; "" if none."""
    for name in (column, re.sub("^[yu]_", "", column)):
        if name.lower().startswith(channel.lower()):
            found = _BEHIND.fullmatch(name[len(channel) :])
            if found and is_unit(found[1]) and found[1] not in _NO_SUFFIX:
                return Suffix(found[1])
    return ""


def unknown_unit(column: str) -> str:
    """What a column has in square brackets behind its name where that is neither a known unit nor an index."""
    unit = named_with_unit(column)[1]
    told = column.rstrip().endswith("]") and any(map(str.isalpha, unit))
    return unit if told and not meanings(unit) else ""


def is_unit(text: str) -> bool:
    """Whether a text is a unit that is known, and no number."""
    return bool(_read(text)[1] and meanings(text))


def meanings(unit: str) -> list[Meaning]:
    """What a unit may stand for: size in SI units, powers of them; empty where a symbol is not known."""
    number, powers = _read(_DEGREES.sub(r"deg\1", unit))
    found: list[Meaning] = [(number, {})]
    for symbol, power in powers.items():
        found = [
            (size * own_size**power, _times(kinds, own_kinds, power))
            for size, kinds in found
            for own_size, own_kinds in _known(symbol)
        ]
    return found


def time_size(unit: str) -> float | None:
    """How many seconds a unit of time has; None where that is not known."""
    known = meanings(clock_of(unit) or unit)  # hours are h
    return next((size for size, powers in known if powers == {"s": 1.0}), None)


def difference(unit: str) -> tuple[float, str] | None:
    """How large a difference of one is in SI units, and what it is one of; None where that is not known.

    So that of 1 degC is one of 1 K: it does not matter what a thermometer counts from.
    """
    known = meanings(_DEGREES.sub(r"deg\1", unit))
    if len(known) != 1:
        return None
    size, kinds = known[0]
    for symbol, degree in _DEGREE.items():
        if kinds == {symbol: 1.0}:
            size, kinds = size * degree, {"K": 1.0}
    return size, _written(1.0, dict(sorted(kinds.items())))


def zero_of(unit: str) -> float:
    """Where there is nothing of what is measured, in its unit: 0, but of degC and degF absolute zero."""
    known = meanings(unit)
    for symbol, zero in _NOTHING.items():
        if len(known) == 1 and known[0][1] == {symbol: 1.0}:
            return zero
    return 0.0


def _known(symbol: str) -> list[Meaning]:
    """The meanings of a symbol, with a prefix where it has one."""
    found = list(_SYMBOLS.get(symbol, ()))
    if found:
        return found
    for prefix, factor in _PREFIXES.items():
        stem = symbol.removeprefix(prefix)
        if stem != symbol and stem in _PREFIXED:
            found += [(factor * size, kinds) for size, kinds in _SYMBOLS[stem]]
    return found


def _times(kinds: Powers, other: Powers, power: float) -> Powers:
    out = dict(kinds)
    for kind, exponent in other.items():
        out[kind] = out.get(kind, 0.0) + power * exponent
    return {kind: exponent for kind, exponent in out.items() if exponent}


def _equal(one: Meaning, other: Meaning) -> bool:
    return one[1] == other[1] and abs(one[0] - other[0]) <= 1e-6 * abs(one[0])


def product(*factors: str | tuple[str, float]) -> str:
    """The product of units or of (unit, power); a pure number is ``1``.

    Where a unit cannot be read, for example as its brackets do not close, it stands as it is.
    """
    number, powers = 1.0, Powers()
    for factor in factors:
        unit, power = (factor, 1.0) if isinstance(factor, str) else factor
        own_number, own = _read(unit)
        number *= own_number**power
        for symbol, exponent in own.items():
            powers[symbol] = powers.get(symbol, 0.0) + power * exponent
    return _written(number, powers)


def _read(unit: str) -> tuple[float, Powers]:
    """Number and powers of a unit; as one symbol of its own where it is not understood."""
    text = unit.strip()
    try:
        number, powers, rest = _expression(
            _DIGIT.sub(_raised_digit, _SUPERSCRIPT.sub(_raised_up, text))
        )
    except ValueError:
        rest = text
    if rest:
        return 1.0, {f"({text})": 1.0}
    return number, powers


def _raised_up(found: re.Match[str]) -> str:
    return f"^{found[0].translate(_SUPERSCRIPTS)}"


def _raised_digit(found: re.Match[str]) -> str:
    """``m^3`` of ``m3``; what is no unit with a digit may be a name."""
    return f"{found[1]}^{found[2]}" if _known(found[1]) else found[0]


def _expression(text: str) -> tuple[float, Powers, str]:
    """Factors up to a closing bracket, and what follows; a slash divides by the one factor behind it."""
    number, powers, sign = 1.0, Powers(), 1.0
    while text and not text.startswith(")"):
        if text[0] in "/*·":
            sign, text = (-1.0 if text[0] == "/" else 1.0), text[1:].lstrip()
            if not text or text[0] in "/*·)":
                raise ValueError("a factor is missing")
        logarithm = _LOGARITHM.match(text)
        found = logarithm or _FACTOR.match(text)
        if found is None:
            raise ValueError(f"'{text[0]}' is not expected")
        if logarithm:
            own_number, own, text = 1.0, {_of_logarithm(logarithm): 1.0}, text[found.end() :]
        elif found[1]:
            own_number, own, rest = _expression(text[found.end() :].lstrip())
            if not rest.startswith(")"):
                raise ValueError("a bracket is not closed")
            text = rest[1:]
        else:
            own_number, own, text = *_symbol(found[2]), text[found.end() :]
        power = sign
        if raised := _POWER.match(text):
            power, text = sign * float(raised[1]), text[raised.end() :]
        number *= own_number**power
        for symbol, exponent in own.items():
            powers[symbol] = powers.get(symbol, 0.0) + power * exponent
        sign, text = 1.0, text.lstrip()
    return number, powers, text


def _of_logarithm(found: re.Match[str]) -> str:
    """One symbol for a logarithm and what it is of, however that is written."""
    inside = (found[2] or found[3]).strip()
    plain = re.fullmatch(r"[^\s()/*·^]+", inside)
    return f"({found[1]} {inside})" if plain else f"({found[1]}({inside}))"


def _symbol(word: str) -> tuple[float, Powers]:
    try:
        return float(word), {}
    except ValueError:
        return 1.0, {word: 1.0}


def _written(number: float, powers: Powers) -> str:
    above = [_raised(s, p) for s, p in powers.items() if p > 0.0]
    below = [_raised(s, -p) for s, p in powers.items() if p < 0.0]
    if number != 1.0:
        above.insert(0, f"{number:g}".replace("e+0", "e").replace("e+", "e"))
    text = "/".join([" ".join(above) or "1", *below])
    alone = re.fullmatch(r"\(((?:log(?:10|2)?|ln) [^()]*)\)", text)  # needs no brackets
    return alone[1] if alone else text


def _raised(symbol: str, power: float) -> str:
    return symbol if power == 1.0 else f"{symbol}^{power:g}"
