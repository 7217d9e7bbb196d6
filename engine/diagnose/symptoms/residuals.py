"""One-step residuals as pictures want them: whitened, by lag, and by disturbance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.data.series import Series
from engine.diagnose.screening.disturbances import backward
from engine.distributions import chi2_sf
from engine.estimation.quasi_ml import whitening
from engine.filters.sigma_point import MomentPath
from engine.statespace.model import Array


@dataclass(frozen=True)
class Whiteness:
    """Ljung and Box (1978) on one output's standardised innovations: Q over ``lags`` lags, p-value.

    The estimated parameters are not taken off the degrees of freedom: read p as a guide.
    """

    output: str
    statistic: float
    lags: int
    p_value: float
    variance: float  # mean of z^2: 1 where the predicted uncertainty is right


def standardised(path: MomentPath, series: Series) -> Array:
    """z_t = S_t^{-1/2} nu_t by Cholesky (T, ny), NaN where missing; N(0, I) if all is right."""
    root = whitening(path.S_predicted, series.observed)
    z = np.einsum("tij,tj->ti", root, np.nan_to_num(path.innovations))
    return np.where(series.observed, z, np.nan)


def whiteness(z: Array, names: tuple[str, ...]) -> tuple[Whiteness, ...]:
    """For each output; pairs with a missing member are left out of the autocorrelations."""
    out = []
    for name, column in zip(names, z.T, strict=True):
        seen = np.isfinite(column)
        n = int(seen.sum())
        if n < 10:
            continue
        lags = int(min(20, n // 5))
        r, pairs = autocorrelation(column, lags)
        Q = float(np.sum(r**2 * pairs)) * (n + 2.0) / n
        mean_square = float(np.mean(column[seen] ** 2))
        out.append(Whiteness(name, Q, lags, float(chi2_sf(Q, lags)), mean_square))
    return tuple(out)


def autocorrelation(z: Array, lags: int) -> tuple[Array, Array]:
    """Correlations r (lags,) of z (T,) with itself at lags 1, 2, ..., and the pairs each is made of.

    Missing values are left out; r is zero where fewer than two pairs are left.
    """
    seen = np.isfinite(z)
    n = int(seen.sum())
    e = np.where(seen, z - z[seen].mean(), 0.0) if n else np.zeros(len(z))
    variance = float(e @ e) / max(n, 1)
    r, pairs = np.zeros(lags), np.zeros(lags)
    for k in range(1, lags + 1):
        pairs[k - 1] = int((seen[k:] & seen[:-k]).sum())
        if pairs[k - 1] > 1 and variance > 0.0:
            r[k - 1] = float(e[k:] @ e[:-k]) / pairs[k - 1] / variance
    return np.where(pairs > 1, r, 0.0), np.where(pairs > 1, pairs, 0.0)


def auxiliary(path: MomentPath, series: Series) -> tuple[Array, Array]:
    """Auxiliary residuals (Harvey and Koopman 1992): of the measurements (T, ny), the states (T-1, nx).

    A disturbance of x_{t+1} is r_t / sqrt(diag N_t), one of y_t is u_t / sqrt(diag D_t), with the
    disturbance smoother's r, N, u and D (:func:`engine.diagnose.screening.disturbances.backward`). Each is
    N(0, 1).
    """
    way = backward(path, series)
    of_y = _over_root(way.u, np.diagonal(way.D, axis1=1, axis2=2))
    of_x = _over_root(way.r[:-1], np.diagonal(way.N[:-1], axis1=1, axis2=2))
    return np.where(series.observed, of_y, np.nan), of_x


def _over_root(value: Array, variance: Array) -> Array:
    known = variance > 0.0
    return np.where(known, value / np.sqrt(np.where(known, variance, 1.0)), np.nan)
