"""The Gaussian filter of :mod:`engine.kernels.moments` where the model is known near its points.

One filter after the other runs through what its model returned for the whole record. Matrices that are
common to times, to points or to all filters come as they are and are gone through once; nothing is
allocated from one time to the next.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from engine.kernels.gaussian import (
    MEASURED,
    is_impossible,
    log_normalizer,
    psd_cholesky_into,
    whiten,
)
from engine.kernels.moments import spread_of


@njit(cache=True, error_model="numpy")
def filter_near(first, last, y, seen, moved, m, P, innovations, S, log_p):
    """Rows ``first`` to ``last`` of K filters whose model is known near given points, from m, P, in place.

    ``seen`` and ``moved`` describe y_t and x_{t+1}, each by points (B, K S, na), what the K models return
    there, f (B, K S, n), A (B', R, n, nz) and Q (B', R, n, n) with B' in (1, B) and R in (1, K, K S), as far as
    they differ, and the slopes of these by a for the first, (B, S, na, n), (B', R, na, n, nz) and
    (B', R, na, n, n) with R in (1, S), whose na is 0 where they are zero. The points are overwritten by those
    visited. Returns the largest distance between the two, by each component of a (na,).
    """
    y_points, h, C, R, dh, dC, dR = seen
    x_points, f, A, Q, df, dA, dQ = moved
    (K, nx), ny, na = m.shape, y.shape[1], y_points.shape[2]
    n_moved = x_points.shape[0]
    farthest = np.zeros(na)
    root, W, V = np.empty((na, na)), np.empty((na, nx - na)), np.empty((nx - na, nx - na))
    offsets, d = np.empty((na, nx)), np.empty(na)
    size, n_points = max(nx, ny), 2 * na + 1
    value, AV = np.empty((n_points, size)), np.empty((size, nx - na))
    A_near, Q_near = np.empty((size, nx - na)), np.empty((size, size))
    y_mean, y_cov, cross = np.empty(ny), np.empty((ny, ny)), np.empty((size, nx))
    y_root, gain = np.empty((ny, ny)), np.empty((ny, nx))
    residual, slack, white = np.empty(ny), np.empty(ny), np.empty(ny)
    x_mean, x_cov = np.empty(nx), np.empty((nx, nx))
    for k in range(K):
        for i in range(nx):
            x_mean[i] = m[k, i]
            for j in range(nx):
                x_cov[i, j] = P[k, i, j]
        for t in range(first, last):
            b = t - first
            _conditional(x_cov, na, root, W, V, offsets)
            _moments(
                b, k, K, y_points, h, C, R, dh, dC, dR, V, offsets, x_mean, d, value, AV, A_near,
                Q_near, farthest, y_mean, y_cov, cross,
            )  # fmt: skip
            for i in range(ny):
                innovations[t, k, i] = y[t, i] - y_mean[i]
                for j in range(ny):
                    S[t, k, i, j] = y_cov[i, j]
            log_p[t, k] = _update(
                t, y, y_mean, y_cov, cross, y_root, gain, residual, slack, white, x_mean, x_cov
            )
            if b < n_moved:
                _conditional(x_cov, na, root, W, V, offsets)
                _moments(
                    b, k, K, x_points, f, A, Q, df, dA, dQ, V, offsets, x_mean, d, value, AV, A_near,
                    Q_near, farthest, x_mean, x_cov, cross,
                )  # fmt: skip
        for i in range(nx):
            m[k, i] = x_mean[i]
            for j in range(nx):
                P[k, i, j] = x_cov[i, j]
    return farthest


@njit(cache=True, error_model="numpy")
def _conditional(P, na, root, W, V, offsets):
    """Var(z | a) V and the ``offsets`` of :func:`engine.kernels.moments.sigma_points` for one filter."""
    nz = V.shape[0]
    spread, _ = spread_of(na)
    psd_cholesky_into(P, root)
    for i in range(na):
        for c in range(nz):
            v = P[i, na + c]
            for j in range(i):
                v -= root[i, j] * W[j, c]
            W[i, c] = v / root[i, i] if root[i, i] > 0.0 else 0.0
        for j in range(na):
            offsets[i, j] = spread * root[j, i]
        for c in range(nz):
            offsets[i, na + c] = spread * W[i, c]
    for r in range(nz):
        for c in range(nz):
            v = P[na + r, na + c]
            for i in range(na):
                v -= W[i, r] * W[i, c]
            V[r, c] = v


@njit(cache=True, error_model="numpy")
def _moments(
    b, k, K, points, f, A, Q, df, dA, dQ, V, offsets, m, d, value, AV, A_near, Q_near, farthest,
    mean, cov, cross,
):  # fmt: skip
    """Row b of filter k: mean (n,), cov (n, n) and cross (n, nx) of what it leads to from mean m (nx,).

    The rest is overwritten. ``mean`` may be m itself.
    """
    na, nx, n = d.size, m.size, f.shape[2]
    nz, n_points = nx - na, 2 * na + 1
    _, outer = spread_of(na)
    first = k * n_points
    A_b, Q_b = b if A.shape[0] > 1 else 0, b if Q.shape[0] > 1 else 0
    A_each, Q_each = A.shape[1] == K * n_points, Q.shape[1] == K * n_points
    A_row = 0 if A.shape[1] == 1 else (first if A_each else k)
    Q_row = 0 if Q.shape[1] == 1 else (first if Q_each else k)
    # whether the points have matrices of their own
    A_own = n_points > 1 and (A_each or dA.shape[2] > 0)
    Q_own = n_points > 1 and (Q_each or dQ.shape[2] > 0)
    for r in range(n):
        for c in range(n):
            cov[r, c] = 0.0
        for c in range(nx):
            cross[r, c] = 0.0
    for s in range(n_points):
        i = max(s - 1, 0) // 2
        sign = 0.0 if s == 0 else (1.0 if s % 2 == 1 else -1.0)
        weight = outer if s > 0 else 1.0 - 2.0 * na * outer
        for j in range(na):
            here = m[j] + (sign * offsets[i, j] if s > 0 else 0.0)
            d[j] = here - points[b, first + s, j]
            points[b, first + s, j] = here
            farthest[j] = max(farthest[j], abs(d[j]))
        for r in range(n):
            v = f[b, first + s, r]
            for j in range(na):
                v += d[j] * df[b, s, j, r]
            value[s, r] = v
        if s == 0 or A_own:
            _near(A, A_b, A_row + (s if A_each else 0), dA, s, d, n, A_near)
        for c in range(nz):
            z = m[na + c] + (sign * offsets[i, na + c] if s > 0 else 0.0)
            for r in range(n):
                value[s, r] += A_near[r, c] * z
        if s == 0 or A_own:
            share = weight if A_own else 1.0
            for r in range(n):
                for c in range(nz):
                    v = 0.0
                    for e in range(nz):
                        v += A_near[r, e] * V[e, c]
                    AV[r, c] = v
                    cross[r, na + c] += share * v
                for q in range(r + 1):
                    v = 0.0
                    for c in range(nz):
                        v += AV[r, c] * A_near[q, c]
                    cov[r, q] += share * v
        if s == 0 or Q_own:
            _near(Q, Q_b, Q_row + (s if Q_each else 0), dQ, s, d, n, Q_near)
            share = weight if Q_own else 1.0
            if is_impossible(Q_near[:n, :n]):
                value[s] = np.nan  # this theta is lost
            for r in range(n):
                for q in range(r + 1):
                    cov[r, q] += share * Q_near[r, q]
    for r in range(n):
        v = 0.0
        for s in range(n_points):
            v += (outer if s > 0 else 1.0 - 2.0 * na * outer) * value[s, r]
        mean[r] = v
    for s in range(n_points):
        weight = outer if s > 0 else 1.0 - 2.0 * na * outer
        for r in range(n):
            v = weight * (value[s, r] - mean[r])
            for c in range(r + 1):
                cov[r, c] += v * (value[s, c] - mean[c])
    for r in range(n):
        for c in range(r):
            cov[c, r] = cov[r, c]
        for i in range(na):
            slope = outer * (value[1 + 2 * i, r] - value[2 + 2 * i, r])
            for c in range(nx):
                cross[r, c] += slope * offsets[i, c]


@njit(cache=True, error_model="numpy")
def _near(matrix, b, row, slopes, s, d, n, out):
    """The matrix (n, .) at a distance d (na,) from the point at which it is known."""
    own_b = b if slopes.shape[0] > 1 else 0
    own_s = s if slopes.shape[1] > 1 else 0
    for r in range(n):
        for c in range(matrix.shape[3]):
            v = matrix[b, row, r, c]
            for j in range(slopes.shape[2]):
                v += d[j] * slopes[own_b, own_s, j, r, c]
            out[r, c] = v


@njit(cache=True, error_model="numpy")
def _update(t, y, y_mean, y_cov, cross, root, gain, residual, slack, white, m, P):
    """:func:`engine.kernels.moments.gaussian_update` of one filter, in place; returns log N(y_t; ., .).

    A missing reading has a residual of zero, without variance. The arrays from ``root`` to ``white`` are
    overwritten, and so are rows and columns of y_cov for what is missing.
    """
    nx, ny = m.size, y_mean.size
    for p in range(ny):
        residual[p] = y[t, p] - y_mean[p]
        slack[p] = MEASURED * (abs(y[t, p]) + abs(y_mean[p]))
        if np.isnan(y[t, p]):
            residual[p], slack[p] = 0.0, 0.0
            for q in range(ny):
                y_cov[p, q], y_cov[q, p] = 0.0, 0.0
    psd_cholesky_into(y_cov, root)
    log_p = log_normalizer(root, ny) if whiten(root, residual, slack, white) else -np.inf
    for p in range(ny):
        log_p -= 0.5 * white[p] * white[p]
        for c in range(nx):
            v = cross[p, c]
            for q in range(p):
                v -= root[p, q] * gain[q, c]
            gain[p, c] = v / root[p, p] if root[p, p] > 0.0 else 0.0
    for p in range(ny):
        for i in range(nx):
            m[i] += gain[p, i] * white[p]
            for j in range(i + 1):
                P[i, j] -= gain[p, i] * gain[p, j]
    for i in range(nx):
        for j in range(i):
            P[j, i] = P[i, j]
    return log_p
