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
# Of its variances: a covariance may be off by so much, and no more, and still be one.
NEGATIVE = 1e-9
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
def is_impossible(S):
    """Whether S (n, n) is no covariance: not symmetric, or with a negative eigenvalue, beyond rounding.

    In any units: it is one where S + NEGATIVE diag(S) has a Cholesky factor. What is not finite is not judged.
    """
    return has_no_root(S, np.empty(S.shape))


@njit(cache=True, error_model="numpy")
def has_no_root(S, L):
    """:func:`is_impossible`; L (n, n) is overwritten."""
    n = S.shape[0]
    if n == 1:
        return S[0, 0] < 0.0
    for j in range(n):
        d = S[j, j] * (1.0 + NEGATIVE)
        for k in range(j):
            d -= L[j, k] * L[j, k]
        if d < 0.0 or (d == 0.0 and S[j, j] > 0.0):
            return True
        p = math.sqrt(d)
        for i in range(j):
            if abs(S[i, j] - S[j, i]) > NEGATIVE * math.sqrt(S[i, i] * S[j, j]):
                return True
        for i in range(j + 1, n):
            s = S[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if p == 0.0 and s != 0.0:
                return True
            L[i, j] = s / p if p > 0.0 else 0.0
    return False


@njit(cache=True, error_model="numpy")
def impossible(S):
    """Which of S (M, n, n) are no covariances (M,)."""
    out = np.empty(S.shape[0], np.bool_)
    for i in range(S.shape[0]):
        out[i] = is_impossible(S[i])
    return out


@njit(cache=True, error_model="numpy")
def any_impossible(S):
    """Whether one of S (M, n, n) is no covariance."""
    L = np.empty(S.shape[1:])
    for i in range(S.shape[0]):  # noqa: SIM110 - Numba knows no any()
        if has_no_root(S[i], L):
            return True
    return False


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
def lower_roots_into(X, L):
    """``lower_root_into`` for X (n, m, M) and L (n, n, M): M of them at once, side by side in memory.

    So the compiler uses SIMD. Where one meets a zero pivot, which takes no column, each goes by itself.
    """
    n, m, M = X.shape
    if M == 1:
        _one_by_one(X, L)
        return
    kept = X.copy()
    before, rest, pivot, scale, s = np.empty((5, M))
    for j in range(n):
        before[:] = 0.0
        rest[:] = 0.0
        for k in range(j):
            L[k, j] = 0.0
            for i in range(M):
                before[i] += X[j, k, i] * X[j, k, i]
        for k in range(j, m):
            for i in range(M):
                rest[i] += X[j, k, i] * X[j, k, i]
        lost = 0
        for i in range(M):
            lost += not rest[i] > ROOT_PIVOT * ROOT_PIVOT * (before[i] + rest[i])
        if lost:
            _one_by_one(kept, L)
            return
        for i in range(M):
            norm = math.sqrt(rest[i])
            first = X[j, j, i]
            pivot[i] = first + norm if first > 0.0 else first - norm
            scale[i] = 1.0 / (norm * abs(pivot[i]))
            L[j, j, i] = norm
        for q in range(j + 1, n):
            for i in range(M):
                s[i] = X[q, j, i] * pivot[i]
            for k in range(j + 1, m):
                for i in range(M):
                    s[i] += X[q, k, i] * X[j, k, i]
            for i in range(M):
                s[i] *= scale[i]
                turned = s[i] * pivot[i] - X[q, j, i]
                L[q, j, i] = turned if pivot[i] > 0.0 else -turned
                X[q, j, i] = L[q, j, i]
            for k in range(j + 1, m):
                for i in range(M):
                    X[q, k, i] -= s[i] * X[j, k, i]


@njit(cache=True, error_model="numpy")
def _one_by_one(X, L):
    n, m, M = X.shape
    one = np.empty((n, m))
    root = np.empty((n, n))
    for i in range(M):
        one[:] = X[:, :, i]
        lower_root_into(one, root)
        L[:, :, i] = root


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
def log_normal_columns(L, r, slack, log_p):
    """``whiten`` for every column of r (n, M), in place, with log N(r_i; 0, L L') in log_p (M,)."""
    n, M = r.shape
    log_p[:] = log_normalizer(L, n)
    for p in range(n):
        for k in range(p):
            s = L[p, k]
            for i in range(M):
                r[p, i] -= s * r[k, i]
        s = L[p, p]
        if s > 0.0:
            for i in range(M):
                v = r[p, i] / s
                r[p, i] = v
                log_p[i] -= 0.5 * v * v
        else:
            for i in range(M):
                if abs(r[p, i]) > slack[p, i] + rounding(L, r[:, i], p):
                    log_p[i] = -np.inf
                r[p, i] = 0.0


@njit(cache=True, error_model="numpy")
def whiten_each(L, r, slack, possible):
    """``whiten`` for each column of r (n, M), in place, by a root of its own: L (n', n', M).

    ``possible`` (M,) becomes False where r contradicts a direction without noise.
    """
    n, M = r.shape
    for p in range(n):
        for k in range(p):
            for i in range(M):
                r[p, i] -= L[p, k, i] * r[k, i]
        least = np.inf
        for i in range(M):
            least = min(least, L[p, p, i])
        if least > 0.0:
            for i in range(M):
                r[p, i] /= L[p, p, i]
            continue
        for i in range(M):
            if L[p, p, i] > 0.0:
                r[p, i] /= L[p, p, i]
                continue
            if abs(r[p, i]) > slack[p, i] + rounding(L[:, :, i], r[:, i], p):
                possible[i] = False
            r[p, i] = 0.0


@njit(cache=True, error_model="numpy")
def log_normal_each(L, r, slack, log_p):
    """log N(r_i; 0, L_i L_i') (M,) for the columns of r (n, M), which are whitened by ``whiten_each``."""
    n, M = r.shape
    possible = np.ones(M, np.bool_)
    whiten_each(L, r, slack, possible)
    for i in range(M):
        log_p[i] = 0.0 if possible[i] else -np.inf
    for k in range(n):
        for i in range(M):
            if L[k, k, i] > 0.0:
                log_p[i] -= math.log(L[k, k, i]) + 0.5 * (LOG_2PI + r[k, i] * r[k, i])


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
