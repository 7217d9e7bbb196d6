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

from engine.kernels.gaussian import MEASURED, ROUNDING, log_normalizer, psd_cholesky_into, whiten
from engine.kernels.resampling import normalize


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
        b = i if A.shape[0] > 1 else 0
        for r in range(nx):
            s = f[i, r]
            for c in range(nz):
                s += A[b, r, c] * z[i, c]
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
    slack = np.empty(na)
    v = np.empty(na)
    c = log_normalizer(L[0], na)
    for i in range(M):
        j = ancestors[i]
        b = 0 if common else j
        for k in range(na):
            r[k] = a[i, k] - mu[j, k]
            slack[k] = ROUNDING * (abs(a[i, k]) + abs(mu[j, k]))
        possible = whiten(L[b], r, slack, v)
        if not common:
            c = log_normalizer(L[b], na)
        q = 0.0
        for k in range(na):
            q += v[k] * v[k]
        log_p[i] = c - 0.5 * q if possible else -np.inf
        for k in range(nz):
            s = mu[j, na + k]
            for m in range(na):
                s += L[b, na + k, m] * v[m]
            z[i, k] = s
        if not common or i == 0:
            for k in range(nz):
                for m in range(k + 1):
                    s = 0.0
                    for n in range(m + 1):
                        s += L[b, na + k, na + n] * L[b, na + m, na + n]
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
    slack = np.empty(n)
    v = np.empty(n)
    c = 0.0
    for i in range(M):
        ci = i if C.shape[0] > 1 else 0
        if B > 1 or i == 0:
            pi = i if P.shape[0] > 1 else 0
            ri = i if R.shape[0] > 1 else 0
            for p in range(n):
                for m in range(nz):
                    s = 0.0
                    for k in range(nz):
                        s += C[ci, channels[p], k] * P[pi, k, m]
                    V[p, m] = s
            for p in range(n):
                for q in range(p + 1):
                    s = R[ri, channels[p], channels[q]]
                    for k in range(nz):
                        s += V[p, k] * C[ci, channels[q], k]
                    S[p, q] = s
                    S[q, p] = s
            psd_cholesky_into(S, L)
            c = log_normalizer(L, n)
            for m in range(nz):
                for p in range(n):
                    s = V[p, m]
                    for k in range(p):
                        s -= L[p, k] * V[k, m]
                    V[p, m] = s / L[p, p] if L[p, p] > 0.0 else 0.0
            for m in range(nz):
                for k in range(m + 1):
                    s = P[pi, m, k]
                    for p in range(n):
                        s -= V[p, m] * V[p, k]
                    P_new[i, m, k] = s
                    P_new[i, k, m] = s
        for p in range(n):
            s = y[channels[p]] - h[i, channels[p]]
            size = abs(y[channels[p]]) + abs(h[i, channels[p]])
            for k in range(nz):
                term = C[ci, channels[p], k] * z[i, k]
                s -= term
                size += abs(term)
            r[p] = s
            slack[p] = MEASURED * size
        possible = whiten(L, r, slack, v)
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
        b = j if L.shape[0] > 1 else 0
        for k in range(na):
            s = mu[j, k]
            for m in range(k + 1):
                s += L[b, k, m] * noise[i, m]
            a[i, k] = s
    return a


@njit(cache=True, error_model="numpy")
def weigh(z, P, log_ratio, h, C, R, y, log_w):
    """Weighting and measurement update in one call; report, Algorithm 2, steps 3 and 4.

    ``log_ratio`` (M,) is log p(a) - log q(a) of the draws, ``log_w`` (M,) the weights before ->
    z_{t|t} (M, nz), P_{t|t} (B, nz, nz), normalized log weights (M,) and weights (M,), log of their sum,
    effective sample size. Where no weight is left they become equal, with a log sum of -inf.
    """
    z, P, log_y = update(z, P, h, C, R, y)
    M = log_w.shape[0]
    new = np.empty(M)
    for i in range(M):
        new[i] = log_w[i] + log_y[i] + log_ratio[i]
    w = np.empty(M)
    log_sum, ess = normalize(new, w)
    for i in range(M):
        new[i] = new[i] - log_sum if math.isfinite(log_sum) else -math.log(M)
    return z, P, new, w, log_sum, ess


@njit(cache=True, error_model="numpy")
def advance(mu, L, ancestors, a, log_q, blind, h, C, R, y, log_w):
    """``condition`` on the drawn a (M, na), then ``weigh``; ``blind``: a was drawn from the prediction."""
    z, P, log_p = condition(mu, L, ancestors, a)
    for i in range(log_p.shape[0]):
        log_p[i] = 0.0 if blind else log_p[i] - log_q[i]
    return weigh(z, P, log_p, h, C, R, y, log_w)


@njit(cache=True, error_model="numpy")
def spread_points(mu, L, ancestors, na):
    """Points ((1 + 2 na) M, na) at alpha and one predicted standard deviation to each side of it.

    Component by component, in the order (0, +1, -1, +2, -2, ...), all particles of each together.
    """
    M = ancestors.shape[0]
    points = np.empty(((1 + 2 * na) * M, na))
    for i in range(M):
        j = ancestors[i]
        b = j if L.shape[0] > 1 else 0
        for p in range(1 + 2 * na):
            for k in range(na):
                points[p * M + i, k] = mu[j, k]
        for k in range(na):
            width = 0.0
            for q in range(k + 1):
                width += L[b, k, q] * L[b, k, q]
            width = math.sqrt(width)
            points[(1 + 2 * k) * M + i, k] += width
            points[(2 + 2 * k) * M + i, k] -= width
    return points


@njit(cache=True, error_model="numpy")
def draw_adapted(mu, L, ancestors, h, C, R, y, noise, uniform, defensive, inflation):
    """A draw that looks at y: a second-order extended Kalman step per particle.

    h ((1 + 2 na) M, ny), C (B, ny, nz), R (B, ny, ny) are those at ``spread_points``, B = 1 or as h.
    Differences of h + C zeta give the slope H and the curvature of the measurement over the width
    of the prediction. With G = (H, C), S = G Sigma G' + R + curvature, the proposal is

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
    CL = np.empty((n, nx))  # C (L_za, L_z), and with D = C L_z L_z' C' + R, what does not involve H
    D = np.empty((n, n))
    widths = np.empty(na)  # predicted standard deviations of a
    H = np.empty((n, na))
    U = np.empty((n, na))  # G L = (U, C L_z)
    S = np.empty((n, n))
    LS = np.empty((n, n))
    W = np.empty((n, na))  # LS^{-1} G Sigma^{.a}
    V = np.empty((na, na))
    LV = np.empty((na, na))
    at = np.empty((1 + 2 * na, n))  # h + C zeta at the points of one particle
    r = np.empty(n)
    v = np.empty(n)
    m = np.empty(na)
    ra = np.empty(na)
    va = np.empty(na)
    none = np.zeros(n)  # where only the whitened residual is wanted
    slack = np.empty(na)
    prior_constant = 0.0
    varying = L.shape[0] > 1 or C.shape[0] > 1 or R.shape[0] > 1
    for i in range(M):
        j = ancestors[i]
        b = j if L.shape[0] > 1 else 0
        if i == 0 or varying:
            ci = i if C.shape[0] > 1 else 0
            ri = i if R.shape[0] > 1 else 0
            for p in range(n):
                for k in range(nx):
                    s = 0.0
                    for q in range(max(k - na, 0), nz):
                        s += C[ci, channels[p], q] * L[b, na + q, k]
                    CL[p, k] = s
                for q in range(p + 1):
                    s = R[ri, channels[p], channels[q]]
                    for k in range(na, nx):
                        s += CL[p, k] * CL[q, k]
                    D[p, q] = s
            for k in range(na):
                s = 0.0
                for q in range(k + 1):
                    s += L[b, k, q] * L[b, k, q]
                widths[k] = math.sqrt(s)
            prior_constant = log_normalizer(L[b], na)
        for point in range(1 + 2 * na):
            cp = point * M + i if C.shape[0] > 1 else 0
            for p in range(n):
                if point == 0 or C.shape[0] > 1:
                    s = 0.0
                    for k in range(nz):
                        s += C[cp, channels[p], k] * mu[j, na + k]
                    v[p] = s
                at[point, p] = h[point * M + i, channels[p]] + v[p]
        for p in range(n):
            r[p] = y[channels[p]] - at[0, p]
            for q in range(p + 1):
                S[p, q] = D[p, q]
        for k in range(na):
            for p in range(n):
                up, down = at[1 + 2 * k, p], at[2 + 2 * k, p]
                H[p, k] = (up - down) / (2.0 * widths[k]) if widths[k] > 0.0 else 0.0
                v[p] = 0.5 * (up + down) - at[0, p]
            for p in range(n):
                r[p] -= v[p]
                for q in range(p + 1):
                    S[p, q] += 2.0 * v[p] * v[q]
        for p in range(n):
            for k in range(na):
                s = CL[p, k]
                for q in range(k, na):
                    s += H[p, q] * L[b, q, k]
                U[p, k] = s
            for q in range(p + 1):
                s = S[p, q]
                for k in range(na):
                    s += U[p, k] * U[q, k]
                S[p, q] = s
                S[q, p] = s
        psd_cholesky_into(S, LS)
        whiten(LS, r, none, v)
        for k in range(na):
            for p in range(n):
                s = 0.0
                for q in range(k + 1):
                    s += U[p, q] * L[b, k, q]
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
                    s += L[b, k, w] * L[b, q, w]
                for p in range(n):
                    s -= W[p, k] * W[p, q]
                V[k, q] = inflation * s
                V[q, k] = inflation * s
        psd_cholesky_into(V, LV)
        from_prior = uniform[i] < defensive
        for k in range(na):
            s = mu[j, k] if from_prior else m[k]
            for q in range(k + 1):
                s += (L[b, k, q] if from_prior else LV[k, q]) * noise[i, q]
            a[i, k] = s
        for k in range(na):
            ra[k] = a[i, k] - m[k]
            slack[k] = ROUNDING * (abs(a[i, k]) + abs(m[k]))
        adapted = log_normalizer(LV, na) if whiten(LV, ra, slack, va) else -np.inf
        for k in range(na):
            adapted -= 0.5 * va[k] * va[k]
            ra[k] = a[i, k] - mu[j, k]
            slack[k] = ROUNDING * (abs(a[i, k]) + abs(mu[j, k]))
        prior = prior_constant if whiten(L[b], ra, slack, va) else -np.inf
        for k in range(na):
            prior -= 0.5 * va[k] * va[k]
        if adapted > prior:
            mixture = (1.0 - defensive) + defensive * math.exp(prior - adapted)
        else:
            mixture = (1.0 - defensive) * math.exp(adapted - prior) + defensive
        log_q[i] = max(adapted, prior) + math.log(mixture)
    return a, log_q
