"""The candidates beside each other over the horizon and over budgets of noise: words for a table."""

from __future__ import annotations

import math
from typing import Any

from engine.words import number, percent

SAID = (
    "Errors of predictions over so many samples, as a share of those of the model as given; then 2 x "
    "log-likelihood gained with its process noise and with parts of it. A cause keeps its lead over the "
    "horizon and where noise is scarce, a patch on the noise does not."
)


def head(d: dict[str, Any]) -> list[str]:
    """Column titles."""
    horizons = [number(h) for h in d["horizons"][:-1]]
    budgets = ["its noise" if b == 1.0 else f"{number(b)} of it" for b in d["budgets"]]
    return ["candidate", *horizons, f"all {d['horizons'][-1]}", *budgets]


def rows(d: dict[str, Any]) -> list[list[str]]:
    """One of cells for each candidate."""
    return [
        [
            " + ".join(c["effects"]) or "as given",
            *(_share(x) for x in c["errors"]),
            *("-" if x is None or not math.isfinite(x) else number(x) for x in c["gains"]),
        ]
        for c in d["candidates"]
    ]


def _share(x: float | None) -> str:
    return "-" if x is None or not math.isfinite(x) else percent(x)
