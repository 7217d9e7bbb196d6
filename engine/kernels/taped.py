"""Filters and free runs of a model whose functions are on tape, all time steps in one call."""

from __future__ import annotations

import numpy as np
from numba import njit

from engine.kernels.moment_steps import keep_reading, observe, predict, room_for, slopes
from engine.kernels.moments import gaussian_update, points_into, sigma_points, transform
from engine.kernels.strata import merge
from engine.kernels.tape import evaluate


@njit(cache=True, error_model="numpy")
def filter_taped(reading, moving, record, start, state, y, found, visited, moments, gains):
    """All rows of :func:`observe` and :func:`predict` through two tapes; False where a check fails.

    ``reading`` and ``moving`` are the arguments of :func:`evaluate` but the last four, with the results as
    matrices beside them; ``record`` the inputs u, u_step, times, steps and where x_1 begins again; ``state`` is
    the points' rows, what is beside them, m, P, copies last, filled in place, ``start`` m and P of x_1;
    ``found`` innovations, S and terms. ``visited``, each (T, S, na) or empty, are the points of the first copy,
    ``moments`` and ``gains`` as :func:`engine.kernels.moment_steps.keep_reading` has them, or empty.
    """
    tape_y, links_y, W_y, places_y, flat_y, (h, C, R) = reading
    tape_x, links_x, W_x, places_x, flat_x, (f, A, Q) = moving
    u, u_step, t, dt, begins = record
    rows, beside, m, P = state
    innovations, S, terms = found
    predicted, P_predicted, filtered, P_filtered = moments
    points, na = beside[0].shape[0], rows.shape[1]
    room = room_for(m.shape[1], na, m.shape[0], y.shape[1])
    keeps, begun = predicted.shape[0] > 0, False
    for k in range(len(y)):
        if visited[0].shape[0]:
            visited[0][k] = rows[:points]
        if not evaluate(tape_y, links_y, W_y, places_y, flat_y, rows, u[k], t[k], 0.0):
            return False
        if keeps:
            predicted[k], P_predicted[k] = m[:, 0], P[:, :, 0]
        known = k > 0 and places_y[1].size == 0, k > 0 and places_y[2].size == 0
        cross = observe(room, known, k, h, C, R, rows, beside, m, P, y, innovations, S, terms)
        if keeps:
            filtered[k], P_filtered[k] = m[:, 0], P[:, :, 0]
            keep_reading(k, cross[:, :, 0].copy(), S[k, 0], y[k], moments, gains)
        if visited[0].shape[0]:
            visited[1][k] = rows[:points]
        if k == len(y) - 1:
            break
        if begins[k + 1]:
            m[:], P[:] = start
            points_into(m, P, rows, beside, room[0])
            if keeps:
                gains[2][k] = 0.0
            continue
        if not evaluate(tape_x, links_x, W_x, places_x, flat_x, rows, u_step[k], t[k], dt[k]):
            return False
        known = begun and places_x[1].size == 0, begun and places_x[2].size == 0
        begun = True
        cross = predict(room, known, f, A, Q, rows, beside, m, P)
        if keeps:
            gains[2][k] = slopes(cross[:, :, 0].copy(), P_filtered[k])
    return True


@njit(cache=True, error_model="numpy")
def filter_strata_taped(reading, moving, record, start, strata, y, y_mean, S, log_w, terms):
    """The filter of :mod:`engine.filters.strata` through two tapes; False where a check fails.

    ``start`` are m (K J, n) and P of the other states' x_1; ``strata`` the logarithms of their shares (K, J),
    points (K J S, na) of all nonlinear states in which those of the random scales stand, and where the other
    states are among all. The rest as :func:`filter_taped` and :func:`engine.kernels.strata.filter_strata`.
    """
    tape_y, links_y, W_y, places_y, flat_y, (h, C, R) = reading
    tape_x, links_x, W_x, places_x, flat_x, (f, A, Q) = moving
    u, u_step, t, dt, begins = record
    log_shares, whole, others = strata
    m, P = start[0].copy(), start[1].copy()
    n = others.size
    na = n - A.shape[2]
    moved, A_n, Q_n = (
        np.empty((f.shape[0], n)),
        np.empty((A.shape[0], n, A.shape[2])),
        np.empty((Q.shape[0], n, n)),
    )
    for k in range(len(y)):
        if np.isnan(y[k]).all():
            log_w[k] = log_shares
            merge(m, P, log_w[k], terms[k])
            terms[k] = 0.0
        else:
            a, z, V, offsets = sigma_points(m, P, na)
            _into(whole, others, a)
            if not evaluate(tape_y, links_y, W_y, places_y, flat_y, whole, u[k], t[k], 0.0):
                return False
            y_mean[k], S[k], cross = transform(h, C, R, z, V, offsets, na)
            m[:], P[:], log_p = gaussian_update(m, P, y_mean[k], S[k], cross, y[k])
            log_w[k] = log_p.reshape(log_shares.shape) + log_shares
            merge(m, P, log_w[k], terms[k])
        if k == len(y) - 1:
            break
        if begins[k + 1]:
            m[:], P[:] = start[0], start[1]
            continue
        a, z, V, offsets = sigma_points(m, P, na)
        _into(whole, others, a)
        if not evaluate(tape_x, links_x, W_x, places_x, flat_x, whole, u_step[k], t[k], dt[k]):
            return False
        for i in range(n):
            moved[:, i] = f[:, others[i]]
            A_n[:, i] = A[:, others[i]]
            for j in range(n):
                Q_n[:, i, j] = Q[:, others[i], others[j]]
        m[:], P[:], _ = transform(moved, A_n, Q_n, z, V, offsets, na)
    return True


@njit(cache=True, error_model="numpy")
def _into(whole, others, a):
    """The points a (K, S, n) of some states into those of all, (K S, na)."""
    copies, points, n = a.shape
    for i in range(n):
        for k in range(copies):
            for s in range(points):
                whole[k * points + s, others[i]] = a[k, s, i]


@njit(cache=True, error_model="numpy")
def run_taped(moving, record, X):
    """Free runs X (T, K, nx) without noise, from their first rows on; False where a check fails.

    ``moving`` as :func:`filter_taped` has it; ``record`` u_step, times and steps. A single run that is lost
    ends there, the rest of it is NaN.
    """
    tape, links, W, places, flat, (f, A, _) = moving
    u_step, t, dt = record
    T, K, nx = X.shape
    nz = A.shape[2]
    na = nx - nz
    a = np.empty((K, na))
    for k in range(T - 1):
        a[:] = X[k, :, :na]
        if not evaluate(tape, links, W, places, flat, a, u_step[k], t[k], dt[k]):
            return False
        for m in range(K):
            A_m = A[m if A.shape[0] > 1 else 0]
            for i in range(nx):
                x = f[m, i]
                for c in range(nz):
                    x += A_m[i, c] * X[k, m, na + c]
                X[k + 1, m, i] = x
        if K == 1 and not np.isfinite(X[k + 1]).all():
            X[k + 2 :] = np.nan
            break
    return True
