"""Gaussian filtering by sigma points in a, exact in z, for many parameter vectors at once.

K copies of the filter run side by side, each with its own theta. A density N(m, P) of x = (a, z) is
represented by S = 2 na + 1 points of a, the centre and +- ``spread`` columns of the Cholesky factor of
P_aa, with z given a linear Gaussian at each of them. Expectations over a are sums with the weights
of that rule, which is exact to third order (to fifth for na = 1); over z they are exact.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from engine.kernels.gaussian import (
    MEASURED,
    is_impossible,
    log_normalizer,
    psd_cholesky_into,
    solve_lower_transposed,
    whiten,
)


@njit(cache=True, error_model="numpy")
def spread_of(na):
    """Distance of the outer points in standard deviations, and their weight."""
    square = max(3.0, float(na))
    return math.sqrt(square), 0.5 / square


@njit(cache=True, error_model="numpy")
def sigma_points(m, P, na):
    """a (K, S, na) and E(z | a) (K, S, nz) at the points; Var(z | a) (K, nz, nz); offsets (K, na, nx).

    ``offsets[k, i]`` is the change of the whole mean x that goes with point 1 + 2 i.
    """
    K, nx = m.shape
    nz = nx - na
    S = 2 * na + 1
    spread, _ = spread_of(na)
    a = np.empty((K, S, na))
    z = np.empty((K, S, nz))
    V = np.empty((K, nz, nz))
    offsets = np.zeros((K, na, nx))
    Paa = np.empty((na, na))
    L = np.empty((na, na))
    W = np.empty((na, nz))
    for k in range(K):
        for i in range(na):
            for j in range(na):
                Paa[i, j] = P[k, i, j]
        psd_cholesky_into(Paa, L)
        for c in range(nz):
            for i in range(na):
                s = P[k, i, na + c]
                for j in range(i):
                    s -= L[i, j] * W[j, c]
                W[i, c] = s / L[i, i] if L[i, i] > 0.0 else 0.0
        for r in range(nz):
            for c in range(nz):
                s = P[k, na + r, na + c]
                for i in range(na):
                    s -= W[i, r] * W[i, c]
                V[k, r, c] = s
        for i in range(na):
            for j in range(na):
                offsets[k, i, j] = spread * L[j, i]
            for c in range(nz):
                offsets[k, i, na + c] = spread * W[i, c]
        for s_ in range(S):
            i = (s_ - 1) // 2
            sign = 0.0 if s_ == 0 else (1.0 if s_ % 2 == 1 else -1.0)
            for j in range(na):
                a[k, s_, j] = m[k, j] + (sign * offsets[k, i, j] if s_ > 0 else 0.0)
            for c in range(nz):
                z[k, s_, c] = m[k, na + c] + (sign * offsets[k, i, na + c] if s_ > 0 else 0.0)
    return a, z, V, offsets


@njit(cache=True, error_model="numpy")
def transform(f, A, Q, z, V, offsets, na):
    """Moments of f(a) + A(a) z + noise: mean (K, n), covariance (K, n, n), Cov(., x) (K, n, nx).

    f (K S, n), A (1 or K S, n, nz), Q (1 or K S, n, n) at the points of :func:`sigma_points`. Moments are
    NaN where Q is no covariance: such a theta is lost.
    """
    K, S, nz = z.shape
    n = f.shape[1]
    nx = na + nz
    _, outer = spread_of(na)
    mean = np.zeros((K, n))
    cov = np.zeros((K, n, n))
    cross = np.zeros((K, n, nx))
    value = np.empty((S, n))
    AV = np.empty((n, nz))
    lost = Q.shape[0] == 1 and is_impossible(Q[0])
    for k in range(K):
        for s in range(S):
            row = k * S + s
            weight = outer if s > 0 else 1.0 - 2.0 * na * outer
            As = A[row if A.shape[0] > 1 else 0]
            Qs = Q[row if Q.shape[0] > 1 else 0]
            for i in range(n):
                v = f[row, i]
                for c in range(nz):
                    v += As[i, c] * z[k, s, c]
                value[s, i] = v
                mean[k, i] += weight * v
            if lost or (Q.shape[0] > 1 and is_impossible(Qs)):
                value[s], mean[k] = np.nan, np.nan
            if s > 0 and A.shape[0] == 1 and Q.shape[0] == 1:
                continue  # common matrices: their share was added with weight 1 at s = 0
            if A.shape[0] == 1 and Q.shape[0] == 1:
                weight = 1.0
            for i in range(n):
                for c in range(nz):
                    v = 0.0
                    for d in range(nz):
                        v += As[i, d] * V[k, d, c]
                    AV[i, c] = v
                    cross[k, i, na + c] += weight * v
            for i in range(n):
                for j in range(n):
                    v = Qs[i, j]
                    for c in range(nz):
                        v += AV[i, c] * As[j, c]
                    cov[k, i, j] += weight * v
        for s in range(S):
            weight = outer if s > 0 else 1.0 - 2.0 * na * outer
            for i in range(n):
                for j in range(n):
                    cov[k, i, j] += weight * (value[s, i] - mean[k, i]) * (value[s, j] - mean[k, j])
        for i in range(na):
            for r in range(n):
                slope = outer * (value[1 + 2 * i, r] - value[2 + 2 * i, r])
                for c in range(nx):
                    cross[k, r, c] += slope * offsets[k, i, c]
    return mean, cov, cross


@njit(cache=True, error_model="numpy")
def gaussian_update(m, P, y_mean, S, cross, y):
    """Condition N(m, P) on the channels of y (ny,) that are there.

    Returns the new m, P, and log N(y; y_mean, S) (K,).
    """
    K, nx = m.shape
    channels = np.flatnonzero(~np.isnan(y))
    n = channels.size
    m_new = m.copy()
    P_new = P.copy()
    log_p = np.zeros(K)
    Sk = np.empty((n, n))
    L = np.empty((n, n))
    W = np.empty((n, nx))
    r = np.empty(n)
    slack = np.empty(n)
    v = np.empty(n)
    for k in range(K):
        for p in range(n):
            r[p] = y[channels[p]] - y_mean[k, channels[p]]
            slack[p] = MEASURED * (abs(y[channels[p]]) + abs(y_mean[k, channels[p]]))
            for q in range(n):
                Sk[p, q] = S[k, channels[p], channels[q]]
        psd_cholesky_into(Sk, L)
        possible = whiten(L, r, slack, v)
        log_p[k] = log_normalizer(L, L.shape[0]) if possible else -np.inf
        for p in range(n):
            log_p[k] -= 0.5 * v[p] * v[p]
        for c in range(nx):
            for p in range(n):
                s = cross[k, channels[p], c]
                for q in range(p):
                    s -= L[p, q] * W[q, c]
                W[p, c] = s / L[p, p] if L[p, p] > 0.0 else 0.0
        for i in range(nx):
            for p in range(n):
                m_new[k, i] += W[p, i] * v[p]
            for j in range(nx):
                for p in range(n):
                    P_new[k, i, j] -= W[p, i] * W[p, j]
    return m_new, P_new, log_p


@njit(cache=True, error_model="numpy")
def observe(t, h, C, R, a, z, V, offsets, m, P, y, innovations, S, log_p):
    """Row t of y: :func:`transform`, :func:`gaussian_update`, and the new :func:`sigma_points`, in place.

    h, C, R at the points a, ... of m, P, which are updated; rows t of ``innovations`` (T, K, ny), ``S``
    (T, K, ny, ny) and ``log_p`` (T, K) are filled. Returns Cov(y_t, x_t) (K, ny, nx).
    """
    na = a.shape[2]
    y_mean, S_t, cross = transform(h, C, R, z, V, offsets, na)
    m_new, P_new, log_p_t = gaussian_update(m, P, y_mean, S_t, cross, y[t])
    innovations[t], S[t], log_p[t] = y[t] - y_mean, S_t, log_p_t
    _renew(m_new, P_new, a, z, V, offsets, m, P)
    return cross


@njit(cache=True, error_model="numpy")
def predict(f, A, Q, a, z, V, offsets, m, P):
    """One step ahead: :func:`transform` and the new :func:`sigma_points`, in place; Cov(x_{t+1}, x_t)."""
    m_new, P_new, cross = transform(f, A, Q, z, V, offsets, a.shape[2])
    _renew(m_new, P_new, a, z, V, offsets, m, P)
    return cross


@njit(cache=True, error_model="numpy")
def _renew(m_new, P_new, a, z, V, offsets, m, P):
    m[:], P[:] = m_new, P_new
    a[:], z[:], V[:], offsets[:] = sigma_points(m, P, a.shape[2])


@njit(cache=True, error_model="numpy")
def slopes(cross, P):
    """J (n, nx) with J P = cross: the regression of the transformed variable on x.

    Zero for directions in which P has no variance; ``engine.moment_filter.moment_path`` fills those in.
    """
    n, nx = cross.shape
    L = np.empty((nx, nx))
    psd_cholesky_into(P, L)
    J = np.empty((n, nx))
    v = np.empty(nx)
    none = np.zeros(nx)
    out = np.empty(nx)
    for r in range(n):
        whiten(L, cross[r], none, v)
        solve_lower_transposed(L, v, out)
        for c in range(nx):
            J[r, c] = out[c]
    return J


@njit(cache=True, error_model="numpy")
def keep_reading(t, cross, S, y, moments, gains):
    """Row t of what one filter kept, after :func:`observe`: slopes of y_t and the gain from Cov(y_t, x_t).

    ``moments`` are predicted m (T, nx) and P, filtered m and P; ``gains`` H (T, ny, nx), K (T, nx, ny), 0 for
    missing channels, and F.
    """
    P = moments[1][t]
    H, K, _ = gains
    H[t] = slopes(cross, P)
    K[t] = 0.0
    there = np.flatnonzero(~np.isnan(y))
    n = there.size
    own, to_x = np.empty((n, n)), np.empty((P.shape[0], n))
    for p in range(n):
        for q in range(n):
            own[p, q] = S[there[p], there[q]]
        for c in range(P.shape[0]):
            to_x[c, p] = cross[there[p], c]
    gain = slopes(to_x, own)
    for p in range(n):
        for c in range(P.shape[0]):
            K[t, c, there[p]] = gain[c, p]
