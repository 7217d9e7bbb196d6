"""JSON that says one thing to every reader: no member twice, and null for what is not finite."""

from __future__ import annotations

import json
import math
from typing import Any

from engine.json_values import plain

PART = 20_000  # elements of a list that are written at once


def loads(text: str | bytes) -> Any:
    """What JSON text says. Raises ValueError, also where an object has a member twice: one would count."""
    return json.loads(text, object_pairs_hook=_each_once)


def _each_once(members: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in members:
        if name in found:
            raise ValueError(f"member {name!r:.80} is there twice; give it once")
        found[name] = value
    return found


def dumps(value: Any) -> str:
    """JSON text; numbers that are not finite become null.

    Long lists are written in parts: no other thread of the process runs while the library writes one.
    """
    if isinstance(value, dict) and all(isinstance(key, str) for key in value):
        return "{" + ",".join(f"{json.dumps(k)}:{dumps(item)}" for k, item in value.items()) + "}"
    if isinstance(value, list | tuple) and len(value) > PART:
        return f"[{','.join(dumps(value[i : i + PART])[1:-1] for i in range(0, len(value), PART))}]"
    if isinstance(value, list | tuple) and any(isinstance(item, dict) for item in value):
        return f"[{','.join(map(dumps, value))}]"
    try:
        return json.dumps(value, allow_nan=False, separators=(",", ":"))
    except ValueError:
        return json.dumps(plain(value), allow_nan=False, separators=(",", ":"))


def finite(value: float | None) -> float | None:
    """None for what is not finite."""
    return value if value is not None and math.isfinite(value) else None
