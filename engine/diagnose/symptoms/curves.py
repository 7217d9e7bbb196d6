"""What pictures of a comparison need, as JSON values: curves over time, bands of signals, residuals.

Numbers of curves are rounded to seven significant digits, which no picture shows and which halves
the size of the documents.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from scipy.special import ndtri

from engine.diagnose.symptoms.error_localization import Region, single_bands
from engine.diagnose.symptoms.residuals import autocorrelation
from engine.statespace.model import Array

DIGITS = 7
LAGS = 40
QUANTILES = 200  # points of a quantile plot
BINS = 30


def rounded(values: Array) -> Array:
    """Values to ``DIGITS`` significant digits; zeros and what is not finite as they are."""
    x = np.asarray(values, dtype=float)
    usual = np.isfinite(x) & (np.abs(x) > 1e-290)
    size = np.floor(np.log10(np.abs(np.where(usual, x, 1.0))))
    scale = 10.0 ** np.clip(DIGITS - 1 - size, -300, 300)
    return np.where(usual, np.round(np.where(usual, x, 1.0) * scale) / scale, x)


def named(values: Array, names: Sequence[str]) -> dict[str, list[float]]:
    """Columns of values (T, n) as lists by name."""
    return {name: rounded(values[:, i]).tolist() for i, name in enumerate(names)}


def compared(
    t: Array, measured: Array, y: Array, lower: Array, upper: Array, names: Sequence[str]
) -> dict[str, Any]:
    """Measured against simulated or predicted ``y`` with its band, all (T, ny), over times t (T,)."""
    parts = {"measured": measured, "y": y, "lower": lower, "upper": upper}
    return {"t": t.tolist()} | {key: named(values, names) for key, values in parts.items()}


def bands_of(regions: Sequence[Region]) -> list[dict[str, Any]]:
    """Errors in every single band of every signal: {output, kind, signal, unit, low, high, mean, ...}."""
    out: list[dict[str, Any]] = []
    for key in dict.fromkeys((r.output, r.kind, r.signal) for r in regions):
        mine = [r for r in regions if (r.output, r.kind, r.signal) == key]
        out += [asdict(r) for r in single_bands(mine)]
    return out


def residuals_of(
    t: Array, z: Array, of_y: Array, of_x: Array, outputs: Mapping[str, str], states: Sequence[str]
) -> dict[str, Any]:
    """Standardised innovations z (T, ny) over time, by lag and by size; auxiliary residuals over time.

    ``autocorrelation`` holds r at lags 1, 2, ... and ``limit``, beyond which one in twenty lies by chance;
    ``quantiles`` those of z beside the normal distribution's, ``histogram`` the density of z in bins.
    """
    return {
        "t": t.tolist(),
        "z": named(z, list(outputs)),
        "of_outputs": named(of_y, list(outputs)),
        "of_states": named(np.vstack([np.full((1, of_x.shape[1]), np.nan), of_x]), states),
        "autocorrelation": {n: _correlations(z[:, i]) for i, n in enumerate(outputs)},
        "quantiles": {n: _quantiles(z[:, i]) for i, n in enumerate(outputs)},
        "histogram": {n: _histogram(z[:, i]) for i, n in enumerate(outputs)},
    }


def _correlations(z: Array) -> dict[str, Any]:
    lags = min(LAGS, len(z) // 4)
    r, _ = autocorrelation(z, lags)
    seen = max(int(np.isfinite(z).sum()), 1)
    return {"r": rounded(r).tolist(), "limit": float(1.959964 / np.sqrt(seen))}


def _quantiles(z: Array) -> dict[str, list[float]]:
    values = np.sort(z[np.isfinite(z)])
    n = min(QUANTILES, values.size)
    p = (np.arange(n) + 0.5) / max(n, 1)
    if values.size > n:
        values = np.quantile(values, p)
    return {"normal": rounded(ndtri(p)).tolist(), "sample": rounded(values).tolist()}


def _histogram(z: Array) -> dict[str, list[float]]:
    values = z[np.isfinite(z)]
    if not values.size:
        return {"edges": [], "density": []}
    reach = max(float(np.abs(values).max()), 3.0)
    density, edges = np.histogram(values, bins=BINS, range=(-reach, reach), density=True)
    return {"edges": rounded(edges).tolist(), "density": rounded(density).tolist()}
