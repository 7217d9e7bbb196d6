"""Small Gaussian algebra: roots of singular covariances, triangular solves, densities.

Every covariance is handled by its lower root L, S = L L'. A zero pivot (a direction
without noise) gives a zero column; such a direction leaves solves and densities, and a residual
in it beyond rounding makes the density zero. Nothing is inverted. What counts as rounding is
measured by numbers of the same unit: those that were subtracted, and the noise of other directions.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

LOG_2PI = math.log(2.0 * math.pi)
PIVOT = 1e-12  # a pivot below this share of its own diagonal element is rounding, not noise
ROOT_PIVOT = 1e-13  # the same of a standard deviation, where roots are never squared
ROUNDING = 1e-11  # what computing a residual may leave, as a share of the numbers it is made of ...
EXACT = 1e-7  # ... and, of the standard deviations next to it, what dropping a pivot may leave
MEASURED = 1e-7  # readings are written with seven digits or more


@njit(cache=True, error_model="numpy")
def psd_cholesky_into(S, L):
    """L (n, n) lower with L L' = S for a symmetric non-negative S (n, n); zero pivots allowed.

    Of a larger S the leading n x n block is used.
    """
    n = L.shape[0]
    for j in range(n):
        d = S[j, j]
        for k in range(j):
            d -= L[j, k] * L[j, k]
        for i in range(j):
            L[i, j] = 0.0
        if d > PIVOT * S[j, j]:
            p = math.sqrt(d)
            L[j, j] = p
            for i in range(j + 1, n):
                s = S[i, j]
                for k in range(j):
                    s -= L[i, k] * L[j, k]
                L[i, j] = s / p
        else:
            for i in range(j, n):
                L[i, j] = 0.0


@njit(cache=True, error_model="numpy")
def lower_root_into(X, L):
    """L (n, n) lower with L L' = X X' for X (n, m), by Householder reflections; zero pivots allowed.

    X is overwritten. Nothing is squared and subtracted, so that a small standard deviation beside a large
    one keeps its digits (Kailath, Sayed, Hassibi 2000, ch. 12).
    """
    n, m = X.shape
    c = 0  # columns that rows so far have taken
    for j in range(n):
        before, rest = 0.0, 0.0
        for k in range(c):
            before += X[j, k] * X[j, k]
        for k in range(c, m):
            rest += X[j, k] * X[j, k]
        for i in range(j):
            L[i, j] = 0.0
        if not rest > ROOT_PIVOT * ROOT_PIVOT * (before + rest):
            for i in range(j, n):
                L[i, j] = 0.0
            continue
        norm = math.sqrt(rest)
        first = X[j, c]
        pivot = first + norm if first > 0.0 else first - norm  # of the reflection's vector
        scale = 1.0 / (norm * abs(pivot))
        L[j, j] = norm
        for i in range(j + 1, n):
            s = X[i, c] * pivot
            for k in range(c + 1, m):
                s += X[i, k] * X[j, k]
            s *= scale
            # the reflection turns row j into -norm where first > 0; columns are turned back
            L[i, j] = s * pivot - X[i, c] if first > 0.0 else X[i, c] - s * pivot
            X[i, c] = L[i, j]
            for k in range(c + 1, m):
                X[i, k] -= s * X[j, k]
        c += 1


@njit(cache=True, error_model="numpy")
def psd_cholesky(S):
    """The lower factor of S (n, n), or of each S (M, n, n) through ``psd_cholesky_many``."""
    L = np.empty_like(S)
    psd_cholesky_into(S, L)
    return L


@njit(cache=True, error_model="numpy")
def psd_cholesky_many(S):
    """The lower factors of S (M, n, n)."""
    L = np.empty_like(S)
    for i in range(S.shape[0]):
        psd_cholesky_into(S[i], L[i])
    return L


@njit(cache=True, error_model="numpy")
def rounding(L, v, i):
    """What L_i,<i v_<i, subtracted from row i of a residual, may leave where it should cancel it."""
    s = 0.0
    for k in range(i):
        s += abs(L[i, k]) * (EXACT + ROUNDING * abs(v[k]))
    return s


@njit(cache=True, error_model="numpy")
def whiten(L, r, slack, out):
    """Out (n,) = L^{-1} r with directions without noise set to zero; False if r contradicts one.

    ``slack`` (n,): by how much r (n,) itself may be off, in its units: ROUNDING or MEASURED times the
    numbers whose difference it is. Of a larger L the leading n x n block is used.
    """
    n = r.shape[0]
    possible = True
    for i in range(n):
        s = r[i]
        for k in range(i):
            s -= L[i, k] * out[k]
        if L[i, i] > 0.0:
            out[i] = s / L[i, i]
        else:
            out[i] = 0.0
            if abs(s) > slack[i] + rounding(L, out, i):
                possible = False
    return possible


@njit(cache=True, error_model="numpy")
def solve_lower_transposed(L, v, out):
    """Out (n,) solves L' out = v, directions without noise set to zero."""
    n = L.shape[0]
    for i in range(n - 1, -1, -1):
        s = v[i]
        for k in range(i + 1, n):
            s -= L[k, i] * out[k]
        out[i] = s / L[i, i] if L[i, i] > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def log_normalizer(L, n):
    """-1/2 log det(2 pi S) over the first n directions, as far as they have noise."""
    s = 0.0
    for i in range(n):
        if L[i, i] > 0.0:
            s -= math.log(L[i, i]) + 0.5 * LOG_2PI
    return s


@njit(cache=True, error_model="numpy")
def log_normal_common(x, mean, L):
    """Log N(x_i; mean_i, L L') for x (M, n), mean (M or 1, n) and one factor L (n, n) -> (M,)."""
    M, n = x.shape
    out = np.empty(M)
    r = np.empty(n)
    slack = np.empty(n)
    v = np.empty(n)
    c = log_normalizer(L, n)
    for i in range(M):
        j = i if mean.shape[0] > 1 else 0
        for k in range(n):
            r[k] = x[i, k] - mean[j, k]
            slack[k] = ROUNDING * (abs(x[i, k]) + abs(mean[j, k]))
        if whiten(L, r, slack, v):
            q = 0.0
            for k in range(n):
                q += v[k] * v[k]
            out[i] = c - 0.5 * q
        else:
            out[i] = -np.inf
    return out


@njit(cache=True, error_model="numpy")
def whiten_points(L, r):
    """L^{-1} r for r (T, N, n) and L (T', N', n, n), T' in (1, T), N' in (1, N)."""
    T, N, n = r.shape
    out = np.empty((T, N, n))
    for t in range(T):
        for j in range(N):
            Lj = L[t if L.shape[0] > 1 else 0, j if L.shape[1] > 1 else 0]
            for i in range(n):
                if Lj[i, i] > 0.0:
                    s = r[t, j, i]
                    for k in range(i):
                        s -= Lj[i, k] * out[t, j, k]
                    out[t, j, i] = s / Lj[i, i]
                else:
                    out[t, j, i] = 0.0
    return out
