"""Whether a particle filter has lost a series: whether its likelihood is far below the moment filter's."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence

import numpy as np

from engine.data.series import Series
from engine.errors import EngineError
from engine.filters.sigma_point import moment_filter
from engine.statespace.model import Array, MixedModel, Theta

FAR_NATS = 20.0  # by which one theta is far less likely than another
# Two log-likelihoods of the particle filter may differ by so much without meaning it, in standard deviations of
# one, about sqrt(rows / effective sample size)
SPREADS = 7.0
FEW = 10  # different particles, or a quarter of all, below which their spread tells nothing


def nats_apart(rows: int, ess: float) -> float:
    """Nats by which log-likelihoods of particle filters may differ without meaning it."""
    return max(FAR_NATS, SPREADS * float(np.sqrt(rows / max(ess, 1.0))))


def nats_short(rows: int, ess: float) -> float:
    """Nats by which that of a particle filter may be below the truth: half its variance is its bias."""
    return nats_apart(rows, ess) + 0.5 * rows / max(ess, 1.0)


def left_in_words(times: Sequence[float], ess: Sequence[float]) -> str:
    """A sentence on rows, at these times, at which one particle was left, or none; "" without such rows.

    The moment filter may have lost the series itself, where a state has two likely values.
    """
    if not len(times):
        return ""
    first = next((t for t, left in zip(times, ess, strict=True) if not left > 0.0), None)
    if first is not None:  # NaN is none either
        return f"No particle was left from t = {first:g} on."
    rows = "1 row" if len(times) == 1 else f"{len(times)} rows"
    return (
        f"One particle was left at {rows}, first at t = {times[0]:g}. The log-likelihood may be far too low by "
        "that: see whether that of many more particles is the same."
    )


def few_in_words(a: Array, times: Sequence[float]) -> str:
    """A sentence where few different particles are left of ``a`` (T, M, na) at the end, not at first; else "".

    Without noise that moves them, particles that were resampled stay the same for good.
    """
    T, M, na = a.shape
    few = min(FEW, M // 4)

    def different(t: int) -> int:
        return len(np.unique(a[t], axis=0))

    if not na or not np.isfinite(a[-1]).all() or different(T - 1) >= few or different(0) < few:
        return ""
    first = bisect_left(range(T), True, key=lambda t: different(t) < few)
    return (
        f"Of {M} particles {different(T - 1)} differ in the nonlinear states at the end, and fewer than {few} "
        f"from t = {times[first]:g} on, as no noise moves them apart. Standard deviations of states and the "
        "log-likelihood rest on these few: take many more particles, or give these states a little noise."
    )


def lost_in_words(
    model: MixedModel, theta: Theta, series: Series, log_likelihood: float, ess: float
) -> str:
    """A sentence where particles with a mean effective sample size ``ess`` have lost the series, else ""."""
    try:
        moment = float(moment_filter(model, np.asarray(theta)[None], series).log_likelihood[0])
    except (EngineError, ArithmeticError, ValueError, np.linalg.LinAlgError):
        return ""
    if not moment - log_likelihood > nats_short(len(series), ess):  # NaN is not
        return ""
    return (
        f"The particles seem to have lost the series: by the moment filter its log-likelihood is {moment:.0f}. "
        "States and standard deviations by them are not to be trusted then; take many more particles."
    )
