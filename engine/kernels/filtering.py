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
    whiten_each,
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
    for i in range(M):
        j = ancestors[i]
        b = 0 if B == 1 else j
        for k in range(nz):
            s = mu[j, na + k]
            for m in range(na):
                s += L[b, na + k, m] * r[m, i]
            z[i, k] = s
        if i < B:
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
    each = 1 if C.shape[0] > 1 else 0  # what a step from row to row is among the C
    for p in range(n):
        there = channels[p]
        for i in range(M):
            s = y[there] - h[i, there]
            size = abs(y[there]) + abs(h[i, there])
            for k in range(nz):
                term = C[each * i, there, k] * z[i, k]
                s -= term
                size += abs(term)
            r[p, i] = s
            slack[p, i] = MEASURED * size
    if B == 1:
        log_normal_columns(root[:, :, 0], r, slack, log_p)
    else:
        log_normal_each(root, r, slack, log_p)
    each = 1 if B > 1 else 0
    for i in range(M):
        for m in range(nz):
            s = z[i, m]
            for p in range(n):
                s += root[n + m, p, each * i] * r[p, i]
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
    channels = np.flatnonzero(~np.isnan(y))
    n = channels.size
    joint = np.zeros((n + na, n + 2 * na, M))
    prior = np.empty((na, na, M))  # L_a of each particle
    _joint_at_zeta(mu, L, ancestors, C, R, channels, joint, prior)
    r = np.empty((n, M))
    _add_slopes(mu, L, ancestors, h, C, y, channels, joint, prior, r)
    root = np.empty((n + na, n + na, M))
    lower_roots_into(joint, root)

    whiten_each(root, r, np.zeros((n, M)), np.empty(M, np.bool_))
    wide = math.sqrt(inflation)
    own = np.empty((na, na, M))
    from_own, from_prior, slack_own, slack_prior = np.empty((4, na, M))
    a = np.empty((M, na))
    for k in range(na):
        for q in range(na):
            for i in range(M):
                own[k, q, i] = wide * root[n + k, n + q, i]
        for i in range(M):
            alpha = mu[ancestors[i], k]
            mean = alpha
            for p in range(n):
                mean += root[n + k, p, i] * r[p, i]
            blind = uniform[i] < defensive
            s = alpha if blind else mean
            for q in range(k + 1):
                s += (prior[k, q, i] if blind else own[k, q, i]) * noise[i, q]
            a[i, k] = s
            from_own[k, i] = s - mean
            slack_own[k, i] = ROUNDING * (abs(s) + abs(mean))
            from_prior[k, i] = s - alpha
            slack_prior[k, i] = ROUNDING * (abs(s) + abs(alpha))
    log_q = np.empty(M)
    log_prior = np.empty(M)
    log_normal_each(own, from_own, slack_own, log_q)
    log_normal_each(prior, from_prior, slack_prior, log_prior)
    for i in range(M):
        if log_q[i] > log_prior[i]:
            mixture = (1.0 - defensive) + defensive * math.exp(log_prior[i] - log_q[i])
        else:
            mixture = (1.0 - defensive) * math.exp(log_q[i] - log_prior[i]) + defensive
        log_q[i] = max(log_q[i], log_prior[i]) + math.log(mixture)
    return a, log_q


@njit(cache=True, error_model="numpy")
def _joint_at_zeta(mu, L, ancestors, C, R, channels, joint, prior):
    """Fill the joint root of (y, a) as far as the slope of h has no part in it, and ``prior``, L_a.

    joint (n + na, n + 2 na, M), the particles last: [D  C L_za  0; 0  L_a  0] with D the lower root of
    (R^{1/2}, C L_z), what the draw of a does not move.
    """
    na, _, M = prior.shape
    nx = mu.shape[1]
    nz = nx - na
    n = channels.size
    B = M if max(L.shape[0], C.shape[0], R.shape[0]) > 1 else 1
    CL = np.empty((n, na, B))
    noises = np.empty((n, n + nz, B))
    D = np.empty((n, n, B))
    R_there = np.empty((n, n))
    R_root = np.empty((n, n))
    for b in range(B):
        Lb = L[ancestors[b] if L.shape[0] > 1 else 0]
        Cb = C[b if C.shape[0] > 1 else 0]
        if b == 0 or R.shape[0] > 1:
            for p in range(n):
                for q in range(n):
                    R_there[p, q] = R[b, channels[p], channels[q]]
            psd_cholesky_into(R_there, R_root)
        for p in range(n):
            for q in range(n):
                noises[p, q, b] = R_root[p, q]
            for k in range(nx):
                s = 0.0
                for q in range(max(k - na, 0), nz):
                    s += Cb[channels[p], q] * Lb[na + q, k]
                if k < na:
                    CL[p, k, b] = s
                else:
                    noises[p, n + k - na, b] = s
    lower_roots_into(noises, D)
    for p in range(n):
        for q in range(n):
            joint[p, q, :] = D[p, q]
        for k in range(na):
            joint[p, n + k, :] = CL[p, k]
    for k in range(na):
        for q in range(k + 1):
            if L.shape[0] == 1:
                joint[n + k, n + q, :] = L[0, k, q]
            else:
                for i in range(M):
                    joint[n + k, n + q, i] = L[ancestors[i], k, q]
            prior[k, q, :] = joint[n + k, n + q]


@njit(cache=True, error_model="numpy")
def _add_slopes(mu, L, ancestors, h, C, y, channels, joint, prior, r):
    """Add H L_a to the joint root, set the curvature there, and r (n, M) = y - y_hat."""
    na, _, M = prior.shape
    nz = mu.shape[1] - na
    each = 1 if C.shape[0] > 1 else 0  # what a step from row to row is among the C
    at = np.empty((3, M))  # h + C zeta at the middle and to both sides of it
    width = np.empty(M)
    for k in range(na):
        width[:] = 0.0
        for q in range(k + 1):
            for i in range(M):
                width[i] += prior[k, q, i] * prior[k, q, i]
        for i in range(M):
            width[i] = math.sqrt(width[i])
        for p in range(channels.size):
            there = channels[p]
            for side in range(3):
                point = 0 if side == 0 else side + 2 * k
                for i in range(M):
                    s = h[point * M + i, there]
                    for q in range(nz):
                        s += C[each * (point * M + i), there, q] * mu[ancestors[i], na + q]
                    at[side, i] = s
            for i in range(M):
                if k == 0:
                    r[p, i] = y[there] - at[0, i]
                curved = 0.5 * (at[1, i] + at[2, i]) - at[0, i]
                r[p, i] -= curved
                joint[p, channels.size + na + k, i] = math.sqrt(2.0) * curved
                slope = (at[1, i] - at[2, i]) / (2.0 * width[i]) if width[i] > 0.0 else 0.0
                at[0, i] = slope
            for q in range(k + 1):
                for i in range(M):
                    joint[p, channels.size + q, i] += at[0, i] * prior[k, q, i]
