"""Steps of linearised differential equations, row by row; see :mod:`engine.statespace.continuous`."""

from __future__ import annotations

import numpy as np
from numba import njit

from engine.kernels.van_loan import BLOCK, integrals

SHORT = 1e-3  # of what a step moves a state: half the distance over which J is a difference
LEAST = 1e-6  # of the state's value, below which differences are rounding
NEAR = 1e-7  # of a state's size, where it is near zero and at rest; in its unit where it has none


@njit(cache=True, error_model="numpy")
def beside(a, way, size):
    """a (M, na) with each state moved up, then down: (2 na M, na), M rows for each state and side.

    By a share of its ``way`` (M, na) within the step, of its value and of its ``size`` (na,), in whatever unit.
    Not of the noise, which a run without noise knows nothing of.
    """
    M, na = a.shape
    out = np.empty((2 * na * M, na))
    for i in range(na):
        for k in range(M):
            h = SHORT * way[k, i] + LEAST * abs(a[k, i]) + NEAR * size[i]
            if not h > 0.0:
                h = NEAR
            up, down = 2 * i * M + k, (2 * i + 1) * M + k
            for j in range(na):
                out[up, j] = out[down, j] = a[k, j]
            out[up, i] += h
            out[down, i] -= h
    return out


@njit(cache=True, error_model="numpy")
def difference_quotients(points, values):
    """J (M, nx, na) from the rates (2 na M, nx) at :func:`beside`'s points."""
    rows, na = points.shape
    M, nx = rows // (2 * na), values.shape[1]
    J = np.empty((M, nx, na))
    for i in range(na):
        for k in range(M):
            up, down = 2 * i * M + k, (2 * i + 1) * M + k
            way = points[up, i] - points[down, i]
            for r in range(nx):
                J[k, r, i] = (values[up, r] - values[down, r]) / way
    return J


@njit(cache=True, error_model="numpy")
def step_of(a, f, J, A, Qc, dt):
    """x after a step without z, (M, nx), the matrix of z (1 or M, nx, nz), the noise (1 or M, nx, nx).

    Of (a, z)' = f + [J A] (d, z) + noise of intensity Qc, d the way from a (M, na); f (M, nx). J, A, Qc
    (1 or M, ., .) and dt (1 or M,) may be common to all rows, and are taken for common where they are equal.
    What is not finite is lost: NaN.
    """
    M, nx = f.shape
    na, nz = J.shape[2], A.shape[2]
    B = 1 if _alike(J) and _alike(A) and _alike(Qc) and (dt == dt[0]).all() else M
    moved, step, Q = np.empty((M, nx)), np.empty((B, nx, nz)), np.empty((B, nx, nx))
    width, m = min(B, BLOCK), nx if B == 1 else 1
    F, G, S = np.empty((nx, nx, width)), np.zeros((nx, m, width)), np.empty((nx, nx, width))
    steps, lost = np.empty(width), np.empty(width, dtype=np.bool_)
    own_J, own_A, own_Qc, own_dt = len(J) > 1, len(A) > 1, len(Qc) > 1, len(dt) > 1
    for first in range(0, B, width):
        count = min(width, B - first)
        for k in range(count):
            b = first + k
            steps[k] = dt[b if own_dt else 0]
            at_J, at_A, at_Qc = b if own_J else 0, b if own_A else 0, b if own_Qc else 0
            total = 0.0  # finite if all of it is
            for i in range(nx):
                for j in range(na):
                    F[i, j, k] = J[at_J, i, j]
                    total += abs(F[i, j, k])
                for j in range(nz):
                    F[i, na + j, k] = A[at_A, i, j]
                    total += abs(F[i, na + j, k])
                for j in range(nx):
                    S[i, j, k] = 0.5 * (Qc[at_Qc, i, j] + Qc[at_Qc, j, i])
                    total += abs(S[i, j, k])
                G[i, i if B == 1 else 0, k] = 1.0 if B == 1 else f[b, i]
            lost[k] = not total < np.inf
            if lost[k]:  # a run that has run away stays lost, and takes no other with it
                F[:, :, k], S[:, :, k] = 0.0, 0.0
        whole, drive, noise = integrals(F, G, S, steps, count, nz > 0)
        for k in range(count):
            b = first + k
            for i in range(nx):
                for j in range(nx):
                    Q[b, i, j] = noise[i, j, k]
                for j in range(nz):
                    step[b, i, j] = whole[i, na + j, k]
            for row in range(b, M if B == 1 else b + 1):
                for i in range(nx):
                    way = drive[i, 0, k]
                    if B == 1:
                        way = 0.0
                        for j in range(nx):
                            way += drive[i, j, 0] * f[row, j]
                    here = a[row, i] if i < na else 0.0
                    moved[row, i] = np.nan if lost[k] else here + way
    return moved, step, Q


@njit(cache=True, error_model="numpy")
def _alike(matrices):
    """Whether all of (B, ., .) are equal."""
    for b in range(1, len(matrices)):
        for i in range(matrices.shape[1]):
            for j in range(matrices.shape[2]):
                if matrices[b, i, j] != matrices[0, i, j]:
                    return False
    return True
