"""When EM iterates have settled: a rule that respects their Monte Carlo noise.

The iterates of Monte Carlo EM never stand still. They have settled when the last 2 W of them show
no trend: for every free parameter the means of the older and the newer half differ by less than

    ``tolerance`` * size of the parameter  +  2 standard errors of that difference,

where the standard error comes from the scatter about a straight line, with the lag-one
autocorrelation of the residuals taken into account; and the last W alone show none either (a
steep beginning inside the window would hide in the scatter it makes). The estimate reported is
then the mean of the last W iterates.
"""

from __future__ import annotations

import numpy as np

from engine.statespace.model import Array

WINDOW = 20  # W


def mean_point(points: Array) -> Array:
    """Mean (n,) of points (k, n) that leaves no bound they keep: rounding may take it past them all."""
    return np.asarray(np.clip(points.mean(axis=0), points.min(axis=0), points.max(axis=0)))


def drift(iterates: Array) -> tuple[Array, Array]:
    """Difference of the half means of iterates (2 W, n), and its standard error, each (n,)."""
    n = len(iterates)
    half = n // 2
    difference = iterates[n - half :].mean(axis=0) - iterates[:half].mean(axis=0)
    x = np.arange(n) - (n - 1) / 2.0
    slope = x @ iterates / (x @ x)
    residual = iterates - iterates.mean(axis=0) - x[:, None] * slope
    variance = (residual**2).sum(axis=0) / (n - 2)
    lagged = (residual[1:] * residual[:-1]).sum(axis=0)
    power = (residual**2).sum(axis=0)
    rho = np.clip(np.divide(lagged, power, out=np.zeros_like(lagged), where=power > 0), 0.0, 0.9)
    return difference, np.sqrt(variance * (1.0 + rho) / (1.0 - rho) * 2.0 / half)


def has_settled(trace: Array, scale: Array, tolerance: float) -> bool:
    """Whether the last 2 W rows of the trace (k+1, n) show no trend; scale (n,) sizes."""
    if len(trace) < 2 * WINDOW + 1:
        return False
    for rows in (2 * WINDOW, WINDOW):
        difference, error = drift(trace[-rows:])
        if not (np.abs(difference) <= tolerance * scale + 2.0 * error).all():
            return False
    return True
