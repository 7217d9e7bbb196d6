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
    has_no_root,
    log_normalizer,
    psd_cholesky_into,
    solve_lower_transposed,
    whiten,
)

FEW = 6  # states in z up to which a sum over all of them is quicker than one that leaves zeros out


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
    a = np.empty((K, S, na))
    z = np.empty((K, S, nz))
    V = np.empty((K, nz, nz))
    offsets = np.empty((K, na, nx))
    sigma_points_into(m, P, a, z, V, offsets, np.empty((na, na)), np.empty((na, nz)))
    return a, z, V, offsets


@njit(cache=True, error_model="numpy")
def sigma_points_into(m, P, a, z, V, offsets, L, W):
    """:func:`sigma_points` into what is there; L (na, na) and W (na, nz) are overwritten."""
    K, S, na = a.shape
    nz = z.shape[2]
    spread, _ = spread_of(na)
    for k in range(K):
        psd_cholesky_into(P[k], L)
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


@njit(cache=True, error_model="numpy")
def transform(f, A, Q, z, V, offsets, na):
    """Moments of f(a) + A(a) z + noise: mean (K, n), covariance (K, n, n), Cov(., x) (K, n, nx).

    f (K S, n), A (1 or K S, n, nz), Q (1 or K S, n, n) at the points of :func:`sigma_points`. Moments are
    NaN where Q is no covariance: such a theta is lost.
    """
    K, S, nz = z.shape
    n = f.shape[1]
    mean = np.empty((K, n))
    cov = np.empty((K, n, n))
    cross = np.empty((K, n, na + nz))
    own = np.empty((S, n)), np.empty((n, nz)), np.empty((n, n)), np.empty((n, n))
    transform_into(f, A, Q, z, V, offsets, mean, cov, cross, own)
    return mean, cov, cross


@njit(cache=True, error_model="numpy")
def transform_into(f, A, Q, z, V, offsets, mean, cov, cross, own):
    """:func:`transform` into what is there; ``own`` (S, n), (n, nz) and (n, n) twice are overwritten.

    Points of one filter seldom differ in their matrices, whose products are found once where they do not.
    """
    K, S, nz = z.shape
    n = f.shape[1]
    na, nx = offsets.shape[1:]
    _, outer = spread_of(na)
    value, AV, each, root = own
    common = A.shape[0] == 1 and Q.shape[0] == 1
    A_each, Q_each = int(A.shape[0] > 1), int(Q.shape[0] > 1)
    mean[:], cov[:], cross[:] = 0.0, 0.0, 0.0
    lost = Q.shape[0] == 1 and has_no_root(Q[0], root)
    for k in range(K):
        for s in range(S):
            row = k * S + s
            weight = outer if s > 0 else 1.0 - 2.0 * na * outer
            own_A, own_Q = row * A_each, row * Q_each
            for i in range(n):
                v = f[row, i]
                for c in range(nz):
                    v += A[own_A, i, c] * z[k, s, c]
                value[s, i] = v
                mean[k, i] += weight * v
            new_Q = s == 0 or (Q_each and not _as_before(Q, row))
            new_A = s == 0 or (A_each and not _as_before(A, row))
            if new_Q and Q_each:
                lost = has_no_root(Q[row], root)
            if lost:
                for i in range(n):
                    value[s, i], mean[k, i] = np.nan, np.nan
            if s > 0 and common:
                continue  # common matrices: their share was added with weight 1 at s = 0
            if common:
                weight = 1.0
            if new_A and nz > FEW:
                _product_into(A[own_A], V[k], AV)
            elif new_A:
                for i in range(n):
                    for c in range(nz):
                        v = 0.0
                        for d in range(nz):
                            v += A[own_A, i, d] * V[k, d, c]
                        AV[i, c] = v
            if (new_A or new_Q) and nz > FEW:
                _and_back_into(AV, A[own_A], Q[own_Q], each)
            elif new_A or new_Q:
                for i in range(n):
                    for j in range(n):
                        v = Q[own_Q, i, j]
                        for c in range(nz):
                            v += AV[i, c] * A[own_A, j, c]
                        each[i, j] = v
            for i in range(n):
                for c in range(nz):
                    cross[k, i, na + c] += weight * AV[i, c]
                for j in range(n):
                    cov[k, i, j] += weight * each[i, j]
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


@njit(cache=True, error_model="numpy")
def _product_into(A, V, AV):
    """A V (n, nz), without the zeros of A: what remembers, as a dead time, hands most of its states on.

    Terms are added in the order of a whole sum, so that it is the same number to the last bit.
    """
    n, nz = AV.shape
    for i in range(n):
        for c in range(nz):
            AV[i, c] = 0.0
        for d in range(nz):
            share = A[i, d]
            if share != 0.0:
                for c in range(nz):
                    AV[i, c] += share * V[d, c]


@njit(cache=True, error_model="numpy")
def _and_back_into(AV, A, Q, each):
    """Q + A V A' (n, n), without the zeros of A."""
    n, nz = AV.shape
    for i in range(n):
        for j in range(n):
            each[i, j] = Q[i, j]
    for j in range(n):
        for c in range(nz):
            share = A[j, c]
            if share != 0.0:
                for i in range(n):
                    each[i, j] += AV[i, c] * share


@njit(cache=True, error_model="numpy")
def _as_before(matrices, row):
    """Whether a matrix (., n, m) is the one before it, number for number."""
    for i in range(matrices.shape[1]):
        for j in range(matrices.shape[2]):
            if matrices[row, i, j] != matrices[row - 1, i, j]:
                return False
    return True


@njit(cache=True, error_model="numpy")
def gaussian_update(m, P, y_mean, S, cross, y):
    """Condition N(m, P) on the channels of y (ny,) that are there.

    Returns the new m, P, and log N(y; y_mean, S) (K,).
    """
    K, nx = m.shape
    n = y.size
    m_new, P_new, log_p = m.copy(), P.copy(), np.empty(K)
    own = np.empty((n, n)), np.empty((n, n)), np.empty((n, nx)), np.empty((3, n))
    gaussian_update_into(m_new, P_new, y_mean, S, cross, y, log_p, own)
    return m_new, P_new, log_p


@njit(cache=True, error_model="numpy")
def gaussian_update_into(m, P, y_mean, S, cross, y, log_p, own):
    """:func:`gaussian_update` in place, with log_p (K,) filled.

    ``own`` (ny, ny) twice, (ny, nx) and (3, ny) are overwritten.
    """
    K, nx = m.shape
    n = 0
    for i in range(y.size):
        n += not np.isnan(y[i])
    # of the channels that are there
    Sk, L, W, rows = own[0][:n, :n], own[1][:n, :n], own[2], own[3]
    r, slack, v = rows[0, :n], rows[1, :n], rows[2, :n]
    for k in range(K):
        p = 0
        for i in range(y.size):
            if np.isnan(y[i]):
                continue
            r[p] = y[i] - y_mean[k, i]
            slack[p] = MEASURED * (abs(y[i]) + abs(y_mean[k, i]))
            q = 0
            for j in range(y.size):
                if not np.isnan(y[j]):
                    Sk[p, q] = S[k, i, j]
                    q += 1
            for c in range(nx):
                W[p, c] = cross[k, i, c]
            p += 1
        psd_cholesky_into(Sk, L)
        possible = whiten(L, r, slack, v)
        log_p[k] = log_normalizer(L, n) if possible else -np.inf
        for p in range(n):
            log_p[k] -= 0.5 * v[p] * v[p]
        for c in range(nx):
            for p in range(n):
                s = W[p, c]
                for q in range(p):
                    s -= L[p, q] * W[q, c]
                W[p, c] = s / L[p, p] if L[p, p] > 0.0 else 0.0
        for i in range(nx):
            for p in range(n):
                m[k, i] += W[p, i] * v[p]
            for j in range(nx):
                for p in range(n):
                    P[k, i, j] -= W[p, i] * W[p, j]


@njit(cache=True, error_model="numpy")
def room_for(K, S, na, nx, ny):
    """What :func:`observe` and :func:`predict` write into and leave: room is found once for all time steps.

    Roots of points; values, products and a root of each transform; what an update needs; mean of y_t,
    Cov(y_t, x_t) and Cov(x_{t+1}, x_t).
    """
    nz = nx - na
    return (
        (np.empty((na, na)), np.empty((na, nz))),
        (np.empty((S, ny)), np.empty((ny, nz)), np.empty((ny, ny)), np.empty((ny, ny))),
        (np.empty((S, nx)), np.empty((nx, nz)), np.empty((nx, nx)), np.empty((nx, nx))),
        (np.empty((ny, ny)), np.empty((ny, ny)), np.empty((ny, nx)), np.empty((3, ny))),
        (np.empty((K, ny)), np.empty((K, ny, nx)), np.empty((K, nx, nx))),
    )


@njit(cache=True, error_model="numpy")
def observe(t, h, C, R, a, z, V, offsets, m, P, y, innovations, S, log_p):
    """Row t of y: :func:`transform`, :func:`gaussian_update`, and the new :func:`sigma_points`, in place.

    h, C, R at the points a, ... of m, P, which are updated; rows t of ``innovations`` (T, K, ny), ``S``
    (T, K, ny, ny) and ``log_p`` (T, K) are filled. Returns Cov(y_t, x_t) (K, ny, nx).
    """
    K, points, na = a.shape
    room = room_for(K, points, na, m.shape[1], y.shape[1])
    return observe_in(room, t, h, C, R, a, z, V, offsets, m, P, y, innovations, S, log_p)


@njit(cache=True, error_model="numpy")
def observe_in(room, t, h, C, R, a, z, V, offsets, m, P, y, innovations, S, log_p):
    """:func:`observe` in a :func:`room_for` it."""
    y_mean, cross, _ = room[4]
    transform_into(h, C, R, z, V, offsets, y_mean, S[t], cross, room[1])
    gaussian_update_into(m, P, y_mean, S[t], cross, y[t], log_p[t], room[3])
    for k in range(m.shape[0]):
        for i in range(y.shape[1]):
            innovations[t, k, i] = y[t, i] - y_mean[k, i]
    sigma_points_into(m, P, a, z, V, offsets, *room[0])
    return cross


@njit(cache=True, error_model="numpy")
def predict(f, A, Q, a, z, V, offsets, m, P):
    """One step ahead: :func:`transform` and the new :func:`sigma_points`, in place; Cov(x_{t+1}, x_t)."""
    K, points, na = a.shape
    room = room_for(K, points, na, m.shape[1], 0)
    return predict_in(room, f, A, Q, a, z, V, offsets, m, P)


@njit(cache=True, error_model="numpy")
def predict_in(room, f, A, Q, a, z, V, offsets, m, P):
    """:func:`predict` in a :func:`room_for` it."""
    cross = room[4][2]
    transform_into(f, A, Q, z, V, offsets, m, P, cross, room[2])
    sigma_points_into(m, P, a, z, V, offsets, *room[0])
    return cross


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
