"""Footprints of small additive changes on the innovations of a filter.

A change adds b_t to x_{t+1} and e_t to y_t. To first order the one-step prediction then misses

    g_t      = H_t xi_t + e_t
    xi_{t+1} = F_t (xi_t - K_t g_t) + b_t,      xi_1 = 0,

where xi is what the filter does not yet know of the change.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def footprints(F, H, K, root, z, b, e, gate):
    """What n changes add to the whitened innovations, (n, T, ny), and its products with them, (n, T).

    F (T-1, nx, nx), H (T, ny, nx), K (T, nx, ny); ``root`` = S^{-1/2} (T, ny, ny), z = S^{-1/2} nu (T, ny).
    b (T-1, nx) and e (T, ny) are one driver, ``gate`` (T, n) the factor it has in each change. Zero where it is
    no number.
    """
    T, ny, nx = H.shape
    n = gate.shape[1]
    added, products = np.zeros((n, T, ny)), np.zeros((n, T))
    begin = 0
    while begin < T and not gate[begin].any():
        begin += 1
    # the changes side by side: loops over them are made of vector instructions
    xi, g, v, one = np.zeros((nx, n)), np.empty((ny, n)), np.empty((nx, n)), np.empty(n)
    for t in range(begin, T):
        for i in range(ny):
            for k in range(n):
                g[i, k] = e[t, i] * gate[t, k]
            for j in range(nx):
                for k in range(n):
                    g[i, k] += H[t, i, j] * xi[j, k]
        for p in range(ny):
            one[:] = 0.0
            for i in range(ny):
                for k in range(n):
                    one[k] -= root[t, p, i] * g[i, k] if g[i, k] == g[i, k] else 0.0
            for k in range(n):
                added[k, t, p] = one[k]
                products[k, t] -= one[k] * z[t, p]
        if t == T - 1:
            break
        for j in range(nx):
            for k in range(n):
                v[j, k] = xi[j, k]
            for i in range(ny):
                for k in range(n):
                    v[j, k] -= K[t, j, i] * g[i, k]
        for j in range(nx):
            for k in range(n):
                xi[j, k] = b[t, j] * gate[t, k]
            for i in range(nx):
                for k in range(n):
                    xi[j, k] += F[t, j, i] * v[i, k]
    return added, products


@njit(cache=True, error_model="numpy")
def sensitivities(F, H, K, precision, nu, b, e, dQ, dR, dX, dm, dV):
    """Derivatives of a filter's predictions by one parameter of its model.

    ``precision`` (T, ny, ny) = S^{-1} with zeros for missing channels, ``nu`` (T, ny) with zeros there. The
    rest is what the parameter changes in one step from given moments: b (T-1, nx), dQ (T-1, nx, nx) in
    mean and covariance of x_{t+1}; e (T, ny), dR (T, ny, ny), dX (T, nx, ny) in mean and covariance of y_t
    and in Cov(x_t, y_t); dm (nx,), dV (nx, nx) in mean and covariance of x_1. Returns g (T, ny), the
    derivative of the predicted y (minus that of nu), and dS (T, ny, ny). With dx, dP the derivatives of the
    predicted moments,

        g = H dx + e,    dS = H dP H' + dR,    dC = dP H' + dX,    dK = (dC - K dS) S^{-1},
        dx' = F (dx + dK nu - K g) + b,    dP' = F (dP - dC K' - K dC' + K dS K') F' + dQ.
    """
    T, ny, nx = H.shape
    g, dS = np.empty((T, ny)), np.empty((T, ny, ny))
    dx, dP = dm.copy(), dV.copy()
    v, dC, KdS = np.empty(nx), np.empty((nx, ny)), np.empty((nx, ny))
    M, FM = np.empty((nx, nx)), np.empty((nx, nx))
    # written out, as a call for each of such small products takes longer than they do
    for t in range(T):
        for p in range(ny):
            s = e[t, p]
            for i in range(nx):
                s += H[t, p, i] * dx[i]
            g[t, p] = s
        for i in range(nx):
            for p in range(ny):
                s = 0.0
                for j in range(nx):
                    s += dP[i, j] * H[t, p, j]
                dC[i, p] = s
        for p in range(ny):
            for q in range(ny):
                s = dR[t, p, q]
                for i in range(nx):
                    s += H[t, p, i] * dC[i, q]
                dS[t, p, q] = s
        if t == T - 1:
            continue
        for i in range(nx):
            for p in range(ny):
                s = 0.0
                for q in range(ny):
                    s += K[t, i, q] * dS[t, q, p]
                KdS[i, p] = s
                dC[i, p] += dX[t, i, p]
        for i in range(nx):  # v = dx + dK nu - K g
            s = dx[i]
            for p in range(ny):
                s -= K[t, i, p] * g[t, p]
                for q in range(ny):
                    s += (dC[i, p] - KdS[i, p]) * precision[t, p, q] * nu[t, q]
            v[i] = s
        for i in range(nx):  # M = dP - dC K' - K dC' + K dS K', symmetric whatever rounding does
            for j in range(i + 1):
                s = 0.5 * (dP[i, j] + dP[j, i])
                for p in range(ny):
                    s += KdS[i, p] * K[t, j, p] - dC[i, p] * K[t, j, p] - dC[j, p] * K[t, i, p]
                M[i, j] = s
                M[j, i] = s
        for i in range(nx):
            s = b[t, i]
            for j in range(nx):
                s += F[t, i, j] * v[j]
            dx[i] = s
            for j in range(nx):
                s = 0.0
                for r in range(nx):
                    s += F[t, i, r] * M[r, j]
                FM[i, j] = s
        for i in range(nx):
            for j in range(i + 1):
                s = 0.5 * (dQ[t, i, j] + dQ[t, j, i])
                for r in range(nx):
                    s += FM[i, r] * F[t, j, r]
                dP[i, j] = s
                dP[j, i] = s
    return g, dS
