"""Atoms of the Rauch-Tung-Striebel form of the backward pass; report, section 5.4."""

from __future__ import annotations

import numpy as np
from numba import njit

from engine.kernels.backward import (
    backward_gain,
    common_log_weights,
    particle_log_weights,
    reduce,
    rule_out,
    smooth_covariance,
    without_noise,
)
from engine.kernels.gaussian import log_normalizer


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
        exact = without_noise(L[0])
        for i in range(M):
            reduce(L[0], mu[i], v)
            for k in range(n):
                m[k, i] = v[k]
        for j in range(N):
            reduce(L[0], x[j], v)
            common_log_weights(even, m, L[0], v, out[j])
            if exact:
                rule_out(m, L[0], x[j], v, out[j])
        return out
    r = np.empty(n)
    constants = np.empty(M)
    for i in range(M):
        constants[i] = log_normalizer(L[i], n)
    for j in range(N):
        particle_log_weights(even, mu, L, constants, x[j], r, v, out[j])
    return out


@njit(cache=True, error_model="numpy")
def gains(L, V):
    """T = P A' P_{t+1|t}^{-1} (B, nz, nz) from L L' = P_{t+1|t} and V L' = P A'; report, eq. (66c)."""
    out = np.empty_like(V)
    for b in range(V.shape[0]):
        backward_gain(L[b], V[b], out[b])
    return out


@njit(cache=True, error_model="numpy")
def smooth_covariances(Z, L, V, Z_plus, Z_next, D):
    """P_{t|T} and M_{t|T} (B, nz, nz), report, eqs. (68b)-(68c), and D (B, nz, nz) of z_t.

    D of z_{t+1}, likewise: P_{t+1|T} = Z_next D Z_next'; see :func:`engine.kernels.backward.smooth_covariance`.
    """
    B, nz = D.shape[0], D.shape[1]
    P, M, before = np.empty_like(D), np.empty_like(D), np.empty_like(D)
    work = np.empty((5, nz, nz))
    for b in range(B):
        smooth_covariance(
            Z[b], L[b], V[b], Z_plus[b], Z_next[b], D[b], 0, work, P[b], M[b], before[b]
        )
    return P, M, before
