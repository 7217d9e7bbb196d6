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
def footprints(F, H, K, b, e, gate):
    """g (T, n, ny) of n changes; F (T-1, nx, nx), H (T, ny, nx), K (T, nx, ny).

    b (T-1, nx) and e (T, ny) are one driver, ``gate`` (T, n) the factor it has in each change.
    """
    T, ny, nx = H.shape
    n = gate.shape[1]
    g = np.empty((T, n, ny))
    xi = np.zeros((n, nx))
    v = np.empty(nx)
    for t in range(T):
        for k in range(n):
            w = gate[t, k]
            for i in range(ny):
                s = e[t, i] * w
                for j in range(nx):
                    s += H[t, i, j] * xi[k, j]
                g[t, k, i] = s
            if t == T - 1:
                continue
            for j in range(nx):
                s = xi[k, j]
                for i in range(ny):
                    s -= K[t, j, i] * g[t, k, i]
                v[j] = s
            for j in range(nx):
                s = b[t, j] * w
                for i in range(nx):
                    s += F[t, j, i] * v[i]
                xi[k, j] = s
    return g


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
    T, ny, _ = H.shape
    g = np.empty((T, ny))
    dS = np.empty((T, ny, ny))
    dx = dm.copy()
    dP = dV.copy()
    for t in range(T):
        Ht = np.ascontiguousarray(H[t])
        Kt = np.ascontiguousarray(K[t])
        g[t] = Ht @ dx + e[t]
        dC = dP @ Ht.T
        dS[t] = Ht @ dC + dR[t]
        if t < T - 1:
            dC += dX[t]
            Ft = np.ascontiguousarray(F[t])
            dK = (dC - Kt @ dS[t]) @ np.ascontiguousarray(precision[t])
            CK = dC @ Kt.T
            dx = Ft @ (dx + dK @ nu[t] - Kt @ g[t]) + b[t]
            dP = Ft @ (dP - CK - CK.T + Kt @ dS[t] @ Kt.T) @ Ft.T + dQ[t]
            dP = 0.5 * (dP + dP.T)  # the recursion amplifies what rounding makes unsymmetric
    return g, dS
