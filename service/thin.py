"""Fewer points of long curves, with their extremes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.model import Array


def keep(curves: Array, points: int) -> NDArray[np.intp]:
    """Rows of curves (n, c) to draw: the first, the last, and each bucket's extremes; sorted."""
    n, c = curves.shape
    if n <= points:
        return np.arange(n)
    buckets = max(1, (points - 2) // (2 * max(c, 1)))
    rows = {0, n - 1}
    for part in np.array_split(np.arange(n), buckets):
        values = curves[part]
        rows.update(part[np.where(np.isnan(values), np.inf, values).argmin(axis=0)].tolist())
        rows.update(part[np.where(np.isnan(values), -np.inf, values).argmax(axis=0)].tolist())
    return np.array(sorted(rows))


def thin_results(document: dict[str, Any], points: int) -> dict[str, Any]:
    """A result document with at most about ``points`` rows in its trace and in each series."""
    if "trace" in document:
        trace = document["trace"]
        _thin(trace, [trace["theta"]], points)
    for name, curves in (
        ("states", ("mean", "standard_deviation")),
        ("simulation", ("y", "states")),
    ):
        for series in document.get(name, {}).get("series", []):
            _thin(series, [series[curve] for curve in curves], points)
    return document


def _thin(holder: dict[str, Any], curves: list[dict[str, list[Any]]], points: int) -> None:
    """Thin all lists of a document, chosen by the extremes of some of its curves."""
    columns = [values for group in curves for values in group.values()]
    if not columns:
        return
    rows = keep(np.array(columns, dtype=float).T, points).tolist()
    for key, value in holder.items():
        if isinstance(value, list):
            holder[key] = [value[i] for i in rows]
        elif isinstance(value, dict):
            holder[key] = {name: [values[i] for i in rows] for name, values in value.items()}
