"""Fewer points of long curves, with their extremes, in a result document."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from engine.presentation.report.downsample import keep

__all__ = ["keep", "thin_results"]

# Parts beside the curves that have axes of their own, and curves that need not keep their extremes.
_OTHERS = ("autocorrelation", "quantiles", "histogram")
_FOLLOW = ("t", "iteration", "lower", "upper", "of_outputs", "of_states")


def thin_results(document: dict[str, Any], points: int) -> dict[str, Any]:
    """A result document with at most about ``points`` rows in each of its curves."""
    for holder in _holders(document):
        _thin(holder, points)
    return document


def _holders(document: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """The parts of a document that hold curves over a common axis."""
    if trace := document.get("trace"):
        yield trace
    yield from (start["trace"] for start in document.get("starts") or () if "trace" in start)
    for name in ("states", "simulation", "held_out"):
        yield from (document.get(name) or {}).get("series", [])
    symptoms = list((document.get("examination") or {}).get("series", []))
    if diagnosis := document.get("diagnosis"):
        symptoms.append(diagnosis["symptoms"])
        for part in (diagnosis["unnamed"], diagnosis["gain"]):
            if part and part.get("curves"):
                yield part["curves"]
    for one in symptoms:
        for part in (one.get("free_run"), one.get("one_step")):
            if part and part.get("curves"):
                yield part["curves"]
        if one.get("residuals"):
            yield one["residuals"]


def _thin(holder: dict[str, Any], points: int) -> None:
    """Thin all curves of a holder, in rows chosen by the extremes of those that matter."""
    n = len(holder.get("t") or holder.get("iteration") or ())
    if n <= points:
        return
    curves = {key: value for key, value in holder.items() if key not in _OTHERS}
    chosen = [value for key, value in curves.items() if key not in _FOLLOW]
    columns = np.array([c for value in chosen for c in _lists(value)], dtype=float)
    rows = keep(columns.T, points).tolist()

    def few(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: few(part) for name, part in value.items()}
        return [value[i] for i in rows] if isinstance(value, list) else value

    holder.update({key: few(value) for key, value in curves.items()})


def _lists(value: Any) -> list[list[Any]]:
    """The curves of a part: itself, or those by name."""
    if isinstance(value, dict):
        return [curve for part in value.values() for curve in _lists(part)]
    return [value] if isinstance(value, list) else []
