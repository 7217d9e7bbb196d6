"""The candidates beside each other over the horizon and over budgets of noise: words for a table."""

from __future__ import annotations

import math
from typing import Any

from engine.words import number, percent

ERRORS = "Errors of predictions over so many samples, as a share of those of the model as given"
GAINS = (
    "; then 2 x log-likelihood gained with its process noise and with parts of it. A cause keeps its lead over "
    "the horizon and where noise is scarce, a patch on the noise does not."
)
NO_GAINS = (
    ". A cause keeps its lead over the horizon, a patch on the noise does not. Likelihoods with parts of the "
    "process noise could not be compared, as where that of the model as given ended at a bound, or the noise "
    "of a reading is what changes."
)


def said(d: dict[str, Any]) -> str:
    """What the table shows."""
    return ERRORS + (GAINS if _has_gains(d) else NO_GAINS)


def _has_gains(d: dict[str, Any]) -> bool:
    """Whether the likelihoods of any candidate beside the model as given could be compared."""
    gains = (x for c in d["candidates"][1:] for x in c["gains"])
    return any(x is not None and math.isfinite(x) for x in gains)


def head(d: dict[str, Any]) -> list[str]:
    """Column titles."""
    horizons = [number(h) for h in d["horizons"][:-1]]
    shown = d["budgets"] if _has_gains(d) else ()
    budgets = ["its noise" if b == 1.0 else f"{number(b)} of it" for b in shown]
    return ["candidate", *horizons, f"all {d['horizons'][-1]}", *budgets]


def rows(d: dict[str, Any]) -> list[list[str]]:
    """One of cells for each candidate."""
    compared = _has_gains(d)
    return [
        [
            " + ".join(c["effects"]) or "as given",
            *(_share(x) for x in c["errors"]),
            *(
                "-" if x is None or not math.isfinite(x) else number(x)
                for x in c["gains"]
                if compared
            ),
        ]
        for c in d["candidates"]
    ]


def _share(x: float | None) -> str:
    return "-" if x is None or not math.isfinite(x) else percent(x)
