"""The adapted draw of the filter, which looks at y: a second-order extended Kalman step per particle.

Particles lie side by side in memory, on the last axis, so that the compiler works on several at once.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from engine.kernels.gaussian import (
    ROUNDING,
    log_normal_each,
    lower_roots_into,
    psd_cholesky_into,
    whiten_each,
)


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
    alpha, mean, drawn = np.empty((3, M))
    for k in range(na):
        for q in range(na):
            for i in range(M):
                own[k, q, i] = wide * root[n + k, n + q, i]
        for i in range(M):
            alpha[i] = mu[ancestors[i], k]
            mean[i] = alpha[i]
        for p in range(n):
            for i in range(M):
                mean[i] += root[n + k, p, i] * r[p, i]
        for i in range(M):
            drawn[i] = alpha[i] if uniform[i] < defensive else mean[i]
        for q in range(k + 1):
            for i in range(M):
                scale = prior[k, q, i] if uniform[i] < defensive else own[k, q, i]
                drawn[i] += scale * noise[i, q]
        for i in range(M):
            a[i, k] = drawn[i]
            from_own[k, i] = drawn[i] - mean[i]
            slack_own[k, i] = ROUNDING * (abs(drawn[i]) + abs(mean[i]))
            from_prior[k, i] = drawn[i] - alpha[i]
            slack_prior[k, i] = ROUNDING * (abs(drawn[i]) + abs(alpha[i]))
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
    zeta = np.empty((nz, M))
    for q in range(nz):
        for i in range(M):
            zeta[q, i] = mu[ancestors[i], na + q]
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
                    at[side, i] = h[point * M + i, there]
                for q in range(nz):
                    for i in range(M):
                        at[side, i] += C[each * (point * M + i), there, q] * zeta[q, i]
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
