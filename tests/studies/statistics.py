"""Means, spreads and their Monte Carlo errors; verdicts; bounds on rates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import beta, norm

from engine.statespace.model import Array


@dataclass(frozen=True)
class Figure:
    """A number with its Monte Carlo standard error, from ``runs`` runs."""

    value: float
    error: float
    runs: int

    def scaled(self, factor: float) -> Figure:
        """In another unit."""
        return Figure(self.value * factor, self.error * factor, self.runs)


def mean(x: Array) -> Figure:
    """Mean of the finite values of x (n,)."""
    x = x[np.isfinite(x)]
    n = len(x)
    if n < 2:
        return Figure(float(x[0]) if n else np.nan, np.nan, n)
    return Figure(float(x.mean()), float(x.std(ddof=1) / np.sqrt(n)), n)


def spread(x: Array) -> Figure:
    """Standard deviation of the finite values of x (n,); its error allows for heavy tails."""
    x = x[np.isfinite(x)]
    n = len(x)
    if n < 4:
        return Figure(float(x.std(ddof=1)) if n > 1 else np.nan, np.nan, n)
    variance = float(x.var(ddof=1))
    fourth = float(((x - x.mean()) ** 4).mean())
    error = np.sqrt(max(fourth - variance**2 * (n - 3) / (n - 1), 0.0) / n)
    root = np.sqrt(variance)
    return Figure(float(root), float(error / (2.0 * root)) if root > 0.0 else 0.0, n)


def root_mean(squares: Array) -> Figure:
    """Root of the mean of squared errors, one mean square per run (n,)."""
    m = mean(squares)
    root = float(np.sqrt(m.value))
    return Figure(root, m.error / (2.0 * root) if root > 0.0 else 0.0, m.runs)


def deviation(
    ours: Figure,
    reported: float,
    reported_runs: int,
    digits: float,
    reported_error: float | None = None,
) -> float:
    """(ours - reported) in standard errors of the difference.

    The reported value is a Monte Carlo figure too: its error, where it is not given, is taken to be
    ours, scaled to its number of runs, and ``digits``, the unit of its last digit, rounds it.
    """
    theirs = reported_error
    if theirs is None:
        theirs = ours.error * float(np.sqrt(ours.runs / reported_runs))
    total = float(np.sqrt(ours.error**2 + theirs**2 + digits**2 / 12.0))
    return (ours.value - reported) / total if total > 0.0 else np.nan


def verdict(sigmas: float) -> str:
    """What a deviation in standard errors means."""
    if not np.isfinite(sigmas):
        return "cannot be judged"
    if abs(sigmas) <= 2.0:
        return "agrees"
    side = "higher" if sigmas > 0 else "lower"
    if abs(sigmas) <= 3.0:
        return f"{side} by {abs(sigmas):.1f} s.e. (borderline)"
    return f"differs: {side} by {abs(sigmas):.1f} s.e."


def rate_bound(events: int, runs: int, level: float = 0.95) -> float:
    """Clopper-Pearson upper bound on a rate, one-sided; 0 of n gives about 3 / n."""
    if runs < 1 or events >= runs:
        return 1.0
    return float(beta.ppf(level, events + 1, runs - events))


def rate_interval(events: int, runs: int, level: float = 0.95) -> tuple[float, float]:
    """Clopper-Pearson two-sided interval of a rate."""
    side = 0.5 + level / 2.0
    lower = 0.0 if events == 0 else float(beta.ppf(1.0 - side, events, runs - events + 1))
    return lower, rate_bound(events, runs, side)


def wilson(events: int, runs: int, level: float = 0.95) -> tuple[float, float]:
    """Wilson's two-sided interval of a rate, (0, 1) of no runs."""
    if runs < 1:
        return 0.0, 1.0
    z = float(norm.ppf(0.5 + level / 2.0))
    share, scale = events / runs, 1.0 + z**2 / runs
    middle = (share + z**2 / (2.0 * runs)) / scale
    half = z / scale * np.sqrt(share * (1.0 - share) / runs + z**2 / (4.0 * runs**2))
    return float(max(middle - half, 0.0)), float(min(middle + half, 1.0))
