"""Products of units as people write them: ``product("m/s", ("s", -1))`` is ``m/s^2``."""

from __future__ import annotations

import re

_FACTOR = re.compile(r"\s*(?:(\()|([^\s()/*·^]+))")
_POWER = re.compile(r"\s*(?:\^|\*\*)\s*(-?\d+(?:\.\d+)?)")

Powers = dict[str, float]

SECOND = "s"
# As the name of a column tells them: {spelling: unit of time}.
_CLOCKS = {
    **dict.fromkeys(("ns", "us", "µs", "ms", "min", "h"), ""),
    **dict.fromkeys(("s", "sec", "second", "seconds"), "s"),
    **dict.fromkeys(("minute", "minutes"), "min"),
    **dict.fromkeys(("hr", "hour", "hours"), "h"),
    **{word + end: word for word in ("day", "week", "month", "year") for end in ("", "s")},
}
_CLOCK = re.compile(r"(?:(?:t|time)[ _]*)?[\[(]?\s*([a-zµ]+)\s*[\])]?", re.IGNORECASE)
_SPELLED = "|".join(_CLOCKS)
# Without brackets ``t_min`` and ``t_h`` may as well be temperatures. static/start/match.js has the same.
TIMES = re.compile(
    rf"(t|time)(s|[ _]*[\[(]\s*({_SPELLED})\s*[\])])?|time[ _]+({_SPELLED})|t[ _]+([nuµm]?s|sec|seconds?)",
    re.IGNORECASE,
)
_IN_BRACKETS = re.compile(r"(.*\S)\s*[\[(]\s*([^\[\]()]+(?:\([^()]*\)[^\[\]()]*)*)\s*[\])]\s*")


def clock_of(column: str) -> str:
    """The unit of time that the name of a column tells, ``time [min]``, ``t_ms``, ``year``; "" if none."""
    found = _CLOCK.fullmatch(column.strip())
    word = found[1].lower() if found else ""
    return _CLOCKS[word] or word if word in _CLOCKS else ""


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
    return clock in symbols or (clock == SECOND and "Hz" in symbols)


def alike(one: str, other: str) -> bool:
    """Whether two units are the same up to how they are written."""
    return product(one) == product(other)


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
        number, powers, rest = _expression(text)
    except ValueError:
        rest = text
    if rest:
        return 1.0, {f"({text})": 1.0}
    return number, powers


def _expression(text: str) -> tuple[float, Powers, str]:
    """Factors up to a closing bracket, and what follows; a slash divides by the one factor behind it."""
    number, powers, sign = 1.0, Powers(), 1.0
    while text and not text.startswith(")"):
        if text[0] in "/*·":
            sign, text = (-1.0 if text[0] == "/" else 1.0), text[1:].lstrip()
            if not text or text[0] in "/*·)":
                raise ValueError("a factor is missing")
        found = _FACTOR.match(text)
        if found is None:
            raise ValueError(f"'{text[0]}' is not expected")
        if found[1]:
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
    return "/".join([" ".join(above) or "1", *below])


def _raised(symbol: str, power: float) -> str:
    return symbol if power == 1.0 else f"{symbol}^{power:g}"
