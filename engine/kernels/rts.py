"""Atoms of the Rauch-Tung-Striebel form of the backward pass; report, section 5.4."""

from __future__ import annotations

import numpy as np
from numba import njit

from engine.kernels.backward import common_log_weights, particle_log_weights, reduce
from engine.kernels.gaussian import log_normalizer, solve_lower_transposed


@njit(cache=True, error_model="numpy")
def log_pairs(x, mu, L):
    """log N(x_j; mu_i, L_i L_i') for all pairs: x (N, n), mu (M, n), L (B, n, n) -> (N, M).

    Where L is common to all i, a constant that is too is left out.
    """
    N, n = x.shape
    M = mu.shape[0]
    out = np.empty((N, M))
    even = np.zeros(M)
    v = np.empty(n)
    if L.shape[0] == 1:
        m = np.empty((n, M))
        for i in range(M):
            reduce(L[0], mu[i], v)
            for k in range(n):
                m[k, i] = v[k]
        for j in range(N):
            reduce(L[0], x[j], v)
            common_log_weights(even, m, L[0], x[j], v, out[j])
        return out
    r = np.empty(n)
    constants = np.empty(M)
    for i in range(M):
        constants[i] = log_normalizer(L[i], n)
    for j in range(N):
        particle_log_weights(even, mu, L, constants, x[j], r, v, out[j])
    return out


@njit(cache=True, error_model="numpy")
def gains(L, AP):
    """T = P A' P_{t+1|t}^{-1} (B, nz, nz) from L L' = P_{t+1|t} and AP = A P; report, eq. (66c)."""
    B, n, nz = AP.shape
    out = np.empty((B, nz, n))
    W = np.empty(n)
    v = np.empty(n)
    for b in range(B):
        for c in range(nz):
            for i in range(n):
                s = AP[b, i, c]
                for k in range(i):
                    s -= L[b, i, k] * W[k]
                W[i] = s / L[b, i, i] if L[b, i, i] > 0.0 else 0.0
            solve_lower_transposed(L[b], W, v)
            for i in range(n):
                out[b, c, i] = v[i]
    return out
