"""Steps of the filter of :mod:`engine.kernels.moments`, its copies side by side, and what is kept of them."""

from __future__ import annotations

import numpy as np
from numba import njit

from engine.kernels.gaussian import psd_cholesky_into, solve_lower_transposed, whiten
from engine.kernels.moments import (
    points_into,
    room_for_points,
    room_for_transform,
    room_for_update,
    transform_into,
    update_into,
)


@njit(cache=True, error_model="numpy")
def room_for(K, na, nx, ny):
    """What :func:`observe` and :func:`predict` write into and leave: found once for all time steps.

    That of points, of both transforms and of the update; mean, covariance of y_t and Cov(y_t, x_t), and
    Cov(x_{t+1}, x_t).
    """
    nz, S = nx - na, 2 * na + 1
    return (
        room_for_points(na, nz, K),
        room_for_transform(ny, nz, S, K),
        room_for_transform(nx, nz, S, K),
        room_for_update(ny, nx, K),
        (np.empty((ny, K)), np.empty((ny, ny, K)), np.empty((ny, nx, K)), np.empty((nx, nx, K))),
    )


@njit(cache=True, error_model="numpy", inline="always")
def observe(room, known, t, h, C, R, rows, beside, m, P, y, innovations, S, log_p):
    """Row t of y: :func:`transform`, :func:`gaussian_update`, and the new :func:`sigma_points`, in place.

    h, C, R at the points ``rows``, ... of m, P, which are updated; rows t of ``innovations`` (T, K, ny), ``S``
    (T, K, ny, ny) and ``log_p`` (T, K) are filled. ``known`` as :func:`transform_into` has it. Returns
    Cov(y_t, x_t) (ny, nx, K).
    """
    y_mean, S_t, cross, _ = room[4]
    transform_into(h, C, R, beside, y_mean, S_t, cross, room[1], known)
    update_into(m, P, y_mean, S_t, cross, y[t], log_p[t], room[3])
    for i in range(y.shape[1]):
        for k in range(m.shape[1]):
            innovations[t, k, i] = y[t, i] - y_mean[i, k]
            for j in range(y.shape[1]):
                S[t, k, i, j] = S_t[i, j, k]
    points_into(m, P, rows, beside, room[0])
    return cross


@njit(cache=True, error_model="numpy", inline="always")
def predict(room, known, f, A, Q, rows, beside, m, P):
    """One step ahead: :func:`transform` and the new :func:`sigma_points`, in place; Cov(x_{t+1}, x_t)."""
    cross = room[4][3]
    transform_into(f, A, Q, beside, m, P, cross, room[2], known)
    points_into(m, P, rows, beside, room[0])
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
