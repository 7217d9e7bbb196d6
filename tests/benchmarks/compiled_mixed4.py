"""The E step for paper, eq. (35), written by hand for that model alone and compiled as a whole.

The yardstick of the benchmark: the algorithm of ``engine`` (RBPF with the bootstrap or the adapted
proposal, backward simulation of joint trajectories, exact moments given each) with the model
inlined, sizes fixed (na = 1, nz = 3, ny = 2), zeros of A and C left out, no missing data, nothing
that could be computed once computed twice. It draws the same random numbers in the same order,
so its results are those of the engine up to rounding; ``tests/engine/test_compiled.py`` says so.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

LOG_2PI = math.log(2.0 * math.pi)
Q, R = 0.01, 0.1
INFLATION, DEFENSIVE = 1.3, 0.1
NEGLIGIBLE = -38.0


@njit(cache=True, error_model="numpy")
def measured(a):
    return 0.1 * a * abs(a)


@njit(cache=True, error_model="numpy")
def normalize(log_w, w):
    M = log_w.shape[0]
    top = log_w.max()
    total = 0.0
    for i in range(M):
        w[i] = math.exp(log_w[i] - top)
        total += w[i]
    squares = 0.0
    for i in range(M):
        w[i] /= total
        squares += w[i] * w[i]
    return top + math.log(total), 1.0 / squares


@njit(cache=True, error_model="numpy")
def predict_covariance(P, th2, th3, c, s, AP, L):
    """AP (4, 3) = A P and the factor L (4, 4) of Q I + A P A'."""
    for k in range(3):
        AP[0, k] = th2 * P[0, k]
        AP[1, k] = P[0, k] + th3 * P[1, k]
        AP[2, k] = c * P[1, k] - s * P[2, k]
        AP[3, k] = s * P[1, k] + c * P[2, k]
    for r in range(4):
        L[r, 0] = th2 * AP[r, 0]
        L[r, 1] = AP[r, 0] + th3 * AP[r, 1]
        L[r, 2] = c * AP[r, 1] - s * AP[r, 2]
        L[r, 3] = s * AP[r, 1] + c * AP[r, 2]
        L[r, r] += Q
    for j in range(4):
        d = L[j, j]
        for k in range(j):
            d -= L[j, k] * L[j, k]
            L[k, j] = 0.0
        p = math.sqrt(d)
        L[j, j] = p
        for i in range(j + 1, 4):
            v = L[i, j]
            for k in range(j):
                v -= L[i, k] * L[j, k]
            L[i, j] = v / p


@njit(cache=True, error_model="numpy")
def conditioned_covariance(L, P):
    """P_{t|t-1} = L_z L_z'."""
    for r in range(3):
        for k in range(r + 1):
            v = 0.0
            for m in range(k + 1):
                v += L[1 + r, 1 + m] * L[1 + k, 1 + m]
            P[r, k] = v
            P[k, r] = v


@njit(cache=True, error_model="numpy")
def update_covariance(P, K):
    """Gain K (3,) = P c' / S and S for y_2 = z_1 - z_2 + z_3; P becomes P_{t|t}."""
    for k in range(3):
        K[k] = P[k, 0] - P[k, 1] + P[k, 2]
    S = K[0] - K[1] + K[2] + R
    for r in range(3):
        for k in range(3):
            P[r, k] -= K[r] * K[k] / S
    for r in range(3):
        K[r] /= S
    return S


@njit(cache=True, error_model="numpy")
def particle_filter(y, theta, M, rng, adapted, ess_threshold):
    """Report, Algorithm 2; ``adapted`` chooses the proposal."""
    T = y.shape[0]
    th1, th2, th3 = theta[0], theta[1], theta[2]
    c, s = theta[3] * math.cos(theta[4]), theta[3] * math.sin(theta[4])
    a = np.empty((T, M))
    z = np.empty((T, M, 3))
    P = np.empty((T, 3, 3))
    log_w = np.empty((T, M))
    ancestors = np.empty((T, M), np.int64)
    mu = np.empty((T - 1, M, 4))
    L = np.empty((T - 1, 4, 4))
    AP = np.empty((T - 1, 4, 3))
    ess = np.empty(T)
    L1 = np.zeros((4, 4))
    L1[0, 0] = 1.0
    mu1 = np.zeros((M, 4))
    w = np.empty(M)
    K = np.empty(3)
    log_likelihood = 0.0
    even = -math.log(M)
    own = np.arange(M)
    resampled = True
    for t in range(T):
        Lt = L1 if t == 0 else L[t - 1]
        m = mu1 if t == 0 else mu[t - 1]
        if t == 0:
            ancestors[t] = own
        noise = rng.standard_normal(M)
        # the covariances, common to all particles
        width = Lt[0, 0]
        Saa = width * width
        b0 = Lt[1, 0] - Lt[2, 0] + Lt[3, 0]  # c' L, the row of y_2
        b1 = Lt[1, 1] - Lt[2, 1] + Lt[3, 1]
        b2 = -Lt[2, 2] + Lt[3, 2]
        b3 = Lt[3, 3]
        Say = width * b0
        Syy = b0 * b0 + b1 * b1 + b2 * b2 + b3 * b3 + R
        prior_constant = -math.log(width) - 0.5 * LOG_2PI
        conditioned_covariance(Lt, P[t])
        S = update_covariance(P[t], K)
        y_constant = -0.5 * (math.log(R) + math.log(S)) - LOG_2PI
        if adapted:
            uniform = rng.random(M)
        for i in range(M):
            j = ancestors[t, i]
            alpha = m[j, 0]
            log_ratio = 0.0
            if adapted:
                middle, up, down = measured(alpha), measured(alpha + width), measured(alpha - width)
                H = (up - down) / (2.0 * width)
                curve = 0.5 * (up + down) - middle
                r1 = y[t, 0] - middle - curve
                r2 = y[t, 1] - (m[j, 1] - m[j, 2] + m[j, 3])
                l11 = math.sqrt(H * H * Saa + R + 2.0 * curve * curve)
                l21 = H * Say / l11
                l22 = math.sqrt(Syy - l21 * l21)
                v1 = r1 / l11
                v2 = (r2 - l21 * v1) / l22
                W1 = H * Saa / l11
                W2 = (Say - l21 * W1) / l22
                mean = alpha + W1 * v1 + W2 * v2
                sd = math.sqrt(INFLATION * (Saa - W1 * W1 - W2 * W2))
                ai = alpha + width * noise[i] if uniform[i] < DEFENSIVE else mean + sd * noise[i]
                d = (ai - mean) / sd
                q = -math.log(sd) - 0.5 * LOG_2PI - 0.5 * d * d
                d = (ai - alpha) / width
                p = prior_constant - 0.5 * d * d
                top = max(p, q)
                log_ratio = p - (
                    top
                    + math.log(
                        (1.0 - DEFENSIVE) * math.exp(q - top) + DEFENSIVE * math.exp(p - top)
                    )
                )
            else:
                ai = alpha + width * noise[i]
            v = (ai - alpha) / width
            z1 = m[j, 1] + Lt[1, 0] * v
            z2 = m[j, 2] + Lt[2, 0] * v
            z3 = m[j, 3] + Lt[3, 0] * v
            e1 = y[t, 0] - measured(ai)
            e2 = y[t, 1] - (z1 - z2 + z3)
            a[t, i] = ai
            z[t, i, 0] = z1 + K[0] * e2
            z[t, i, 1] = z2 + K[1] * e2
            z[t, i, 2] = z3 + K[2] * e2
            before = even if resampled else log_w[t - 1, i]
            log_w[t, i] = before + log_ratio + y_constant - 0.5 * (e1 * e1 / R + e2 * e2 / S)
        log_sum, ess[t] = normalize(log_w[t], w)
        log_likelihood += log_sum
        for i in range(M):
            log_w[t, i] -= log_sum
        if t == T - 1:
            break
        predict_covariance(P[t], th2, th3, c, s, AP[t], L[t])
        for i in range(M):
            z1, z2, z3 = z[t, i, 0], z[t, i, 1], z[t, i, 2]
            mu[t, i, 0] = th1 * math.atan(a[t, i]) + th2 * z1
            mu[t, i, 1] = z1 + th3 * z2
            mu[t, i, 2] = c * z2 - s * z3
            mu[t, i, 3] = s * z2 + c * z3
        resampled = ess[t] <= ess_threshold * M
        if resampled:
            u = rng.random(M)[0]
            k = 0
            total = w[0]
            for i in range(M):
                while (i + u) / M >= total and k < M - 1:
                    k += 1
                    total += w[k]
                ancestors[t + 1, i] = k
        else:
            ancestors[t + 1] = own
    return a, z, P, log_w, ancestors, mu, L, AP, log_likelihood, ess, w


@njit(cache=True, error_model="numpy")
def gain(P, L, AP, K, P_plus, W):
    """K (3, 4) = P A' Sigma^{-1} and P+ (3, 3) = P - K A P; W (4, 3) is scratch."""
    for c in range(3):
        for i in range(4):
            v = AP[i, c]
            for k in range(i):
                v -= L[i, k] * W[k, c]
            W[i, c] = v / L[i, i]
        for i in range(3, -1, -1):
            v = W[i, c]
            for k in range(i + 1, 4):
                v -= L[k, i] * K[c, k]
            K[c, i] = v / L[i, i]
    for r in range(3):
        for c in range(r + 1):
            v = P[r, c]
            for i in range(4):
                v -= W[i, r] * W[i, c]
            P_plus[r, c] = v
            P_plus[c, r] = v


@njit(cache=True, error_model="numpy")
def cholesky_3(S, L):
    """The factor of a non-negative S (3, 3)."""
    for j in range(3):
        d = S[j, j]
        for k in range(j):
            d -= L[j, k] * L[j, k]
        p = math.sqrt(d) if d > 1e-12 * S[j, j] else 0.0
        L[j, j] = p
        for i in range(j + 1, 3):
            v = S[i, j]
            for k in range(j):
                v -= L[i, k] * L[j, k]
            L[i, j] = v / p if p > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def backward(a, z, P, log_w, w, mu, L, AP, N, rng):
    """Joint trajectories, report, Appendix B: a (T, N), z~ (T, N, 3)."""
    T, M = a.shape
    uniform_T = rng.random(N)
    uniforms = rng.random((T - 1, N))
    noise = rng.standard_normal((T, N, 3))
    index = np.empty(N, np.int64)
    k = 0
    total = w[0]
    for j in range(N):
        while (j + uniform_T[j]) / N >= total and k < M - 1:
            k += 1
            total += w[k]
        index[j] = k
    a_s = np.empty((T, N))
    z_s = np.empty((T, N, 3))
    K = np.empty((3, 4))
    W = np.empty((4, 3))
    P_plus = np.empty((3, 3))
    LP = np.zeros((3, 3))
    m = np.empty((4, M))
    lw = np.empty(M)
    cdf = np.empty(M)
    cholesky_3(P[T - 1], LP)
    for j in range(N):
        a_s[T - 1, j] = a[T - 1, index[j]]
        for r in range(3):
            v = z[T - 1, index[j], r]
            for k in range(r + 1):
                v += LP[r, k] * noise[T - 1, j, k]
            z_s[T - 1, j, r] = v
    for t in range(T - 2, -1, -1):
        Lt = L[t]
        l10, l20, l21 = Lt[1, 0], Lt[2, 0], Lt[2, 1]
        l30, l31, l32 = Lt[3, 0], Lt[3, 1], Lt[3, 2]
        i0, i1, i2, i3 = 1.0 / Lt[0, 0], 1.0 / Lt[1, 1], 1.0 / Lt[2, 2], 1.0 / Lt[3, 3]
        for i in range(M):
            m[0, i] = mu[t, i, 0] * i0
            m[1, i] = (mu[t, i, 1] - l10 * m[0, i]) * i1
            m[2, i] = (mu[t, i, 2] - l20 * m[0, i] - l21 * m[1, i]) * i2
            m[3, i] = (mu[t, i, 3] - l30 * m[0, i] - l31 * m[1, i] - l32 * m[2, i]) * i3
        gain(P[t], Lt, AP[t], K, P_plus, W)
        cholesky_3(P_plus, LP)
        for j in range(N):
            x0, x1, x2, x3 = a_s[t + 1, j], z_s[t + 1, j, 0], z_s[t + 1, j, 1], z_s[t + 1, j, 2]
            v0 = x0 * i0
            v1 = (x1 - l10 * v0) * i1
            v2 = (x2 - l20 * v0 - l21 * v1) * i2
            v3 = (x3 - l30 * v0 - l31 * v1 - l32 * v2) * i3
            for i in range(M):
                d0, d1, d2, d3 = v0 - m[0, i], v1 - m[1, i], v2 - m[2, i], v3 - m[3, i]
                lw[i] = log_w[t, i] - 0.5 * (d0 * d0 + d1 * d1 + d2 * d2 + d3 * d3)
            top = -np.inf
            for i in range(M):
                if lw[i] > top:
                    top = lw[i]
            total = 0.0
            for i in range(M):
                e = lw[i] - top
                if e > NEGLIGIBLE:
                    total += math.exp(e)
                cdf[i] = total
            goal = uniforms[t, j] * total
            low, high = 0, M - 1
            while low < high:
                middle = (low + high) // 2
                if cdf[middle] > goal:
                    high = middle
                else:
                    low = middle + 1
            a_s[t, j] = a[t, low]
            d0, d1 = x0 - mu[t, low, 0], x1 - mu[t, low, 1]
            d2, d3 = x2 - mu[t, low, 2], x3 - mu[t, low, 3]
            for r in range(3):
                v = z[t, low, r] + K[r, 0] * d0 + K[r, 1] * d1 + K[r, 2] * d2 + K[r, 3] * d3
                for k in range(r + 1):
                    v += LP[r, k] * noise[t, j, k]
                z_s[t, j, r] = v
    return a_s, z_s


@njit(cache=True, error_model="numpy")
def condition_on(a, theta, y):
    """Moments of z given each trajectory a (T, N): z (T, N, 3), P (T, 3, 3), M (T-1, 3, 3)."""
    T, N = a.shape
    th1, th2, th3 = theta[0], theta[1], theta[2]
    c, s = theta[3] * math.cos(theta[4]), theta[3] * math.sin(theta[4])
    z = np.zeros((T, N, 3))
    P = np.zeros((T, 3, 3))
    mu = np.empty((T - 1, N, 4))
    L = np.empty((T - 1, 4, 4))
    AP = np.empty((T - 1, 4, 3))
    K = np.empty(3)
    for t in range(T):
        update_covariance(P[t], K)
        for j in range(N):
            e = y[t, 1] - (z[t, j, 0] - z[t, j, 1] + z[t, j, 2])
            for r in range(3):
                z[t, j, r] += K[r] * e
        if t == T - 1:
            break
        predict_covariance(P[t], th2, th3, c, s, AP[t], L[t])
        conditioned_covariance(L[t], P[t + 1])
        for j in range(N):
            z1, z2, z3 = z[t, j, 0], z[t, j, 1], z[t, j, 2]
            mu[t, j, 0] = th1 * math.atan(a[t, j]) + th2 * z1
            mu[t, j, 1] = z1 + th3 * z2
            mu[t, j, 2] = c * z2 - s * z3
            mu[t, j, 3] = s * z2 + c * z3
            v = (a[t + 1, j] - mu[t, j, 0]) / L[t, 0, 0]
            for r in range(3):
                z[t + 1, j, r] = mu[t, j, 1 + r] + L[t, 1 + r, 0] * v
    M = np.empty((T - 1, 3, 3))
    G = np.empty((3, 4))
    W = np.empty((4, 3))
    P_plus = np.empty((3, 3))
    for t in range(T - 2, -1, -1):
        gain(P[t], L[t], AP[t], G, P_plus, W)
        for r in range(3):
            for k in range(3):
                v = 0.0
                for n in range(3):
                    v += G[r, 1 + n] * P[t + 1, n, k]
                M[t, r, k] = v
        for r in range(3):
            for k in range(3):
                v = P_plus[r, k]
                for n in range(3):
                    v += M[t, r, n] * G[k, 1 + n]
                P[t, r, k] = v
        for j in range(N):
            d0 = a[t + 1, j] - mu[t, j, 0]
            d1 = z[t + 1, j, 0] - mu[t, j, 1]
            d2 = z[t + 1, j, 1] - mu[t, j, 2]
            d3 = z[t + 1, j, 2] - mu[t, j, 3]
            for r in range(3):
                z[t, j, r] += G[r, 0] * d0 + G[r, 1] * d1 + G[r, 2] * d2 + G[r, 3] * d3
    return z, P, M


@njit(cache=True, error_model="numpy")
def e_step(y, theta, M, N, rng, adapted, ess_threshold):
    """Trajectories a (T, N) and the moments of z given each; log-likelihood."""
    a, z, P, log_w, _, mu, L, AP, log_likelihood, _, w = particle_filter(
        y, theta, M, rng, adapted, ess_threshold
    )
    a_s, _ = backward(a, z, P, log_w, w, mu, L, AP, N, rng)
    z_s, P_s, M_s = condition_on(a_s, theta, y)
    return a_s, z_s, P_s, M_s, log_likelihood
