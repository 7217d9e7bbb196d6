"""Linear recursions along a trajectory: Newton's correction of all its states, and derivatives.

Both are x_{t+1} = J_t x_t + b_t with J_t = dF/dx at time t. Before them what its differences are made of.
"""

from __future__ import annotations

import numpy as np
from numba import njit

EPS = np.finfo(np.float64).eps
NOTHING = 1e-30  # of a state's scale: what decays further is zero, as denormal numbers are slow


@njit(cache=True, error_model="numpy")
def displaced(x, na, i, share, of_value, size):
    """The first na states of x (n, nx) with state i moved by share * size, and by how much it really was (n,).

    At least by ``of_value`` of its value; size (n, nx). Forwards or backwards, as share is.
    """
    n = len(x)
    a = np.empty((n, na))
    up = np.empty(n)
    for t in range(n):
        for j in range(na):
            a[t, j] = x[t, j]
        step = max(abs(share) * size[t, i], of_value * abs(x[t, i]))
        a[t, i] += step if share > 0.0 else -step
        up[t] = a[t, i] - x[t, i]
    return a, up


@njit(cache=True, error_model="numpy")
def fill_column(J, i, ahead, value, up):
    """J[:, :, i] = (ahead - value) / up; whether all is finite. J (n, m, nx), values (n, m), up (n,)."""
    finite = True
    for t in range(len(up)):
        for k in range(J.shape[1]):
            J[t, k, i] = (ahead[t, k] - value[t, k]) / up[t]
            finite = finite and np.isfinite(J[t, k, i])
    return finite


@njit(cache=True, error_model="numpy")
def correct(X, F, J, first, size, carried, tolerance, floor):
    """Newton's correction of a trajectory, in place; how much of it is the run.

    With the defects r_t = F_t - X_{t+1} the correction is

        d_{t+1} = J_t d_t + r_t,    d_1 = 0,    X_t := X_t + d_t.

    Beside it run what rounding errors grow to, c_{t+1} = J_t c_t +- eps max |X| with random signs, and the
    scale s_t of each state: how far it has moved from ``first`` until t, at least ``size``.

    Parameters
    ----------
    X : (n + 1, nx)
        The trajectory, X[0] exact. From the first row on whose correction is not finite, the last finite
        row is held.
    F, J : (n, nx), (n, nx, nx)
        The step from X[:-1] and its derivative.
    first, size : (nx,)
        Where the record began, and the least scale of each state.
    carried : (nx,)
        c at X[0].
    tolerance, floor : float
        A row is right where |d| <= tolerance * s + floor * |X| in all states.

    Returns
    -------
    right : int
        The first row that is not right; n + 1 where all are.
    finite : int
        The first row that is not finite; n + 1 where all are.
    steady : bool
        Whether rounding stays within the same tolerance up to there.
    most : float
        The largest |d| / s.
    s, c : (n + 1, nx)
        The scales and what rounding errors have grown to, c up to the row ``right``.

    """
    n, nx = F.shape
    s = np.empty((n + 1, nx))
    c = np.zeros((n + 1, nx))
    d = np.zeros(nx)
    e = np.zeros(nx)
    top = np.abs(X[0])
    sign = np.uint32(1)
    for i in range(nx):
        s[0, i] = max(size[i], abs(X[0, i] - first[i]))
        c[0, i] = carried[i]
    right, finite, steady, most = n + 1, n + 1, True, 0.0
    for t in range(n):
        close, whole, calm = True, True, True
        for i in range(nx):
            x = F[t, i] - X[t + 1, i]
            for j in range(nx):
                if d[j] != 0.0:
                    x += J[t, i, j] * d[j]
            e[i] = x
            whole = whole and np.isfinite(x)
        if not whole:
            finite = t + 1
            right = min(right, finite)
            break
        for i in range(nx):
            d[i] = e[i] if abs(e[i]) > NOTHING * s[t, i] else 0.0
            X[t + 1, i] += d[i]
            size_here = abs(X[t + 1, i])
            s[t + 1, i] = max(s[t, i], abs(X[t + 1, i] - first[i]))
            if abs(d[i]) > most * s[t + 1, i]:
                most = abs(d[i]) / s[t + 1, i]
            allowed = tolerance * s[t + 1, i] + floor * size_here
            close = close and abs(d[i]) <= allowed
            top[i] = max(top[i], size_here)
            if right <= t + 1:
                continue  # of no use behind what is not right
            sign = np.uint32(sign * np.uint32(1664525) + np.uint32(1013904223))
            w = EPS * top[i] if sign >> np.uint32(31) else -EPS * top[i]
            for j in range(nx):
                w += J[t, i, j] * c[t, j]
            c[t + 1, i] = w
            calm = calm and abs(w) <= allowed
        if right > t + 1:
            if not close:
                right = t + 1
            elif not calm:
                steady = False
    for t in range(finite, n + 1):
        X[t] = X[finite - 1]
        s[t] = s[finite - 1]
    return right, finite, steady, most, s, c


@njit(cache=True, error_model="numpy")
def carry(J, b, first):
    """xi_{t+1} = J_t xi_t + b_t of n columns at once, xi_1 = ``first``.

    J (T-1, nx, nx), b (T-1, nx, n), first (nx, n) -> xi (T, nx, n).
    """
    steps, nx, n = b.shape
    xi = np.empty((steps + 1, nx, n))
    xi[0] = first
    for t in range(steps):
        for i in range(nx):
            for k in range(n):
                xi[t + 1, i, k] = b[t, i, k]
            for j in range(nx):
                w = J[t, i, j]
                if w != 0.0:
                    for k in range(n):
                        xi[t + 1, i, k] += w * xi[t, j, k]
    return xi
