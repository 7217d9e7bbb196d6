"""Conditional Kalman steps over a set of particles; report, eqs. (22)-(27).

A matrix argument has shape (B, ., .): B = 1 when it is common to all particles, else B = M. What
follows from common matrices is common too and is computed once. Roots replace covariances, and none
is ever squared and subtracted from another: P = Z Z', and with Sigma = L L' and x = (a, z), partitioned as

    L = [ L_a    0  ]      Sigma^a = L_a L_a',      (Sigma^az)' (Sigma^a)^{-1} = L_za L_a^{-1},
        [ L_za  L_z ]      P_{t|t-1} = L_z L_z',

conditioning z on a, report, eqs. (24b)-(24c), needs no further factorization.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from engine.kernels.gaussian import (
    MEASURED,
    ROUNDING,
    log_normal_columns,
    log_normal_each,
    lower_roots_into,
    psd_cholesky_into,
)
from engine.kernels.resampling import normalize


@njit(cache=True, error_model="numpy")
def side_by_side(z):
    """z (M, n) as (n, M): the compiler works on several particles at once where they are neighbours."""
    M, n = z.shape
    out = np.empty((n, M))
    for k in range(n):
        for i in range(M):
            out[k, i] = z[i, k]
    return out


@njit(cache=True, error_model="numpy")
def predict(f, A, Q, z, Z):
    """Moments of x_{t+1} given a_{1:t}, y_{1:t}, report, eq. (22), and those of z_t given x_{t+1}.

    f (M, nx), A (B, nx, nz), Q (B, nx, nx), z (M, nz), Z (B, nz, nz) ->
    mu (M, nx) = (alpha, zeta), and of the joint root of (x_{t+1}, z_t)

        [ A Z  Q^{1/2} ]   turned into   [ L   0  ]      L L' = Sigma,   V L' = P A',
        [  Z      0    ]                 [ V  Z_+ ]      Z_+ Z_+' = Cov(z_t | x_{t+1}),

    L (B, nx, nx), V (B, nz, nx), Z_+ (B, nz, nz).
    """
    M, nx = f.shape
    nz = z.shape[1]
    mu = np.empty((M, nx))
    beside = side_by_side(z)
    mean = np.empty(M)
    each = 1 if A.shape[0] > 1 else 0  # what a step from row to row is among the A
    for r in range(nx):
        for i in range(M):
            mean[i] = f[i, r]
        for c in range(nz):
            for i in range(M):
                mean[i] += A[each * i, r, c] * beside[c, i]
        for i in range(M):
            mu[i, r] = mean[i]
    B = max(A.shape[0], Q.shape[0], Z.shape[0])
    joint = np.zeros((nx + nz, nz + nx, B))
    root = np.empty((nx + nz, nx + nz, B))
    Q_root = np.empty((nx, nx))
    for b in range(B):
        Ab = A[b if A.shape[0] > 1 else 0]
        Zb = Z[b if Z.shape[0] > 1 else 0]
        if b == 0 or Q.shape[0] > 1:
            psd_cholesky_into(Q[b], Q_root)
        for r in range(nx):
            for c in range(nz):
                s = 0.0
                for k in range(c, nz):
                    s += Ab[r, k] * Zb[k, c]
                joint[r, c, b] = s
            for c in range(r + 1):
                joint[r, nz + c, b] = Q_root[r, c]
        for r in range(nz):
            for c in range(r + 1):
                joint[nx + r, c, b] = Zb[r, c]
    lower_roots_into(joint, root)
    L = np.empty((B, nx, nx))
    V = np.empty((B, nz, nx))
    Z_plus = np.empty((B, nz, nz))
    for b in range(B):
        L[b] = root[:nx, :nx, b]
        V[b] = root[nx:, :nx, b]
        Z_plus[b] = root[nx:, nx:, b]
    return mu, L, V, Z_plus


@njit(cache=True, error_model="numpy")
def condition(mu, L, ancestors, a):
    """Condition the prediction on the drawn a_{t+1}; report, eqs. (23)-(24).

    mu (M, nx), L (B, nx, nx), ancestors (M,), a (M, na) ->
    z_{t+1|t} (M, nz), the root Z of P_{t+1|t} (B, nz, nz), log p(a_{t+1} | a_{1:t}, y_{1:t}) (M,).
    """
    M, na = a.shape
    nx = mu.shape[1]
    nz = nx - na
    B = 1 if L.shape[0] == 1 else M
    z = np.empty((M, nz))
    Z = np.empty((B, nz, nz))
    log_p = np.empty(M)
    r = np.empty((na, M))
    slack = np.empty((na, M))
    for k in range(na):
        for i in range(M):
            alpha = mu[ancestors[i], k]
            r[k, i] = a[i, k] - alpha
            slack[k, i] = ROUNDING * (abs(a[i, k]) + abs(alpha))
    if B == 1:
        log_normal_columns(L[0], r, slack, log_p)
    else:
        L_a = np.empty((na, na, M))
        for k in range(na):
            for q in range(k + 1):
                for i in range(M):
                    L_a[k, q, i] = L[ancestors[i], k, q]
        log_normal_each(L_a, r, slack, log_p)
    each = 0 if B == 1 else 1
    mean = np.empty(M)
    for k in range(nz):
        for i in range(M):
            mean[i] = mu[ancestors[i], na + k]
        for m in range(na):
            for i in range(M):
                mean[i] += L[each * ancestors[i], na + k, m] * r[m, i]
        for i in range(M):
            z[i, k] = mean[i]
    for b in range(B):
        Z[b] = L[each * ancestors[b], na:, na:]
    return z, Z, log_p


@njit(cache=True, error_model="numpy")
def update(z, Z, h, C, R, y):
    """Measurement update with the channels of y that are there; report, eqs. (26)-(27).

    z (M, nz) = z_{t|t-1}, Z (B, nz, nz) the root of P_{t|t-1}, h (M, ny), C (B, ny, nz), R (B, ny, ny),
    y (ny,) with NaN for a missing channel -> z_{t|t} (M, nz), the root of P_{t|t} (B, nz, nz),
    log p(y_t | a_{1:t}) (M,). Of the joint root of (y_t, z_t), K the gain of eq. (26),

        [ R^{1/2}  C Z ]   turned into   [ S^{1/2}       0    ]
        [    0      Z  ]                 [ K S^{1/2}  Z_{t|t} ]
    """
    M, nz = z.shape
    channels = np.flatnonzero(~np.isnan(y))
    n = channels.size
    B = max(Z.shape[0], C.shape[0], R.shape[0])
    z_new = np.empty((M, nz))
    Z_new = np.empty((B, nz, nz))
    log_p = np.zeros(M)
    if n == 0:
        z_new[:] = z
        for b in range(B):
            Z_new[b] = Z[b if Z.shape[0] > 1 else 0]
        return z_new, Z_new, log_p
    R_there = np.empty((n, n))
    R_root = np.empty((n, n))
    joint = np.zeros((n + nz, n + nz, B))
    root = np.empty((n + nz, n + nz, B))
    for b in range(B):
        Cb = C[b if C.shape[0] > 1 else 0]
        Zb = Z[b if Z.shape[0] > 1 else 0]
        if b == 0 or R.shape[0] > 1:
            for p in range(n):
                for q in range(n):
                    R_there[p, q] = R[b, channels[p], channels[q]]
            psd_cholesky_into(R_there, R_root)
        for p in range(n):
            for q in range(p + 1):
                joint[p, q, b] = R_root[p, q]
            for m in range(nz):
                s = 0.0
                for k in range(m, nz):
                    s += Cb[channels[p], k] * Zb[k, m]
                joint[p, n + m, b] = s
        for m in range(nz):
            for k in range(m + 1):
                joint[n + m, n + k, b] = Zb[m, k]
    lower_roots_into(joint, root)
    for b in range(B):
        Z_new[b] = root[n:, n:, b]
    r = np.empty((n, M))
    slack = np.empty((n, M))
    beside = side_by_side(z)
    each = 1 if C.shape[0] > 1 else 0  # what a step from row to row is among the C
    for p in range(n):
        there = channels[p]
        for i in range(M):
            r[p, i] = y[there] - h[i, there]
            slack[p, i] = abs(y[there]) + abs(h[i, there])
        for k in range(nz):
            for i in range(M):
                term = C[each * i, there, k] * beside[k, i]
                r[p, i] -= term
                slack[p, i] += abs(term)
        for i in range(M):
            slack[p, i] *= MEASURED
    if B == 1:
        log_normal_columns(root[:, :, 0], r, slack, log_p)
    else:
        log_normal_each(root, r, slack, log_p)
    each = 1 if B > 1 else 0
    for m in range(nz):
        for p in range(n):
            for i in range(M):
                beside[m, i] += root[n + m, p, each * i] * r[p, i]
        for i in range(M):
            z_new[i, m] = beside[m, i]
    return z_new, Z_new, log_p


@njit(cache=True, error_model="numpy")
def draw_prior(mu, L, ancestors, noise):
    """a_{t+1} (M, na) from p(a_{t+1} | a_{1:t}, y_{1:t}), report, eq. (23); noise (M, na) ~ N(0, I)."""
    M, na = noise.shape
    a = np.empty((M, na))
    for i in range(M):
        j = ancestors[i]
        b = j if L.shape[0] > 1 else 0
        for k in range(na):
            s = mu[j, k]
            for m in range(k + 1):
                s += L[b, k, m] * noise[i, m]
            a[i, k] = s
    return a


@njit(cache=True, error_model="numpy")
def weigh(z, Z, log_ratio, h, C, R, y, log_w):
    """Weighting and measurement update in one call; report, Algorithm 2, steps 3 and 4.

    ``log_ratio`` (M,) is log p(a) - log q(a) of the draws, ``log_w`` (M,) the weights before ->
    z_{t|t} (M, nz), the root of P_{t|t} (B, nz, nz), normalized log weights (M,) and weights (M,), log of
    their sum, effective sample size. Where no weight is left they become equal, with a log sum of -inf.
    """
    z, Z, log_y = update(z, Z, h, C, R, y)
    M = log_w.shape[0]
    new = np.empty(M)
    for i in range(M):
        new[i] = log_w[i] + log_y[i] + log_ratio[i]
    w = np.empty(M)
    log_sum, ess = normalize(new, w)
    for i in range(M):
        new[i] = new[i] - log_sum if math.isfinite(log_sum) else -math.log(M)
    return z, Z, new, w, log_sum, ess


@njit(cache=True, error_model="numpy")
def advance(mu, L, ancestors, a, log_q, blind, h, C, R, y, log_w):
    """``condition`` on the drawn a (M, na), then ``weigh``; ``blind``: a was drawn from the prediction."""
    z, Z, log_p = condition(mu, L, ancestors, a)
    for i in range(log_p.shape[0]):
        log_p[i] = 0.0 if blind else log_p[i] - log_q[i]
    return weigh(z, Z, log_p, h, C, R, y, log_w)
