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
    log_normalizer,
    lower_root_into,
    psd_cholesky_into,
    whiten,
)
from engine.kernels.resampling import normalize


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
    for i in range(M):
        b = i if A.shape[0] > 1 else 0
        for r in range(nx):
            s = f[i, r]
            for c in range(nz):
                s += A[b, r, c] * z[i, c]
            mu[i, r] = s
    B = max(A.shape[0], Q.shape[0], Z.shape[0])
    L = np.empty((B, nx, nx))
    V = np.empty((B, nz, nx))
    Z_plus = np.empty((B, nz, nz))
    Q_root = np.empty((nx, nx))
    joint = np.empty((nx + nz, nz + nx))
    root = np.empty((nx + nz, nx + nz))
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
                joint[r, c] = s
            for c in range(nx):
                joint[r, nz + c] = Q_root[r, c]
        for r in range(nz):
            for c in range(nz):
                joint[nx + r, c] = Zb[r, c]
            for c in range(nx):
                joint[nx + r, nz + c] = 0.0
        lower_root_into(joint, root)
        L[b] = root[:nx, :nx]
        V[b] = root[nx:, :nx]
        Z_plus[b] = root[nx:, nx:]
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
    common = L.shape[0] == 1
    z = np.empty((M, nz))
    Z = np.empty((1 if common else M, nz, nz))
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
            Z[i] = L[b, na:, na:]
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
    joint = np.empty((n + nz, n + nz))
    root = np.empty((n + nz, n + nz))
    r = np.empty(n)
    slack = np.empty(n)
    v = np.empty(n)
    c = 0.0
    for i in range(M):
        ci = i if C.shape[0] > 1 else 0
        if B > 1 or i == 0:
            Zi = Z[i if Z.shape[0] > 1 else 0]
            if i == 0 or R.shape[0] > 1:
                for p in range(n):
                    for q in range(n):
                        R_there[p, q] = R[i, channels[p], channels[q]]
                psd_cholesky_into(R_there, R_root)
            for p in range(n):
                for q in range(n):
                    joint[p, q] = R_root[p, q]
                for m in range(nz):
                    s = 0.0
                    for k in range(m, nz):
                        s += C[ci, channels[p], k] * Zi[k, m]
                    joint[p, n + m] = s
            for m in range(nz):
                for q in range(n):
                    joint[n + m, q] = 0.0
                for k in range(nz):
                    joint[n + m, n + k] = Zi[m, k]
            lower_root_into(joint, root)
            c = log_normalizer(root, n)
            Z_new[i] = root[n:, n:]
        for p in range(n):
            s = y[channels[p]] - h[i, channels[p]]
            size = abs(y[channels[p]]) + abs(h[i, channels[p]])
            for k in range(nz):
                term = C[ci, channels[p], k] * z[i, k]
                s -= term
                size += abs(term)
            r[p] = s
            slack[p] = MEASURED * size
        possible = whiten(root, r, slack, v)
        d = 0.0
        for p in range(n):
            d += v[p] * v[p]
        log_p[i] = c - 0.5 * d if possible else -np.inf
        for m in range(nz):
            s = z[i, m]
            for p in range(n):
                s += root[n + m, p] * v[p]
            z_new[i, m] = s
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

        N(alpha + Sigma^{a.} G' S^{-1} (y - y_hat), inflation (Sigma^a - Sigma^{a.} G' S^{-1} G Sigma^{.a})),

    its root from the joint root of (y, a) as in ``update``,
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
    CL = np.empty((n, na))  # C L_za
    noises = np.empty((n, n + nz))  # (R^{1/2}, C L_z): what the draw of a does not move
    D = np.empty((n, n))  # their lower root
    R_there = np.empty((n, n))
    R_root = np.empty((n, n))
    widths = np.empty(na)  # predicted standard deviations of a
    H = np.empty((n, na))
    joint = np.empty((n + na, n + 2 * na))
    root = np.empty((n + na, n + na))
    LV = np.empty((na, na))
    at = np.empty((1 + 2 * na, n))  # h + C zeta at the points of one particle
    r = np.empty(n)
    v = np.empty(n)
    m = np.empty(na)
    ra = np.empty(na)
    va = np.empty(na)
    none = np.zeros(n)  # where only the whitened residual is wanted
    slack = np.empty(na)
    wide = math.sqrt(inflation)
    prior_constant = 0.0
    varying = L.shape[0] > 1 or C.shape[0] > 1 or R.shape[0] > 1
    for i in range(M):
        j = ancestors[i]
        b = j if L.shape[0] > 1 else 0
        if i == 0 or varying:
            ci = i if C.shape[0] > 1 else 0
            if i == 0 or R.shape[0] > 1:
                for p in range(n):
                    for q in range(n):
                        R_there[p, q] = R[i, channels[p], channels[q]]
                psd_cholesky_into(R_there, R_root)
            for p in range(n):
                for q in range(n):
                    noises[p, q] = R_root[p, q]
                for k in range(nx):
                    s = 0.0
                    for q in range(max(k - na, 0), nz):
                        s += C[ci, channels[p], q] * L[b, na + q, k]
                    if k < na:
                        CL[p, k] = s
                    else:
                        noises[p, n + k - na] = s
            lower_root_into(noises, D)
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
        for k in range(na):
            for p in range(n):
                up, down = at[1 + 2 * k, p], at[2 + 2 * k, p]
                H[p, k] = (up - down) / (2.0 * widths[k]) if widths[k] > 0.0 else 0.0
                curved = 0.5 * (up + down) - at[0, p]
                r[p] -= curved
                joint[p, n + na + k] = math.sqrt(2.0) * curved
        for p in range(n):
            for q in range(n):
                joint[p, q] = D[p, q]
            for k in range(na):
                s = CL[p, k]
                for q in range(k, na):
                    s += H[p, q] * L[b, q, k]
                joint[p, n + k] = s
        for k in range(na):
            for q in range(n + 2 * na):
                joint[n + k, q] = L[b, k, q - n] if n <= q <= n + k else 0.0
        lower_root_into(joint, root)
        whiten(root, r, none, v)
        for k in range(na):
            s = mu[j, k]
            for p in range(n):
                s += root[n + k, p] * v[p]
            m[k] = s
            for q in range(na):
                LV[k, q] = wide * root[n + k, n + q]
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
