"""Gaussian filtering by sigma points in a, exact in z, for many parameter vectors at once.

K copies of the filter run side by side, each with its own theta. A density N(m, P) of x = (a, z) is
represented by S = 2 na + 1 points of a, the centre and +- ``spread`` columns of the Cholesky factor of
P_aa, with z given a linear Gaussian at each of them. Expectations over a are sums with the weights
of that rule, which is exact to third order (to fifth for na = 1); over z they are exact.

Copies lie side by side in memory, on the last axis, so that the compiler works on several at once: of m
(nx, K), P (nx, nx, K), z (S, nz, K), V (nz, nz, K), offsets (na, nx, K). What models give and take has a row
for each point, ``row = k S + s``. :func:`sigma_points`, :func:`transform` and :func:`gaussian_update` take and
give the copies on the first axis. What makes a step is put into its place by Numba (inline): to hand over
so many arrays takes as long as what is done with them.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from engine.kernels.gaussian import (
    MEASURED,
    NEGATIVE,
    PIVOT,
    log_normal_each,
)


@njit(cache=True, error_model="numpy")
def spread_of(na):
    """Distance of the outer points in standard deviations, and their weight."""
    square = max(3.0, float(na))
    return math.sqrt(square), 0.5 / square


@njit(cache=True, error_model="numpy")
def copies_last(x):
    """(K, n, m) as (n, m, K)."""
    return x.transpose(1, 2, 0).copy()


@njit(cache=True, error_model="numpy")
def copies_first(x):
    """(n, m, K) as (K, n, m)."""
    return x.transpose(2, 0, 1).copy()


@njit(cache=True, error_model="numpy")
def sigma_points(m, P, na):
    """a (K, S, na) and E(z | a) (K, S, nz) at the points; Var(z | a) (K, nz, nz); offsets (K, na, nx).

    ``offsets[k, i]`` is the change of the whole mean x that goes with point 1 + 2 i.
    """
    K, S = m.shape[0], 2 * na + 1
    rows, beside = points_of(m.T.copy(), copies_last(P), na)
    z, V, offsets = beside
    return rows.reshape(K, S, na), copies_first(z), copies_first(V), copies_first(offsets)


@njit(cache=True, error_model="numpy")
def points_of(m, P, na):
    """Rows a (K S, na) of the points of m and P, and z, V and offsets."""
    nx, K = m.shape
    nz, S = nx - na, 2 * na + 1
    rows = np.empty((K * S, na))
    beside = np.empty((S, nz, K)), np.empty((nz, nz, K)), np.empty((na, nx, K))
    points_into(m, P, rows, beside, room_for_points(na, nz, K))
    return rows, beside


@njit(cache=True, error_model="numpy")
def room_for_points(na, nz, K):
    """What :func:`points_into` overwrites."""
    return np.empty((na, na, K)), np.empty((na, nz, K))


@njit(cache=True, error_model="numpy", inline="always")
def points_into(m, P, rows, beside, room):
    """:func:`points_of` into what is there."""
    z, V, offsets = beside
    L, W = room
    S, nz, K = z.shape
    na = L.shape[0]
    spread, _ = spread_of(na)
    _roots_into(P, L)
    for i in range(na):
        for c in range(nz):
            for k in range(K):
                W[i, c, k] = P[i, na + c, k]
            for j in range(i):
                for k in range(K):
                    W[i, c, k] -= L[i, j, k] * W[j, c, k]
            for k in range(K):
                W[i, c, k] = W[i, c, k] / L[i, i, k] if L[i, i, k] > 0.0 else 0.0
                offsets[i, na + c, k] = spread * W[i, c, k]
        for j in range(na):
            for k in range(K):
                offsets[i, j, k] = spread * L[j, i, k]
    for r in range(nz):
        for c in range(r + 1):
            for k in range(K):
                V[r, c, k] = P[na + r, na + c, k]
            for i in range(na):
                for k in range(K):
                    V[r, c, k] -= W[i, r, k] * W[i, c, k]
            for k in range(K):
                V[c, r, k] = V[r, c, k]
    for s in range(S):
        i, sign = max(s - 1, 0) // 2, 0.0 if s == 0 else (1.0 if s % 2 == 1 else -1.0)
        for j in range(na):
            for k in range(K):
                rows[k * S + s, j] = m[j, k] + sign * offsets[i, j, k] if s > 0 else m[j, k]
        for c in range(nz):
            for k in range(K):
                z[s, c, k] = m[na + c, k] + sign * offsets[i, na + c, k] if s > 0 else m[na + c, k]


@njit(cache=True, error_model="numpy")
def _roots_into(S, L):
    """``psd_cholesky_into`` for each S (n', n', K) and L (n, n, K)."""
    n, _, K = L.shape
    for j in range(n):
        for k in range(K):
            L[j, j, k] = S[j, j, k]
        for q in range(j):
            for k in range(K):
                L[q, j, k] = 0.0
                L[j, j, k] -= L[j, q, k] * L[j, q, k]
        for k in range(K):
            L[j, j, k] = math.sqrt(L[j, j, k]) if L[j, j, k] > PIVOT * S[j, j, k] else 0.0
        for i in range(j + 1, n):
            for k in range(K):
                L[i, j, k] = S[i, j, k]
            for q in range(j):
                for k in range(K):
                    L[i, j, k] -= L[i, q, k] * L[j, q, k]
            for k in range(K):
                L[i, j, k] = L[i, j, k] / L[j, j, k] if L[j, j, k] > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def transform(f, A, Q, z, V, offsets, na):
    """Moments of f(a) + A(a) z + noise: mean (K, n), covariance (K, n, n), Cov(., x) (K, n, nx).

    f (K S, n), A (1 or K S, n, nz), Q (1 or K S, n, n) at the points of :func:`sigma_points`. Moments are
    NaN where Q is no covariance: such a theta is lost.
    """
    K, S, nz = z.shape
    n, nx = f.shape[1], na + nz
    beside = copies_last(z), copies_last(V), copies_last(offsets)
    mean, cov, cross = np.empty((n, K)), np.empty((n, n, K)), np.empty((n, nx, K))
    room = room_for_transform(n, nz, S, K)
    transform_into(f, A, Q, beside, mean, cov, cross, room, (False, False))
    return mean.T.copy(), copies_first(cov), copies_first(cross)


@njit(cache=True, error_model="numpy")
def room_for_transform(n, nz, S, K):
    """What :func:`transform_into` overwrites: values; A, Q, A V and Q + A V A'; which are not zero, or lost."""
    return (
        np.empty((S, n, K)),
        (np.empty((n, nz, K)), np.empty((n, n, K)), np.empty((n, nz, K)), np.empty((n, n, K))),
        (np.empty((n, nz), np.bool_), np.empty(K, np.bool_)),
    )


@njit(cache=True, error_model="numpy", inline="always")
def transform_into(f, A, Q, beside, mean, cov, cross, room, known):
    """:func:`transform` of z, V, offsets (``beside``) into mean (n, K), cov (n, n, K), cross (n, nx, K).

    Points of one filter seldom differ in their matrices, whose products are found once where they do not.
    ``known``: whether A, and whether Q, are in the ``room`` already, as where no state and no time moves them.
    """
    z, V, offsets = beside
    value, (A_s, Q_s, AV, each), (some, lost) = room
    S, n, K = value.shape
    na, nx, _ = offsets.shape
    _, outer = spread_of(na)
    share = 0.0  # of the points with matrices as those last found
    apart = False
    for s in range(S):
        weight = outer if s > 0 else 1.0 - 2.0 * na * outer
        new_A = not known[0] and (s == 0 or _differ(A, S, s))
        new_Q = not known[1] and (s == 0 or _differ(Q, S, s))
        if s > 0 and (new_A or new_Q):
            _add_matrices(share, AV, each, cov, cross, not apart)
            apart, share = True, 0.0
        share += weight
        if new_A:
            _at_point(A, S, s, A_s)
            _not_zero(A_s, some)
        if new_Q:
            _at_point(Q, S, s, Q_s)
            _impossible(Q_s, each, lost)
        if s == 0 or new_A or new_Q:
            _products(A_s, Q_s, V, some, AV, each)
        _values(f, z, A_s, some, lost, s, value[s])
        for i in range(n):
            if s == 0:
                for k in range(K):
                    mean[i, k] = weight * value[s, i, k]
            else:
                for k in range(K):
                    mean[i, k] += weight * value[s, i, k]
    _add_matrices(share if apart else 1.0, AV, each, cov, cross, not apart)
    for s in range(S):
        weight = outer if s > 0 else 1.0 - 2.0 * na * outer
        for i in range(n):
            for k in range(K):
                value[s, i, k] -= mean[i, k]
            for j in range(i + 1):
                for k in range(K):
                    cov[i, j, k] += weight * value[s, i, k] * value[s, j, k]
    for i in range(n):
        for j in range(i):
            for k in range(K):
                cov[j, i, k] = cov[i, j, k]
    for i in range(na):
        for r in range(n):
            for k in range(K):
                value[0, r, k] = outer * (value[1 + 2 * i, r, k] - value[2 + 2 * i, r, k])
            for c in range(nx):
                for k in range(K):
                    cross[r, c, k] += value[0, r, k] * offsets[i, c, k]


@njit(cache=True, error_model="numpy")
def _differ(matrices, S, s):
    """Whether matrices (1 or K S, n, m) at point s are, of some copy, not those at the point before."""
    if matrices.shape[0] == 1:
        return False
    for row in range(s, matrices.shape[0], S):
        for i in range(matrices.shape[1]):
            for j in range(matrices.shape[2]):
                if matrices[row, i, j] != matrices[row - 1, i, j]:
                    return True
    return False


@njit(cache=True, error_model="numpy")
def _at_point(matrices, S, s, out):
    """Matrices (1 or K S, n, m) at point s of each copy, into out (n, m, K)."""
    n, m, K = out.shape
    step, first = (S, s) if matrices.shape[0] > 1 else (0, 0)
    for i in range(n):
        for j in range(m):
            for k in range(K):
                out[i, j, k] = matrices[first + step * k, i, j]


@njit(cache=True, error_model="numpy")
def _not_zero(A, some):
    """Which entries of A (n, nz, K) are not zero in all copies: a dead time hands most of its states on."""
    n, nz, K = A.shape
    for i in range(n):
        for c in range(nz):
            some[i, c] = False
            for k in range(K):
                some[i, c] |= A[i, c, k] != 0.0


@njit(cache=True, error_model="numpy")
def _impossible(Q, L, lost):
    """Which of Q (n, n, K) are no covariances (K,), as ``has_no_root`` has it; L (n, n, K) is overwritten.

    None where none has an entry beside its diagonal, or a negative one there.
    """
    n, _, K = Q.shape
    lost[:] = False
    doubt = False
    for i in range(n):
        for j in range(n):
            for k in range(K):
                doubt |= Q[i, j, k] < 0.0 if i == j else Q[i, j, k] != 0.0
    if not doubt:
        return
    for j in range(n):
        for k in range(K):
            L[j, j, k] = Q[j, j, k] * (1.0 + NEGATIVE)
        for q in range(j):
            for k in range(K):
                L[j, j, k] -= L[j, q, k] * L[j, q, k]
        for k in range(K):
            d = L[j, j, k]
            lost[k] |= d < 0.0 or (d == 0.0 and Q[j, j, k] > 0.0)
            L[j, j, k] = math.sqrt(d)
        for i in range(j):
            for k in range(K):
                apart = abs(Q[i, j, k] - Q[j, i, k])
                lost[k] |= apart > NEGATIVE * math.sqrt(Q[i, i, k] * Q[j, j, k])
        for i in range(j + 1, n):
            for k in range(K):
                L[i, j, k] = Q[i, j, k]
            for q in range(j):
                for k in range(K):
                    L[i, j, k] -= L[i, q, k] * L[j, q, k]
            for k in range(K):
                p = L[j, j, k]
                lost[k] |= p == 0.0 and L[i, j, k] != 0.0
                L[i, j, k] = L[i, j, k] / p if p > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def _products(A, Q, V, some, AV, each):
    """A V (n, nz, K) and the lower half of Q + A V A' (n, n, K)."""
    n, nz, K = A.shape
    for i in range(n):
        for c in range(nz):
            for k in range(K):
                AV[i, c, k] = 0.0
            for d in range(nz):
                if some[i, d]:
                    for k in range(K):
                        AV[i, c, k] += A[i, d, k] * V[d, c, k]
        for j in range(i + 1):
            for k in range(K):
                each[i, j, k] = Q[i, j, k]
            for c in range(nz):
                if some[j, c]:
                    for k in range(K):
                        each[i, j, k] += AV[i, c, k] * A[j, c, k]


@njit(cache=True, error_model="numpy")
def _values(f, z, A, some, lost, s, value):
    """f + A z (n, K) at point s, NaN where the noise is none."""
    n, nz, K = A.shape
    S = z.shape[0]
    for i in range(n):
        for k in range(K):
            value[i, k] = np.nan if lost[k] else f[k * S + s, i]
        for c in range(nz):
            if some[i, c]:
                for k in range(K):
                    value[i, k] += A[i, c, k] * z[s, c, k]


@njit(cache=True, error_model="numpy")
def _add_matrices(share, AV, each, cov, cross, first):
    """Points of this share of the weights have these matrices; of ``cov`` the lower half is filled."""
    n, nz, K = AV.shape
    na = cross.shape[1] - nz
    if first:
        cross[:, :na], cov[:] = 0.0, 0.0
        cross[:, na:] = 0.0
    for i in range(n):
        for c in range(nz):
            for k in range(K):
                cross[i, na + c, k] += share * AV[i, c, k]
        for j in range(i + 1):
            for k in range(K):
                cov[i, j, k] += share * each[i, j, k]


@njit(cache=True, error_model="numpy")
def gaussian_update(m, P, y_mean, S, cross, y):
    """Condition N(m, P) on the channels of y (ny,) that are there.

    m (K, nx), P (K, nx, nx), y_mean (K, ny), S (K, ny, ny), cross (K, ny, nx) -> the new m, P, and
    log N(y; y_mean, S) (K,).
    """
    K, nx = m.shape
    m_new, P_new, log_p = m.T.copy(), copies_last(P), np.empty(K)
    room = room_for_update(y.size, nx, K)
    update_into(m_new, P_new, y_mean.T.copy(), copies_last(S), copies_last(cross), y, log_p, room)
    return m_new.T.copy(), copies_first(P_new), log_p


@njit(cache=True, error_model="numpy")
def room_for_update(ny, nx, K):
    """What :func:`update_into` overwrites."""
    return (
        (np.empty((ny, ny, K)), np.empty((ny, ny, K))),
        np.empty((ny, nx, K)),
        (np.empty((ny, K)), np.empty((ny, K))),
    )


@njit(cache=True, error_model="numpy", inline="always")
def update_into(m, P, y_mean, S, cross, y, log_p, room):
    """:func:`gaussian_update` in place, copies last, with log_p (K,) filled."""
    nx, K = m.shape
    (S_there, root), W, (r, slack) = room
    n = 0
    for i in range(y.size):
        if np.isnan(y[i]):
            continue
        for k in range(K):
            r[n, k] = y[i] - y_mean[i, k]
            slack[n, k] = MEASURED * (abs(y[i]) + abs(y_mean[i, k]))
        q = 0
        for j in range(y.size):
            if not np.isnan(y[j]):
                for k in range(K):
                    S_there[n, q, k] = S[i, j, k]
                q += 1
        for c in range(nx):
            for k in range(K):
                W[n, c, k] = cross[i, c, k]
        n += 1
    L, v = root if n == y.size else np.empty((n, n, K)), r[:n]
    _roots_into(S_there, L)
    log_normal_each(L, v, slack, log_p)  # whitens v
    for p in range(n):
        for c in range(nx):
            for q in range(p):
                for k in range(K):
                    W[p, c, k] -= L[p, q, k] * W[q, c, k]
            for k in range(K):
                W[p, c, k] = W[p, c, k] / L[p, p, k] if L[p, p, k] > 0.0 else 0.0
    for p in range(n):
        for i in range(nx):
            for k in range(K):
                m[i, k] += W[p, i, k] * v[p, k]
            for j in range(i + 1):
                for k in range(K):
                    P[i, j, k] -= W[p, i, k] * W[p, j, k]
    for i in range(nx):
        for j in range(i):
            for k in range(K):
                P[j, i, k] = P[i, j, k]
