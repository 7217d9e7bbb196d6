"""How far two channels are apart, as a signal ``|one-other|``: of a twist, or a fall of temperature."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from engine.statespace.model import Array

MINUS, BAR = "-", "|"
ALIKE = 0.02  # of what is weighed: what a difference may leave, and be all of it


def named(one: str, other: str) -> str:
    """The name of the signal."""
    return f"{BAR}{one}{MINUS}{other}{BAR}"


def parts_of(source: str, known: Sequence[str]) -> tuple[str, ...]:
    """The two channels of ``|one-other|``, one for a channel itself; none where they are not known.

    Either may have the sign in its name.
    """
    if source in known:
        return (source,)
    inner = source[1:-1]
    ways = (i for i, sign in enumerate(inner) if sign == MINUS)
    for one, other in ((inner[:i], inner[i + 1 :]) for i in ways):
        if one != other and {one, other} <= set(known) and source == named(one, other):
            return one, other
    return ()


def value_of(source: str, values: Mapping[str, Any]) -> Any:
    """The value of a channel, or of how far two are apart, by those of channels: numbers or arrays."""
    parts = [values[name] for name in parts_of(source, list(values))]
    return parts[0] if len(parts) == 1 else np.abs(parts[0] - parts[1])


def weighed_differences(columns: Array, channels: Mapping[str, tuple[str, Array]]) -> Iterator[str]:
    """Differences of two channels to which all ``columns`` (n, k) are proportional, row by row.

    ``channels`` maps names to units and values (n,).
    """
    for one, other in combinations(channels, 2):
        (unit, x), (second, y) = channels[one], channels[other]
        apart = x - y
        size = apart @ apart
        if unit != second or not size > 0.0:
            continue
        left = columns - np.outer(apart, apart @ columns / size)
        if (np.linalg.norm(left, axis=0) <= ALIKE * np.linalg.norm(columns, axis=0)).all():
            yield named(one, other)
