"""Tails and quantiles of distributions, and a test: by ``scipy.special``, as ``scipy.stats`` is slow to load.

It would take a third of the time that every process of the engine and the service takes to start.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import scipy.special
from scipy.special import bdtrc, chdtrc, chdtri, fdtrc, gammaincinv, ndtr, ndtri, stdtr, stdtrit

from engine.arrays import Array

Values: TypeAlias = float | Array


def chi2_sf(value: Values, degrees: Values) -> Array:
    """P(chi2(degrees) > value)."""
    value = np.maximum(value, 0.0)
    if np.ndim(degrees) == 0 and degrees == 1:  # the usual one, twenty times as fast
        return np.asarray(scipy.special.erfc(np.sqrt(0.5 * value)), dtype=float)
    return np.asarray(chdtrc(degrees, value), dtype=float)


def chi2_isf(p: Values, degrees: Values) -> Array:
    """The value that chi2(degrees) exceeds with probability p."""
    return np.asarray(chdtri(degrees, p), dtype=float)


def chi2_quantile(p: Values, degrees: float) -> Array:
    """The value below which chi2(degrees) is with probability p."""
    return np.asarray(2.0 * gammaincinv(0.5 * degrees, p))


def binomial_sf(least: Values, n: Values, share: Values) -> Array:
    """P(``least`` or more of n), each with the probability ``share``."""
    return np.asarray(bdtrc(np.asarray(least) - 1, n, share), dtype=float)


def normal_sf(value: Values) -> Array:
    """P(N(0, 1) > value)."""
    return np.asarray(ndtr(-np.asarray(value)), dtype=float)


def normal_isf(p: Values) -> Array:
    """The value that N(0, 1) exceeds with probability p."""
    return np.asarray(-ndtri(p), dtype=float)


def normal_quantile(p: Values) -> Array:
    """The value below which N(0, 1) is with probability p."""
    return np.asarray(ndtri(p), dtype=float)


def student_sf(value: float, degrees: float) -> float:
    """P(t(degrees) > value)."""
    return float(stdtr(degrees, -value))


def f_sf(value: float, degrees: float, left: float) -> float:
    """P(F > value) for F of so many degrees of freedom over those that are ``left``."""
    return float(fdtrc(degrees, left, value))


def student_quantile(p: float, degrees: float) -> float:
    """The value below which t(degrees) is with probability p."""
    return float(stdtrit(degrees, p))


def kurtosis_z(values: Array) -> float:
    """The kurtosis of n values as a standard normal one under normality: Anscombe and Glynn (1983)."""
    n = len(values)
    central = values - values.mean()
    kurtosis = float(np.mean(central**4) / np.mean(central**2) ** 2)
    mean = 3.0 * (n - 1) / (n + 1)
    variance = 24.0 * n * (n - 2) * (n - 3) / ((n + 1) ** 2 * (n + 3) * (n + 5))
    skewness = (6.0 * (n**2 - 5 * n + 2) / ((n + 7) * (n + 9))) * np.sqrt(
        6.0 * (n + 3) * (n + 5) / (n * (n - 2) * (n - 3))
    )
    # kurtosis is like the inverse of a chi2 of so many degrees, whose cube root is nearly normal
    degrees = 6.0 + 8.0 / skewness * (2.0 / skewness + np.sqrt(1.0 + 4.0 / skewness**2))
    standard = (kurtosis - mean) / np.sqrt(variance)
    inverse = (1.0 - 2.0 / degrees) / (1.0 + standard * np.sqrt(2.0 / (degrees - 4.0)))
    width = 2.0 / (9.0 * degrees)
    return float((1.0 - width - np.cbrt(inverse)) / np.sqrt(width))
