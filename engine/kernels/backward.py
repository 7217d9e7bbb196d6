"""Backward simulation; report, Algorithm 3, as one call for the whole pass.

Shapes: time T, M filter particles, N backward trajectories; covariances have a particle axis of
length B = 1 (common to all) or M. What the filter stored is described in ``engine.rbpf``.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from engine.kernels.gaussian import (
    ROUNDING,
    log_normalizer,
    psd_cholesky_into,
    rounding,
    solve_lower_transposed,
)

NEGLIGIBLE = -38.0  # exp of this is below the rounding of a sum of weights
TAYLOR = 1.0 / np.array([math.factorial(k) for k in range(10, -1, -1)])


@njit(cache=True, error_model="numpy")
def reduce(L, r, out):
    """Out (n,) = L^{-1} r; in a direction without noise the raw remainder of r stays."""
    for i in range(L.shape[0]):
        s = r[i]
        for k in range(i):
            s -= L[i, k] * out[k]
        out[i] = s / L[i, i] if L[i, i] > 0.0 else s


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def exp_negative(x, out):
    """Out (M,) = exp(x) for x <= 0, zero below NEGLIGIBLE, to a relative 1e-11.

    The weights of all particles for every trajectory and time are what the backward pass spends
    its time on. Without branches and calls the compiler uses SIMD, and by "contract" adds products without
    rounding them before: three times as fast as the library's exp. With y = x / 64 + 0.3 in (-0.3, 0.3],
    exp(x) = (exp(y) exp(-0.3))^64.
    """
    for i in range(x.shape[0]):
        y = max(x[i], NEGLIGIBLE) / 64.0 + 0.3
        e = TAYLOR[0]
        for k in range(1, 11):
            e = e * y + TAYLOR[k]
        e *= 0.7408182206817179
        e *= e
        e *= e
        e *= e
        e *= e
        e *= e
        e *= e
        out[i] = e if x[i] > NEGLIGIBLE else 0.0


@njit(cache=True, error_model="numpy")
def largest(x):
    """Of x (M,), what is no number left out; four at a time, for each comparison waits for the one before."""
    a, b, c, d = -np.inf, -np.inf, -np.inf, -np.inf
    whole = x.shape[0] // 4 * 4
    for i in range(0, whole, 4):
        a = x[i] if x[i] > a else a
        b = x[i + 1] if x[i + 1] > b else b
        c = x[i + 2] if x[i + 2] > c else c
        d = x[i + 3] if x[i + 3] > d else d
    for i in range(whole, x.shape[0]):
        a = x[i] if x[i] > a else a
    return max(max(a, b), max(c, d))


@njit(cache=True, error_model="numpy")
def pick(log_w, w, u):
    """Index drawn from exp(log_w) (M,) with one uniform u; -1 when all are zero, or one is infinite.

    log_w and w are scratch. The place in the sum is found among sums of eight, then in one of them, without
    a branch that the processor would have to guess.
    """
    M = log_w.shape[0]
    top = largest(log_w)
    if not math.isfinite(top):
        return -1
    for i in range(M):
        log_w[i] -= top
    exp_negative(log_w, w)
    blocks, total, sums = M // 8, 0.0, log_w
    for b in range(blocks):
        v = w[8 * b : 8 * b + 8]
        total += ((v[0] + v[1]) + (v[2] + v[3])) + ((v[4] + v[5]) + (v[6] + v[7]))
        sums[b] = total
    for i in range(8 * blocks, M):
        total += w[i]
    goal, before = u * total, 0
    for b in range(blocks):
        before += sums[b] <= goal
    s, i = sums[before - 1] if before > 0 else 0.0, 8 * before
    for k in range(8 * before, min(8 * before + 8, M)):
        s += w[k]
        i += s <= goal
    i = min(i, M - 1)
    while not w[i] > 0.0:  # rounding must not lead to a weight of zero; the greatest is 1
        i = i - 1 if i > 0 else M - 1
    return i


@njit(cache=True, error_model="numpy")
def backward_gain(L, V, K):
    """K (nz, nx) = P A' Sigma^{-1} = P+ A' Q^{-1}, the gain of z_t on x_{t+1}; report, eqs. (56)-(57b).

    With L L' = Sigma = Q + A P A' and V L' = P A' from the filter, so that z+ = z + K (x_{t+1} - f - A z).
    """
    for c in range(V.shape[0]):
        solve_lower_transposed(L, V[c], K[c])


@njit(cache=True, error_model="numpy")
def units_of(Z, X, out):
    """Out (n, m) with Z out = X for a lower root Z (n, n) and X (n, m); zero in directions without noise."""
    n, m = X.shape
    for i in range(n):
        for c in range(m):
            s = X[i, c]
            for k in range(i):
                s -= Z[i, k] * out[k, c]
            out[i, c] = s / Z[i, i] if Z[i, i] > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
def smooth_covariance(Z, L, V, Z_plus, Z_next, D_next, na, work, P_out, M_out, D_out):
    """P_{t|T} and M_{t|T}; paper, eqs. (33b)-(33c). Here Approximation 2 is made.

    (Report (61c) is misprinted.) Z, Z_plus (nz, nz) are the roots of P_{t|t} and P+; L (nx, nx) and V (nz, nx)
    are of the prediction, see ``backward_gain``. Of z_{t+1} the root Z_next (nz, nz) of what its own filter
    knew, and D_next (nz, nz) with P_{t+1|T} = Z_next D_next Z_next'; D_out is the same of z_t. A gain on
    z_{t+1} itself divides by L, which noise that does not renew what decays leaves next to singular: taken
    times P_{t+1|T} from both sides, rounding would be blown up twice. ``work`` (5, nz, nz) is scratch.
    """
    nz = Z.shape[0]
    seen, own, rest, half, X = work
    units_of(L[na:, na:], Z_next, seen)  # z_{t+1}, in units of the prediction
    for r in range(nz):
        for c in range(nz):
            s = 0.0
            for k in range(nz):
                s += V[r, na + k] * seen[k, c]
            X[r, c] = s
    units_of(Z, X, own)
    units_of(Z, Z_plus, rest)
    _sum_of_squares(X, D_next, Z_plus, half, P_out)
    for r in range(nz):
        for c in range(nz):
            s = 0.0
            for k in range(c + 1):
                s += half[r, k] * Z_next[c, k]
            M_out[r, c] = s
    _sum_of_squares(own, D_next, rest, half, D_out)


@njit(cache=True, error_model="numpy")
def _sum_of_squares(X, D, S, half, out):
    """Out (n, n) = X D X' + S S' with half = X D and a lower triangular S."""
    n = X.shape[0]
    for r in range(n):
        for c in range(n):
            s = 0.0
            for k in range(n):
                s += X[r, k] * D[k, c]
            half[r, c] = s
    for r in range(n):
        for c in range(r + 1):
            s = 0.0
            for k in range(c + 1):
                s += S[r, k] * S[c, k]
            for k in range(n):
                s += half[r, k] * X[c, k]
            out[r, c] = s
            out[c, r] = s


@njit(cache=True, error_model="numpy")
def common_log_weights(log_w, m, L, v, out):
    """Log w_i - 1/2 |v - m_i|^2 for reduced means m (nx, M) and one reduced state v (nx,).

    In directions with noise; two at a time, for it is memory that takes the time.
    """
    nx, M = m.shape
    for i in range(M):
        out[i] = log_w[i]
    k = 0
    while k < nx:
        if k + 1 < nx and L[k, k] > 0.0 and L[k + 1, k + 1] > 0.0:
            here, after = v[k], v[k + 1]
            for i in range(M):
                d, e = here - m[k, i], after - m[k + 1, i]
                out[i] -= 0.5 * (d * d + e * e)
            k += 2
        else:
            if L[k, k] > 0.0:
                for i in range(M):
                    d = v[k] - m[k, i]
                    out[i] -= 0.5 * d * d
            k += 1


@njit(cache=True, error_model="numpy")
def without_noise(L):
    """Whether L (n, n) has a direction without noise."""
    for k in range(L.shape[0]):  # noqa: SIM110 - Numba knows no any()
        if not L[k, k] > 0.0:
            return True
    return False


@njit(cache=True, error_model="numpy")
def rule_out(m, L, x, v, out):
    """Out (M,) = -inf where a direction without noise does not lead from m_i to x (nx,), reduced v (nx,)."""
    for k in range(m.shape[0]):
        if not L[k, k] > 0.0:
            tolerance = 2.0 * ROUNDING * abs(x[k]) + rounding(L, v, k)
            for i in range(m.shape[1]):
                if abs(v[k] - m[k, i]) > tolerance:
                    out[i] = -np.inf


@njit(cache=True, error_model="numpy")
def particle_log_weights(log_w, mu, L, constants, x, r, v, out):
    """Log w_i + log N(x; mu_i, L_i L_i') for factors L (M, nx, nx); r, v (nx,) are scratch."""
    M, nx = mu.shape
    for i in range(M):
        for k in range(nx):
            r[k] = x[k] - mu[i, k]
        reduce(L[i], r, v)
        s = log_w[i] + constants[i]
        for k in range(nx):
            if L[i, k, k] > 0.0:
                s -= 0.5 * v[k] * v[k]
            elif abs(v[k]) > 2.0 * ROUNDING * abs(x[k]) + rounding(L[i], v, k):
                s = -np.inf
        out[i] = s


@njit(cache=True, error_model="numpy")
def backward_simulation(a, z, Z, log_w, mu, L, V, Z_plus, ancestors, first, uniforms, noise, joint):
    """N backward trajectories through the filter's particles; report, Algorithm 3.

    a (T, M, na), z (T, M, nz), Z (T, B, nz, nz), log_w (T, M); mu (T-1, M, nx), L (T-1, B, nx, nx),
    V (T-1, B, nz, nx), Z_plus (T-1, B, nz, nz) of the predictions, see ``engine.kernels.filtering.predict``;
    ancestors (T, M); first (N,) the indices at time T;
    uniforms (T-1, N), noise (T, N, nz) random numbers. ``joint`` chains the drawn z~ into whole
    trajectories (a, z) drawn from the joint smoothing density (neither Approximation then enters
    the draws); otherwise z~_{t+1} is drawn anew from N(z_{t+1|T}, P_{t+1|T}), report, eq. (42).

    Returns index (T, N); z_{t|T} (T, N, nz); P_{t|T} (T, B', nz, nz); M_{t|T} (T-1, B', nz, nz) with
    B' = 1 where all is common, else N; z~ (T, N, nz).
    """
    T, M, na = a.shape
    nz = z.shape[2]
    nx = na + nz
    N = first.shape[0]
    BL = L.shape[1]
    common = Z.shape[1] == 1 and BL == 1
    B = 1 if common else N
    index = np.empty((T, N), np.int64)
    z_s = np.empty((T, N, nz))
    P_s = np.empty((T, B, nz, nz))
    M_s = np.empty((T - 1, B, nz, nz))
    z_draw = np.empty((T, N, nz))
    index[T - 1] = first
    LP = np.empty((B, nz, nz))
    D = np.zeros((B, nz, nz))
    D_next = np.empty((nz, nz))
    work = np.empty((5, nz, nz))
    for b in range(B):
        for k in range(nz):
            D[b, k, k] = 1.0
        LP[b] = Z[T - 1, 0 if Z.shape[1] == 1 else first[b]]
        P_s[T - 1, b] = LP[b] @ LP[b].T
    for j in range(N):
        Lj = LP[0 if common else j]
        for k in range(nz):
            s = z[T - 1, first[j], k]
            z_s[T - 1, j, k] = s
            for c in range(k + 1):
                s += Lj[k, c] * noise[T - 1, j, c]
            z_draw[T - 1, j, k] = s

    K = np.empty((nz, nx))
    m = np.empty((nx, M))
    constants = np.empty(M)
    lw = np.empty(M)
    scratch = np.empty(M)
    x = np.empty(nx)
    r = np.empty(nx)
    v = np.empty(nx)
    for t in range(T - 2, -1, -1):
        exact = BL == 1 and without_noise(L[t, 0])
        if BL == 1:
            for i in range(M):
                reduce(L[t, 0], mu[t, i], v)
                for k in range(nx):
                    m[k, i] = v[k]
        else:
            for i in range(M):
                constants[i] = log_normalizer(L[t, i], nx)
        if common:
            backward_gain(L[t, 0], V[t, 0], K)
            D_next[:] = D[0]
            smooth_covariance(
                Z[t, 0],
                L[t, 0],
                V[t, 0],
                Z_plus[t, 0],
                Z[t + 1, 0],
                D_next,
                na,
                work,
                P_s[t, 0],
                M_s[t, 0],
                D[0],
            )
            if joint:
                LP[0] = Z_plus[t, 0]
            else:
                psd_cholesky_into(P_s[t, 0], LP[0])
        for j in range(N):
            after = index[t + 1, j]
            for k in range(na):
                x[k] = a[t + 1, after, k]
            for k in range(nz):
                x[na + k] = z_draw[t + 1, j, k]
            if BL == 1:
                reduce(L[t, 0], x, v)
                common_log_weights(log_w[t], m, L[t, 0], v, lw)
                if exact:
                    rule_out(m, L[t, 0], x, v, lw)
            else:
                particle_log_weights(log_w[t], mu[t], L[t], constants, x, r, v, lw)
            i = pick(lw, scratch, uniforms[t, j])
            if i < 0:  # noise-free states: only the particle's own past leads to it
                i = ancestors[t + 1, after]
            index[t, j] = i
            # Here Approximation 1 is made: z and P of particle i, whose past need not be that of a~_{1:t}.
            b = 0
            if not common:
                b = j
                own = 0 if BL == 1 else i
                backward_gain(L[t, own], V[t, own], K)
                here, there = (0, 0) if Z.shape[1] == 1 else (i, after)
                D_next[:] = D[j]
                smooth_covariance(
                    Z[t, here],
                    L[t, own],
                    V[t, own],
                    Z_plus[t, own],
                    Z[t + 1, there],
                    D_next,
                    na,
                    work,
                    P_s[t, j],
                    M_s[t, j],
                    D[j],
                )
                if joint:
                    LP[j] = Z_plus[t, own]
                else:
                    psd_cholesky_into(P_s[t, j], LP[j])
            L_plus = LP[b]
            for k in range(nz):  # paper, eq. (33a)
                s = z[t, i, k]
                for c in range(na):
                    s += K[k, c] * (x[c] - mu[t, i, c])
                mean = s
                for c in range(nz):
                    s += K[k, na + c] * (z_s[t + 1, j, c] - mu[t, i, na + c])
                    mean += K[k, na + c] * (x[na + c] - mu[t, i, na + c])
                z_s[t, j, k] = s
                d = mean if joint else s
                for c in range(k + 1):
                    d += L_plus[k, c] * noise[t, j, c]
                z_draw[t, j, k] = d
    return index, z_s, P_s, M_s, z_draw
