"""Whitening by a Kalman filter whose slopes are known: the inverse of a huge covariance in one pass.

Readings y = (y_1, ..., y_T) of x_{t+1} = F_t x_t + w_t, y_t = H_t x_t + e_t have a covariance S (T ny, T ny)
that holds process noise, measurement noise and the uncertain first state. With d any change of the
readings, the filter's innovations of d, divided by their standard deviations, are L^{-1} d, S = L L'; so
d' S^{-1} d is a sum over time, and S is never formed.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from engine.kernels.gaussian import psd_cholesky_into


@njit(cache=True, error_model="numpy")
def whitened(F, H, Q, R, P1, d, seen):
    """L^{-1} d (B, T, ny, k) of k changes d (B, T, ny, k) in B experiments.

    F (B, T-1, nx, nx), H (B, T, ny, nx), Q (B, T-1, nx, nx), R (B, T, ny, ny), P1 (nx, nx); ``seen`` (T, ny)
    tells what is measured. A reading without noise, and one that is not measured, give zeros.
    """
    B, T, ny, k = d.shape
    nx = P1.shape[0]
    out = np.zeros((B, T, ny, k))
    S = np.empty((ny, ny))
    L = np.empty((ny, ny))
    C = np.empty((nx, ny))
    W = np.empty((nx, ny))
    for b in range(B):
        P = P1.copy()
        xi = np.zeros((nx, k))
        for t in range(T):
            Ht = np.ascontiguousarray(H[b, t])
            C[:] = P @ Ht.T
            S[:] = Ht @ C + R[b, t]
            for i in range(ny):
                if not seen[t, i]:
                    S[i, :] = 0.0
                    S[:, i] = 0.0
            psd_cholesky_into(S, L)
            r = d[b, t] - Ht @ xi
            v = out[b, t]
            for i in range(ny):
                if L[i, i] > 0.0:
                    for c in range(k):
                        s = r[i, c]
                        for j in range(i):
                            s -= L[i, j] * v[j, c]
                        v[i, c] = s / L[i, i]
                    for n in range(nx):
                        s = C[n, i]
                        for j in range(i):
                            s -= L[i, j] * W[n, j]
                        W[n, i] = s / L[i, i]
                else:
                    for n in range(nx):
                        W[n, i] = 0.0
            if t == T - 1:
                break
            Ft = np.ascontiguousarray(F[b, t])
            xi = Ft @ (xi + W @ v)
            P = P - W @ W.T
            P = Ft @ P @ Ft.T + Q[b, t]
            P = 0.5 * (P + P.T)
    return out


@njit(cache=True, error_model="numpy")
def spread(F, Q, P1):
    """Covariances (B, T, nx, nx) of the states of a free run, from the first state's and the process noise."""
    B, n, nx, _ = F.shape
    out = np.empty((B, n + 1, nx, nx))
    for b in range(B):
        P = P1.copy()
        out[b, 0] = P
        for t in range(n):
            Ft = np.ascontiguousarray(F[b, t])
            P = Ft @ P @ Ft.T + Q[b, t]
            out[b, t + 1] = P
    return out
