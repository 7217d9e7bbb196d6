"""Conditional Kalman steps over a set of particles; report, eqs. (22)-(27).

A matrix argument has shape (B, ., .): B = 1 when it is common to all particles, else B = M. What
follows from common matrices is common too and is computed once. Cholesky factors replace
covariances: with Sigma = L L' and x = (a, z), partitioned as

    L = [ L_a    0  ]      Sigma^a = L_a L_a',      (Sigma^az)' (Sigma^a)^{-1} = L_za L_a^{-1},
        [ L_za  L_z ]      P_{t|t-1} = L_z L_z',

so that conditioning z on a, report, eqs. (24b)-(24c), needs no further factorization.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from engine.kernels.gaussian import log_normalizer, psd_cholesky_into, whiten


@njit(cache=True, error_model="numpy")
def predict(f, A, Q, z, P):
    """Moments of x_{t+1} given a_{1:t}, y_{1:t}; report, eq. (22).

    f (M, nx), A (B, nx, nz), Q (B, nx, nx), z (M, nz), P (B, nz, nz) ->
    mu (M, nx) = (alpha, zeta), L (B, nx, nx) with L L' = Sigma, AP (B, nx, nz) = A P.
    """
    M, nx = f.shape
    nz = z.shape[1]
    mu = np.empty((M, nx))
    for i in range(M):
        Ai = A[i if A.shape[0] > 1 else 0]
        for r in range(nx):
            s = f[i, r]
            for c in range(nz):
                s += Ai[r, c] * z[i, c]
            mu[i, r] = s
    B = max(A.shape[0], Q.shape[0], P.shape[0])
    L = np.empty((B, nx, nx))
    AP = np.empty((B, nx, nz))
    Sigma = np.empty((nx, nx))
    for b in range(B):
        Ab = A[b if A.shape[0] > 1 else 0]
        Qb = Q[b if Q.shape[0] > 1 else 0]
        Pb = P[b if P.shape[0] > 1 else 0]
        for r in range(nx):
            for c in range(nz):
                s = 0.0
                for k in range(nz):
                    s += Ab[r, k] * Pb[k, c]
                AP[b, r, c] = s
        for r in range(nx):
            for c in range(r + 1):
                s = Qb[r, c]
                for k in range(nz):
                    s += AP[b, r, k] * Ab[c, k]
                Sigma[r, c] = s
                Sigma[c, r] = s
        psd_cholesky_into(Sigma, L[b])
    return mu, L, AP


@njit(cache=True, error_model="numpy")
def condition(mu, L, ancestors, a):
    """Condition the prediction on the drawn a_{t+1}; report, eqs. (23)-(24).

    mu (M, nx), L (B, nx, nx), ancestors (M,), a (M, na) ->
    z_{t+1|t} (M, nz), P_{t+1|t} (B, nz, nz), log p(a_{t+1} | a_{1:t}, y_{1:t}) (M,).
    """
    M, na = a.shape
    nx = mu.shape[1]
    nz = nx - na
    common = L.shape[0] == 1
    z = np.empty((M, nz))
    P = np.empty((1 if common else M, nz, nz))
    log_p = np.empty(M)
    r = np.empty(na)
    v = np.empty(na)
    c = log_normalizer(L[0, :na, :na])
    for i in range(M):
        j = ancestors[i]
        Li = L[0 if common else j]
        for k in range(na):
            r[k] = a[i, k] - mu[j, k]
        possible = whiten(Li[:na, :na], r, v)
        if not common:
            c = log_normalizer(Li[:na, :na])
        q = 0.0
        for k in range(na):
            q += v[k] * v[k]
        log_p[i] = c - 0.5 * q if possible else -np.inf
        for k in range(nz):
            s = mu[j, na + k]
            for m in range(na):
                s += Li[na + k, m] * v[m]
            z[i, k] = s
        if not common or i == 0:
            for k in range(nz):
                for m in range(k + 1):
                    s = 0.0
                    for n in range(m + 1):
                        s += Li[na + k, na + n] * Li[na + m, na + n]
                    P[i, k, m] = s
                    P[i, m, k] = s
    return z, P, log_p


@njit(cache=True, error_model="numpy")
def update(z, P, h, C, R, y):
    """Measurement update with the channels of y that are there; report, eqs. (26)-(27).

    z (M, nz) = z_{t|t-1}, P (B, nz, nz), h (M, ny), C (B, ny, nz), R (B, ny, ny), y (ny,) with
    NaN for a missing channel -> z_{t|t} (M, nz), P_{t|t} (B, nz, nz), log p(y_t | a_{1:t}) (M,).
    """
    M, nz = z.shape
    channels = np.flatnonzero(~np.isnan(y))
    n = channels.size
    B = max(P.shape[0], C.shape[0], R.shape[0])
    z_new = np.empty((M, nz))
    P_new = np.empty((B, nz, nz))
    log_p = np.zeros(M)
    if n == 0:
        z_new[:] = z
        for b in range(B):
            P_new[b] = P[b if P.shape[0] > 1 else 0]
        return z_new, P_new, log_p
    S = np.empty((n, n))
    L = np.empty((n, n))
    V = np.empty((n, nz))  # L^{-1} C P, so K = V' L^{-1} and P_{t|t} = P - V' V
    r = np.empty(n)
    v = np.empty(n)
    c = 0.0
    for i in range(M):
        Ci = C[i if C.shape[0] > 1 else 0]
        if B > 1 or i == 0:
            Pi = P[i if P.shape[0] > 1 else 0]
            Ri = R[i if R.shape[0] > 1 else 0]
            for p in range(n):
                for m in range(nz):
                    s = 0.0
                    for k in range(nz):
                        s += Ci[channels[p], k] * Pi[k, m]
                    V[p, m] = s
            for p in range(n):
                for q in range(p + 1):
                    s = Ri[channels[p], channels[q]]
                    for k in range(nz):
                        s += V[p, k] * Ci[channels[q], k]
                    S[p, q] = s
                    S[q, p] = s
            psd_cholesky_into(S, L)
            c = log_normalizer(L)
            for m in range(nz):
                for p in range(n):
                    s = V[p, m]
                    for k in range(p):
                        s -= L[p, k] * V[k, m]
                    V[p, m] = s / L[p, p] if L[p, p] > 0.0 else 0.0
            for m in range(nz):
                for k in range(m + 1):
                    s = Pi[m, k]
                    for p in range(n):
                        s -= V[p, m] * V[p, k]
                    P_new[i, m, k] = s
                    P_new[i, k, m] = s
        for p in range(n):
            s = y[channels[p]] - h[i, channels[p]]
            for k in range(nz):
                s -= Ci[channels[p], k] * z[i, k]
            r[p] = s
        possible = whiten(L, r, v)
        d = 0.0
        for p in range(n):
            d += v[p] * v[p]
        log_p[i] = c - 0.5 * d if possible else -np.inf
        for m in range(nz):
            s = z[i, m]
            for p in range(n):
                s += V[p, m] * v[p]
            z_new[i, m] = s
    return z_new, P_new, log_p


@njit(cache=True, error_model="numpy")
def draw_prior(mu, L, ancestors, noise):
    """a_{t+1} (M, na) from p(a_{t+1} | a_{1:t}, y_{1:t}), report, eq. (23); noise (M, na) ~ N(0, I)."""
    M, na = noise.shape
    a = np.empty((M, na))
    for i in range(M):
        j = ancestors[i]
        Lj = L[j if L.shape[0] > 1 else 0]
        for k in range(na):
            s = mu[j, k]
            for m in range(k + 1):
                s += Lj[k, m] * noise[i, m]
            a[i, k] = s
    return a


@njit(cache=True, error_model="numpy")
def draw_adapted(mu, L, ancestors, sigma_points, C, R, y, noise, uniform, defensive, inflation):
    """A draw that looks at y: a second-order extended Kalman step per particle.

    ``sigma_points`` (1 + 2 na, M, ny) holds h + C zeta at alpha and at alpha -+ one predicted
    standard deviation of each component of a, in the order (0, +1, -1, +2, -2, ...). Their
    differences give the slope H and the curvature of the measurement over the width of the
    prediction. With G = (H, C), S = G Sigma G' + R + curvature, the proposal is

        N(alpha + Sigma^{a.} G' S^{-1} (y - y_hat), inflation (Sigma^a - Sigma^{a.} G' S^{-1} G Sigma^{.a}))

    mixed with a share ``defensive`` of the prior, report, eq. (23), which bounds the weights.
    ``noise`` (M, na) ~ N(0, I) and ``uniform`` (M,) ~ U(0, 1) are the random numbers used.
    Returns a (M, na) and log q (M,).
    """
    M, na = noise.shape
    nx = mu.shape[1]
    nz = nx - na
    channels = np.flatnonzero(~np.isnan(y))
    n = channels.size
    a = np.empty((M, na))
    log_q = np.empty(M)
    G = np.empty((n, nx))
    U = np.empty((n, nx))  # G L
    S = np.empty((n, n))
    LS = np.empty((n, n))
    W = np.empty((n, na))  # LS^{-1} G Sigma^{.a}
    V = np.empty((na, na))
    LV = np.empty((na, na))
    r = np.empty(n)
    v = np.empty(n)
    m = np.empty(na)
    ra = np.empty(na)
    va = np.empty(na)
    for i in range(M):
        j = ancestors[i]
        Li = L[j if L.shape[0] > 1 else 0]
        Ci = C[i if C.shape[0] > 1 else 0]
        Ri = R[i if R.shape[0] > 1 else 0]
        for p in range(n):
            c = channels[p]
            r[p] = y[c] - sigma_points[0, i, c]
            for q in range(p + 1):
                S[p, q] = Ri[c, channels[q]]
            for k in range(nz):
                G[p, na + k] = Ci[c, k]
        for k in range(na):
            step = 0.0  # predicted standard deviation of a_k
            for q in range(k + 1):
                step += Li[k, q] * Li[k, q]
            step = math.sqrt(step)
            for p in range(n):
                up = sigma_points[1 + 2 * k, i, channels[p]]
                down = sigma_points[2 + 2 * k, i, channels[p]]
                G[p, k] = (up - down) / (2.0 * step) if step > 0.0 else 0.0
                v[p] = 0.5 * (up + down) - sigma_points[0, i, channels[p]]
            for p in range(n):
                r[p] -= v[p]
                for q in range(p + 1):
                    S[p, q] += 2.0 * v[p] * v[q]
        for p in range(n):
            for k in range(nx):
                s = 0.0
                for q in range(k, nx):
                    s += G[p, q] * Li[q, k]
                U[p, k] = s
        for p in range(n):
            for q in range(p + 1):
                s = S[p, q]
                for k in range(nx):
                    s += U[p, k] * U[q, k]
                S[p, q] = s
                S[q, p] = s
        psd_cholesky_into(S, LS)
        whiten(LS, r, v)
        for k in range(na):
            for p in range(n):
                s = 0.0
                for q in range(k + 1):
                    s += U[p, q] * Li[k, q]
                for q in range(p):
                    s -= LS[p, q] * W[q, k]
                W[p, k] = s / LS[p, p] if LS[p, p] > 0.0 else 0.0
        for k in range(na):
            s = mu[j, k]
            for p in range(n):
                s += W[p, k] * v[p]
            m[k] = s
            for q in range(k + 1):
                s = 0.0
                for w in range(q + 1):
                    s += Li[k, w] * Li[q, w]
                for p in range(n):
                    s -= W[p, k] * W[p, q]
                V[k, q] = inflation * s
                V[q, k] = inflation * s
        psd_cholesky_into(V, LV)
        from_prior = uniform[i] < defensive
        for k in range(na):
            s = mu[j, k] if from_prior else m[k]
            for q in range(k + 1):
                s += (Li[k, q] if from_prior else LV[k, q]) * noise[i, q]
            a[i, k] = s
        for k in range(na):
            ra[k] = a[i, k] - m[k]
        adapted = log_normalizer(LV) if whiten(LV, ra, va) else -np.inf
        for k in range(na):
            adapted -= 0.5 * va[k] * va[k]
            ra[k] = a[i, k] - mu[j, k]
        La = Li[:na, :na]
        prior = log_normalizer(La) if whiten(La, ra, va) else -np.inf
        for k in range(na):
            prior -= 0.5 * va[k] * va[k]
        top = max(adapted, prior)
        log_q[i] = top + math.log(
            (1.0 - defensive) * math.exp(adapted - top) + defensive * math.exp(prior - top)
        )
    return a, log_q
