"""Backward simulation of whole trajectories at a cost that is linear in the number of particles.

The backward weights of report, eq. (48), need all M particles for each trajectory. Both samplers
here draw candidates from the filter's weights, which costs the same whatever M is, and look at the
density N(x~_{t+1}; mu_i, Sigma_i) of the candidates only. Shapes as in ``engine.kernels.backward``.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from engine.kernels.backward import backward_gain, pick, reduce
from engine.kernels.gaussian import ROUNDING, log_normalizer, rounding


@njit(cache=True, error_model="numpy")
def guide_table(w, cumulated, guide):
    """Prepare ``draw_index`` for weights w (M,): O(M) once, O(1) on average for each draw."""
    M = w.shape[0]
    total = 0.0
    for i in range(M):
        total += w[i]
        cumulated[i] = total
    i = 0
    for g in range(M):
        while i < M - 1 and cumulated[i] <= g * total / M:
            i += 1
        guide[g] = i


@njit(cache=True, error_model="numpy")
def draw_index(cumulated, guide, u):
    """An index with the probabilities of ``guide_table``, from one uniform u in [0, 1)."""
    M = guide.shape[0]
    goal = u * cumulated[M - 1]
    i = guide[int(u * M)]
    while i < M - 1 and cumulated[i] <= goal:
        i += 1
    return i


@njit(cache=True, error_model="numpy")
def log_density(x, e, reduced, mu, L, r, v):
    """log N(x; mu, L L') up to log_normalizer(L), for one particle; -inf where noise-free rows differ.

    Where ``reduced``, mu (nx,) is already L^{-1} mu, and e (nx,) is L^{-1} x; r, v (nx,) are scratch.
    """
    nx = x.shape[0]
    if reduced:
        for k in range(nx):
            v[k] = e[k] - mu[k]
    else:
        for k in range(nx):
            r[k] = x[k] - mu[k]
        reduce(L, r, v)
    s = 0.0
    for k in range(nx):
        if L[k, k] > 0.0:
            s -= 0.5 * v[k] * v[k]
        elif abs(v[k]) > 2.0 * ROUNDING * abs(x[k]) + rounding(L, e if reduced else v, k):
            return -np.inf
    return s


@njit(cache=True, error_model="numpy")
def backward_linear(a, z, Z, w, mu, L, V, Z_plus, ancestors, first, noise, rng, tries, moves):
    """N joint trajectories x~ = (a, z), report, eqs. (47)-(48) and (53).

    With ``moves`` > 0, that many steps of an independent Metropolis-Hastings chain per trajectory
    and time: started at the ancestor that the particle had in the filter, candidates drawn from the
    filter's weights w (T, M), accepted by the ratio of N(x~_{t+1}; mu_i, Sigma_i) (Dau, Chopin 2022).
    Candidates must not look at the particles of t+1: only then is the ancestor a draw from the chain's
    own stationary density, and one move is enough.
    Otherwise rejection sampling from the same candidates, exact, with at most ``tries`` of them
    before all M weights are computed (Douc et al. 2011; Taghavi et al. 2013).

    ``first`` (N,) indices at time T; noise (T, N, nz) ~ N(0, I); ``rng`` a NumPy generator. Returns
    index (T, N), z~ (T, N, nz), and the share of accepted candidates and of full evaluations.
    """
    T, M, na = a.shape
    nz = z.shape[2]
    nx = na + nz
    N = first.shape[0]
    BP, BL = Z.shape[1], L.shape[1]
    common = BP == 1 and BL == 1
    index = np.empty((T, N), np.int64)
    z_draw = np.empty((T, N, nz))
    index[T - 1] = first
    for j in range(N):
        last = Z[T - 1, 0 if BP == 1 else first[j]]
        for k in range(nz):
            s = z[T - 1, first[j], k]
            for c in range(k + 1):
                s += last[k, c] * noise[T - 1, j, c]
            z_draw[T - 1, j, k] = s

    K = np.empty((nz, nx))
    m = np.empty((M, nx))
    constants = np.zeros(M)
    cumulated = np.empty(M)
    guide = np.empty(M, np.int64)
    lw = np.empty(M)
    scratch = np.empty(M)
    x = np.empty(nx)
    e = np.empty(nx)
    r = np.empty(nx)
    v = np.empty(nx)
    candidates, accepted, full = 0, 0, 0
    for t in range(T - 2, -1, -1):
        guide_table(w[t], cumulated, guide)
        top = 0.0
        if BL == 1:
            for i in range(M):
                reduce(L[t, 0], mu[t, i], m[i])
        else:
            top = -np.inf
            for i in range(M):
                constants[i] = log_normalizer(L[t, i], nx)
                top = max(top, constants[i])
        if common:
            backward_gain(L[t, 0], V[t, 0], K)
        means = m if BL == 1 else mu[t]
        for j in range(N):
            after = index[t + 1, j]
            for k in range(na):
                x[k] = a[t + 1, after, k]
            for k in range(nz):
                x[na + k] = z_draw[t + 1, j, k]
            if BL == 1:
                reduce(L[t, 0], x, e)
            i = -1
            if moves > 0:
                i = ancestors[t + 1, after]
                here = constants[i] + log_density(
                    x, e, BL == 1, means[i], L[t, 0 if BL == 1 else i], r, v
                )
                for _ in range(moves):
                    c = draw_index(cumulated, guide, rng.random())
                    there = constants[c] + log_density(
                        x, e, BL == 1, means[c], L[t, 0 if BL == 1 else c], r, v
                    )
                    candidates += 1
                    # an impossible candidate is never taken, not even instead of another one
                    if there > -np.inf and (there >= here or rng.random() < math.exp(there - here)):
                        i, here = c, there
                        accepted += 1
            else:
                for _ in range(tries):
                    c = draw_index(cumulated, guide, rng.random())
                    there = constants[c] + log_density(
                        x, e, BL == 1, means[c], L[t, 0 if BL == 1 else c], r, v
                    )
                    candidates += 1
                    if rng.random() < math.exp(there - top):
                        accepted += 1
                        i = c
                        break
                if i < 0:
                    full += 1
                    for c in range(M):
                        lw[c] = -np.inf
                        if w[t, c] > 0.0:
                            lw[c] = (
                                math.log(w[t, c])
                                + constants[c]
                                + log_density(
                                    x, e, BL == 1, means[c], L[t, 0 if BL == 1 else c], r, v
                                )
                            )
                    i = pick(lw, scratch, rng.random())
                    if i < 0:  # noise-free states: only the particle's own past leads to it
                        i = ancestors[t + 1, after]
            index[t, j] = i

            own = 0 if BL == 1 else i
            if not common:
                backward_gain(L[t, own], V[t, own], K)
            for k in range(nz):
                s = z[t, i, k]
                for c in range(nx):
                    s += K[k, c] * (x[c] - mu[t, i, c])
                for c in range(k + 1):
                    s += Z_plus[t, own, k, c] * noise[t, j, c]
                z_draw[t, j, k] = s
    draws = max((T - 1) * N, 1)
    return index, z_draw, accepted / max(candidates, 1), full / draws
