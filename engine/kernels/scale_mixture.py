"""The density of an innovation for several sizes of the measurement noise."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from engine.kernels.gaussian import MEASURED, log_normalizer, psd_cholesky_into, whiten


@njit(cache=True, error_model="numpy")
def log_innovations(mu, L, ancestors, h, C, R, roots, y):
    """log N(y - y_hat; 0, G Sigma G' + curvature + D_k R D_k), D_k = diag(roots_k) -> (M, K).

    h ((1 + 2 na) M, ny), C (B, ny, nz), R (B, ny, ny) at ``spread_points``, B = 1 or as h; roots (K, ny);
    y (ny,) with NaN for a missing channel. G as in ``engine.kernels.filtering.draw_adapted``.
    """
    M = ancestors.shape[0]
    nx = mu.shape[1]
    nz = C.shape[2]
    na = nx - nz
    channels = np.flatnonzero(~np.isnan(y))
    n = channels.size
    K = roots.shape[0]
    out = np.empty((M, K))
    value = np.empty((1 + 2 * na, n))
    G = np.empty((n, nx))
    U = np.empty((n, nx))
    S = np.empty((n, n))
    S_k = np.empty((n, n))
    LS = np.empty((n, n))
    r = np.empty(n)
    slack = np.empty(n)
    v = np.empty(n)
    for i in range(M):
        j = ancestors[i]
        b = j if L.shape[0] > 1 else 0
        for p in range(1 + 2 * na):
            row = p * M + i
            c_row = row if C.shape[0] > 1 else 0
            for q in range(n):
                s = h[row, channels[q]]
                for k in range(nz):
                    s += C[c_row, channels[q], k] * mu[j, na + k]
                value[p, q] = s
        for q in range(n):
            r[q] = y[channels[q]] - value[0, q]
            slack[q] = MEASURED * (abs(y[channels[q]]) + abs(value[0, q]))
            for k in range(nz):
                G[q, na + k] = C[i if C.shape[0] > 1 else 0, channels[q], k]
            for p in range(n):
                S[q, p] = 0.0
        for k in range(na):
            width = 0.0  # predicted standard deviation of a_k
            for q in range(k + 1):
                width += L[b, k, q] * L[b, k, q]
            width = math.sqrt(width)
            for q in range(n):
                up, down = value[1 + 2 * k, q], value[2 + 2 * k, q]
                G[q, k] = (up - down) / (2.0 * width) if width > 0.0 else 0.0
                v[q] = 0.5 * (up + down) - value[0, q]
            for q in range(n):
                r[q] -= v[q]
                for p in range(n):
                    S[q, p] += 2.0 * v[q] * v[p]
        for q in range(n):
            for k in range(nx):
                s = 0.0
                for p in range(k, nx):
                    s += G[q, p] * L[b, p, k]
                U[q, k] = s
        for q in range(n):
            for p in range(n):
                for k in range(nx):
                    S[q, p] += U[q, k] * U[p, k]
        r_row = i if R.shape[0] > 1 else 0
        for k in range(K):
            for q in range(n):
                for p in range(n):
                    scale = roots[k, channels[q]] * roots[k, channels[p]]
                    S_k[q, p] = S[q, p] + scale * R[r_row, channels[q], channels[p]]
            psd_cholesky_into(S_k, LS)
            possible = whiten(LS, r, slack, v)
            s = log_normalizer(LS, n)
            for q in range(n):
                s -= 0.5 * v[q] * v[q]
            out[i, k] = s if possible else -1e300
    return out
