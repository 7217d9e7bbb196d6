"""Exact smoothing of z given whole trajectories of a: a Kalman filter and RTS pass for each.

Given a_{1:T}, model (1) is linear Gaussian in z, with a_{t+1} as a further measurement of z_t. The
same atoms as in the particle filter and the backward pass, with each trajectory its own ancestor.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from engine.kernels.backward import backward_gain, smooth_covariance
from engine.kernels.filtering import condition, predict, update


@njit(cache=True, error_model="numpy")
def smooth_along(a, f, A, Q, h, C, R, z1, P1, y):
    """Moments of z given a_{1:T} and y_{1:T}, without Approximations 1 and 2.

    a (T, N, na), f (T-1, N, nx), A, Q (T-1, B, ., .), h (T, N, ny), C, R (T, B, ., .), z1 (N, nz),
    P1 (B, nz, nz), y (T, ny) -> z_{t|T} (T, N, nz), P_{t|T} (T, B', nz, nz), M_{t|T} (T-1, B', nz, nz).
    """
    T, N, na = a.shape
    nz = z1.shape[1]
    nx = na + nz
    # B' = 1 only where every matrix is common to all trajectories
    B = max(A.shape[1], Q.shape[1], C.shape[1], R.shape[1], P1.shape[0])
    z_f = np.empty((T, N, nz))
    P_f = np.empty((T, B, nz, nz))
    mu = np.empty((T - 1, N, nx))
    L = np.empty((T - 1, B, nx, nx))
    AP = np.empty((T - 1, B, nx, nz))
    own = np.arange(N)
    z, P = z1, P1
    for t in range(T):
        z, P, _ = update(z, P, h[t], C[t], R[t], y[t])
        z_f[t] = z
        for b in range(B):
            P_f[t, b] = P[b if P.shape[0] > 1 else 0]
        if t < T - 1:
            m, factor, ap = predict(f[t], A[t], Q[t], z, P)
            mu[t] = m
            for b in range(B):
                L[t, b] = factor[b if factor.shape[0] > 1 else 0]
                AP[t, b] = ap[b if ap.shape[0] > 1 else 0]
            z, P, _ = condition(m, factor, own, a[t + 1])
    z_s = np.empty((T, N, nz))
    P_s = np.empty((T, B, nz, nz))
    M_s = np.empty((T - 1, B, nz, nz))
    z_s[T - 1] = z_f[T - 1]
    P_s[T - 1] = P_f[T - 1]
    K = np.empty((nz, nx))
    P_plus = np.empty((nz, nz))
    for t in range(T - 2, -1, -1):
        for j in range(N):
            if j < B:
                backward_gain(P_f[t, j], L[t, j], AP[t, j], K, P_plus)
                smooth_covariance(K, P_plus, P_s[t + 1, j], na, P_s[t, j], M_s[t, j])
            for k in range(nz):
                s = z_f[t, j, k]
                for c in range(na):
                    s += K[k, c] * (a[t + 1, j, c] - mu[t, j, c])
                for c in range(nz):
                    s += K[k, na + c] * (z_s[t + 1, j, c] - mu[t, j, na + c])
                z_s[t, j, k] = s
    return z_s, P_s, M_s
