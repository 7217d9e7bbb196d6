"""Exact smoothing of z given whole trajectories of a: a Kalman filter and a pass back for each.

Given a_{1:T}, model (1) is linear Gaussian in z, with a_{t+1} as a further measurement of z_t. The
same atoms as in the particle filter, with each trajectory its own ancestor.

The pass back is that of Rauch, Tung and Striebel in units of what the filter knew: with z_t = z_{t|t-1} +
Z xi and Z Z' = P_{t|t-1}, the moments of xi follow from those of the next one by matrices of norm 1 at most.
A gain on z_{t+1} itself would divide by Z. Where noise does not renew what decays, Z ends next to singular, and
rounding would be blown up, to variances below zero.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from engine.kernels.filtering import predict, update
from engine.kernels.gaussian import psd_cholesky_many


@njit(cache=True, error_model="numpy")
def smooth_along(a, f, A, Q, h, C, R, z1, P1, y):
    """Moments of z given a_{1:T} and y_{1:T}, without Approximations 1 and 2.

    a (T, N, na), f (T-1, N, nx), A, Q (T-1, B, ., .), h (T, N, ny), C, R (T, B, ., .), z1 (N, nz),
    P1 (B, nz, nz), y (T, ny) -> z_{t|T} (T, N, nz), P_{t|T} (T, B', nz, nz), M_{t|T} (T-1, B', nz, nz).
    """
    T, N, na = a.shape
    nz = z1.shape[1]
    # B' = 1 only where every matrix is common to all trajectories
    B = max(A.shape[1], Q.shape[1], C.shape[1], R.shape[1], P1.shape[0])
    z_s = np.empty((T, N, nz))
    before = np.empty((T, B, nz, nz))  # roots of P_{t|t-1}, ...
    after = np.empty((T, B, nz, nz))  # ... of P_{t|t}, ...
    of_y = np.empty((T, B, nz, nz))  # ... and, in units of the former, of the latter
    of_next = np.empty((T - 1, B, nz, nz))  # in units of P_{t|t}: what z_{t+1} tells of z_t, ...
    left = np.empty((T - 1, B, nz, nz))  # ... and the root of what x_{t+1} leaves
    by_y = np.empty((T, N, nz))  # means of xi, by y_t ...
    by_a = np.empty((T - 1, N, nz))  # ... and, in units of P_{t|t}, by a_{t+1}
    nothing, unit = np.zeros((N, nz)), np.zeros((1, nz, nz))
    for k in range(nz):
        unit[0, k, k] = 1.0
    z, Z = z1, psd_cholesky_many(P1)
    e = np.empty(na)
    for t in range(T):
        _every(Z, before[t])
        by_y[t], U, _ = update(nothing, unit, _moved(h[t], C[t], z), _times(C[t], Z), R[t], y[t])
        z, Z = _moved(z, Z, by_y[t]), _times(Z, U)
        z_s[t] = z
        _every(Z, after[t])
        _every(U, of_y[t])
        if t == T - 1:
            break
        m, L, V, rest = predict(_moved(f[t], A[t], z), _times(A[t], Z), Q[t], nothing, unit)
        z, Z = np.empty((N, nz)), L[:, na:, na:].copy()
        for j in range(N):
            b = j if L.shape[0] > 1 else 0
            for k in range(na):
                s = a[t + 1, j, k] - m[j, k]
                for c in range(k):
                    s -= L[b, k, c] * e[c]
                e[k] = s / L[b, k, k] if L[b, k, k] > 0.0 else 0.0
            for k in range(nz):
                s, own = m[j, na + k], 0.0
                for c in range(na):
                    s += L[b, na + k, c] * e[c]
                    own += V[b, k, c] * e[c]
                z[j, k], by_a[t, j, k] = s, own
        _every(V[:, :, na:], of_next[t])
        _every(rest, left[t])
    P_s = np.empty((T, B, nz, nz))
    M_s = np.empty((T - 1, B, nz, nz))
    D = np.empty((B, nz, nz))  # Cov(xi_t | y_{1:T})
    cov = np.empty((nz, nz))
    half = np.empty((nz, nz))
    for b in range(B):
        _sandwiched(of_y[T - 1, b], unit[0], half, D[b])
        _sandwiched(after[T - 1, b], unit[0], half, P_s[T - 1, b])
    d = by_y[T - 1].copy()  # E(xi_t | y_{1:T})
    x = np.empty(nz)
    for t in range(T - 2, -1, -1):
        for b in range(B):
            F, S = of_next[t, b], left[t, b]
            _sandwiched(F, D[b], half, cov)
            for r in range(nz):
                for c in range(nz):
                    s = 0.0
                    for k in range(nz):
                        s += half[r, k] * before[t + 1, b, c, k]
                    M_s[t, b, r, c] = s  # in units of P_{t|t} as yet
                    s = 0.0
                    for k in range(min(r, c) + 1):
                        s += S[r, k] * S[c, k]
                    cov[r, c] += s
            for c in range(nz):
                for r in range(nz - 1, -1, -1):
                    s = 0.0
                    for k in range(r + 1):
                        s += after[t, b, r, k] * M_s[t, b, k, c]
                    M_s[t, b, r, c] = s
            _sandwiched(after[t, b], cov, half, P_s[t, b])
            _sandwiched(of_y[t, b], cov, half, D[b])
        for j in range(N):
            b = j if B > 1 else 0
            for k in range(nz):
                s = by_a[t, j, k]
                for c in range(nz):
                    s += of_next[t, b, k, c] * d[j, c]
                x[k] = s
            for k in range(nz):
                s, own = z_s[t, j, k], by_y[t, j, k]
                for c in range(k + 1):
                    s += after[t, b, k, c] * x[c]
                    own += of_y[t, b, k, c] * x[c]
                z_s[t, j, k], d[j, k] = s, own
    return z_s, P_s, M_s


@njit(cache=True, error_model="numpy")
def _every(matrix, out):
    """Out (B', n, n) = matrix (B, n, n), which may be common to all."""
    for b in range(out.shape[0]):
        out[b] = matrix[b if matrix.shape[0] > 1 else 0]


@njit(cache=True, error_model="numpy")
def _moved(value, matrix, z):
    """value + matrix z for rows: value (N, n), matrix (B, n, nz), z (N, nz)."""
    out = value.copy()
    for j in range(value.shape[0]):
        b = j if matrix.shape[0] > 1 else 0
        for r in range(value.shape[1]):
            s = out[j, r]
            for k in range(z.shape[1]):
                s += matrix[b, r, k] * z[j, k]
            out[j, r] = s
    return out


@njit(cache=True, error_model="numpy")
def _times(matrix, root):
    """matrix root (B, n, nz) of matrix (B, n, nz) and lower triangular root (B, nz, nz)."""
    n, nz = matrix.shape[1], matrix.shape[2]
    B = max(matrix.shape[0], root.shape[0])
    out = np.empty((B, n, nz))
    for b in range(B):
        m = matrix[b if matrix.shape[0] > 1 else 0]
        Z = root[b if root.shape[0] > 1 else 0]
        for r in range(n):
            for c in range(nz):
                s = 0.0
                for k in range(c, nz):
                    s += m[r, k] * Z[k, c]
                out[b, r, c] = s
    return out


@njit(cache=True, error_model="numpy")
def _sandwiched(F, D, half, out):
    """Out (n, n) = F D F', symmetric to the last bit, with half = F D."""
    n = F.shape[0]
    for r in range(n):
        for c in range(n):
            s = 0.0
            for k in range(n):
                s += F[r, k] * D[k, c]
            half[r, c] = s
        for c in range(r + 1):
            s = 0.0
            for k in range(n):
                s += half[r, k] * F[c, k]
            out[r, c] = s
            out[c, r] = s
