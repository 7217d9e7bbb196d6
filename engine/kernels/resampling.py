"""Resampling schemes and the effective sample size; report, section 4.3."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def normalize(log_w, w):
    """W (M,) = exp(log_w) / sum; returns log sum exp(log_w) and the effective sample size.

    When no weight is finite, w becomes uniform and (-inf, 0) is returned.
    """
    M = log_w.shape[0]
    top = -np.inf
    for i in range(M):
        if log_w[i] > top:
            top = log_w[i]
    if not math.isfinite(top):
        w[:] = 1.0 / M
        return -np.inf, 0.0
    total = 0.0
    for i in range(M):
        w[i] = math.exp(log_w[i] - top) if log_w[i] > -np.inf else 0.0
        total += w[i]
    squares = 0.0
    for i in range(M):
        w[i] /= total
        squares += w[i] * w[i]
    return top + math.log(total), 1.0 / squares


@njit(cache=True, error_model="numpy")
def inverse_cdf(w, points):
    """Indices of the sorted points (N,) in [0, 1) under the weights w (M,)."""
    N = points.shape[0]
    index = np.empty(N, np.int64)
    i = 0
    last = w.shape[0] - 1
    while last > 0 and not w[last] > 0.0:  # rounding of the sum must not lead to a weight of zero
        last -= 1
    c = w[0]
    for n in range(N):
        while points[n] >= c and i < last:
            i += 1
            c += w[i]
        index[n] = i
    return index


@njit(cache=True, error_model="numpy")
def multinomial(w, u):
    """N independent draws; u (N,) uniform."""
    return inverse_cdf(w, np.sort(u))


@njit(cache=True, error_model="numpy")
def stratified(w, u):
    """One draw in each of N equal strata; u (N,) uniform."""
    N = u.shape[0]
    return inverse_cdf(w, (np.arange(N) + u) / N)


@njit(cache=True, error_model="numpy")
def systematic(w, u):
    """One common offset in all N strata; u (N,) uniform, only u[0] is used."""
    N = u.shape[0]
    return inverse_cdf(w, (np.arange(N) + u[0]) / N)


@njit(cache=True, error_model="numpy")
def residual(w, u):
    """floor(N w) copies of each, the rest multinomial; u (N,) uniform."""
    N = u.shape[0]
    M = w.shape[0]
    index = np.empty(N, np.int64)
    rest = np.empty(M)
    n = 0
    for i in range(M):
        copies = math.floor(N * w[i] + 1e-12)  # N w_i may be whole but for rounding
        rest[i] = max(N * w[i] - copies, 0.0)
        for _ in range(copies):
            if n < N:
                index[n] = i
                n += 1
    if n < N:
        total = rest.sum()
        if total <= 0.0:
            rest[:] = w
            total = 1.0
        index[n:] = inverse_cdf(rest / total, np.sort(u[n:]))
    return index
