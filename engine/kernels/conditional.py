"""Exact smoothing of z given whole trajectories of a: a Kalman filter and RTS pass for each.

Given a_{1:T}, model (1) is linear Gaussian in z, with a_{t+1} as a further measurement of z_t. The
same atoms as in the particle filter and the backward pass, with each trajectory its own ancestor.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from engine.kernels.backward import backward_gain, smooth_covariance
from engine.kernels.filtering import condition, predict, update
from engine.kernels.gaussian import psd_cholesky_many


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
    mu = np.empty((T - 1, N, nx))
    L = np.empty((T - 1, B, nx, nx))
    V = np.empty((T - 1, B, nz, nx))
    Z_plus = np.empty((T - 1, B, nz, nz))
    own = np.arange(N)
    z, Z = z1, psd_cholesky_many(P1)
    for t in range(T):
        z, Z, _ = update(z, Z, h[t], C[t], R[t], y[t])
        z_f[t] = z
        if t < T - 1:
            m, factor, cross, after = predict(f[t], A[t], Q[t], z, Z)
            mu[t] = m
            for b in range(B):
                k = b if factor.shape[0] > 1 else 0
                L[t, b], V[t, b], Z_plus[t, b] = factor[k], cross[k], after[k]
            z, Z, _ = condition(m, factor, own, a[t + 1])
    z_s = np.empty((T, N, nz))
    P_s = np.empty((T, B, nz, nz))
    M_s = np.empty((T - 1, B, nz, nz))
    z_s[T - 1] = z_f[T - 1]
    for b in range(B):
        last = Z[b if Z.shape[0] > 1 else 0]
        P_s[T - 1, b] = last @ last.T
    K = np.empty((nz, nx))
    for t in range(T - 2, -1, -1):
        for j in range(N):
            if j < B:
                backward_gain(L[t, j], V[t, j], K)
                smooth_covariance(K, Z_plus[t, j], P_s[t + 1, j], na, P_s[t, j], M_s[t, j])
            for k in range(nz):
                s = z_f[t, j, k]
                for c in range(na):
                    s += K[k, c] * (a[t + 1, j, c] - mu[t, j, c])
                for c in range(nz):
                    s += K[k, na + c] * (z_s[t + 1, j, c] - mu[t, j, na + c])
                z_s[t, j, k] = s
    return z_s, P_s, M_s
