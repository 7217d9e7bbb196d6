"""Numbers, units and shares as people write them."""

from __future__ import annotations

import math
import re


def number(value: float | None, digits: int = 3) -> str:
    """``digits`` significant digits; "?" for what is not a finite number."""
    if value is None or not math.isfinite(value):
        return "?" if value is None or math.isnan(value) else ("inf" if value > 0 else "-inf")
    text = f"{value:.{digits}g}"
    return text if "e" not in text or not 1e-3 <= abs(value) < 1e6 else f"{value:.0f}"


def tidy(unit: str) -> str:
    """A unit built from others without the ones in it: ``1/s/(1^2)`` is ``1/s``; "" for a pure number."""
    text = re.sub(r"\(1\)(\^-?\d+)?|(?<![\w.])1\^-?\d+", "1", unit)
    text = text.replace("(1 s)", "(s)").replace("^1)", ")")
    text = re.sub(r"/\(1\)|/1(?![\w.])", "", text)
    return "" if text in ("1", "(1)") else text


def with_unit(value: float | None, unit: str, digits: int = 3) -> str:
    """A number and its unit; a pure number has none."""
    text = tidy(unit)
    times = "x " if re.match(r"\d+e\d", text) else ""
    return f"{number(value, digits)} {times}{text}".strip()


def percent(share: float) -> str:
    """A share as ``41 %``; small ones keep a digit."""
    if not math.isfinite(share):
        return "? %"
    value = 100.0 * share
    return f"{value:.0f} %" if value >= 9.95 or value == 0.0 else f"{value:.1f} %"


def probability(p: float) -> str:
    """``p = 0.03``, ``p < 0.0001``."""
    if not math.isfinite(p):
        return "p = ?"
    return "p < 0.0001" if p < 1e-4 else f"p = {p:.2g}"


def listed(parts: list[str], last: str = "and") -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    if len(parts) < 2:
        return "".join(parts)
    return f"{', '.join(parts[:-1])} {last} {parts[-1]}"
