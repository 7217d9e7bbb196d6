"""Matrix exponentials and the integrals of van Loan; see :mod:`engine.statespace.discretization`."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

LONGEST = 0.5  # h |F| of the step over which the series are summed
MOST_STATES_APART = 4  # links of a chain of states through which noise is followed to rounding
MOST_ORDERS = 24
ROUNDING = 2.0**-54
MOST_HALVINGS = 1000
SWEEPS = 12  # of balancing, at most
NEAR = 1.25  # times the norm of the system before: its units will do ...
FEW = 2.0**10  # ... for steps of no more parts than this: each halving costs a binary digit
BLOCK = 64  # systems side by side: loops over them are made of vector instructions


def _limits():
    """[d, p]: h |F| up to which p orders of the series of Q are enough, where noise is d orders away.

    An entry of Q that noise first reaches in order d has further terms that fall at least as
    (2 h |F|)^j (d+1)! / (d+1+j)!.
    """
    out = np.zeros((2 * MOST_STATES_APART + 1, MOST_ORDERS + 1))
    for d in range(len(out)):
        for p in range(d + 1, MOST_ORDERS + 1):
            rest = ROUNDING * math.factorial(p + 1) / math.factorial(d + 1)
            out[d, p] = 0.5 * rest ** (1.0 / (p - d))
    return out


LIMITS = _limits()


@njit(cache=True, error_model="numpy")
def van_loan(F, G, Qc, dt):
    """A (K, n, n), B (K, n, m), Q (K, n, n) of F (K, n, n), G (K, n, m), symmetric Qc (K, n, n), dt (K,)."""
    K, n, m = F.shape[0], F.shape[1], G.shape[2]
    A, B, Q = np.empty((K, n, n)), np.empty((K, n, m)), np.empty((K, n, n))
    width = min(K, BLOCK)
    F_, G_, S_ = np.empty((n, n, width)), np.empty((n, m, width)), np.empty((n, n, width))
    steps = np.empty(width)
    for first in range(0, K, width):
        count = min(width, K - first)
        for k in range(count):
            steps[k] = dt[first + k]
            for i in range(n):
                for j in range(n):
                    F_[i, j, k], S_[i, j, k] = F[first + k, i, j], Qc[first + k, i, j]
                for j in range(m):
                    G_[i, j, k] = G[first + k, i, j]
        A_, B_, Q_ = integrals(F_, G_, S_, steps, count, True)
        for k in range(count):
            for i in range(n):
                for j in range(n):
                    A[first + k, i, j], Q[first + k, i, j] = A_[i, j, k], Q_[i, j, k]
                for j in range(m):
                    B[first + k, i, j] = B_[i, j, k]
    return A, B, Q


@njit(cache=True, error_model="numpy")
def integrals(F, G, Qc, dt, count, with_A):
    """A (n, n, K), B (n, m, K), Q (n, n, K) of ``count`` of K systems: F, Qc (n, n, K), G (n, m, K), dt (K,).

    A is empty unless asked for ``with_A`` or needed, as where a step is halved.
    """
    n = len(F)
    h, halvings = np.empty(count), np.zeros(count, dtype=np.int64)
    units, known = np.ones(n), 0.0
    largest, most = 0.0, 0
    for k in range(count):
        norm = 0.0  # the largest sum of absolute values of a row
        for i in range(n):
            row = 0.0
            for j in range(n):
                row += abs(F[i, j, k])
            if not row <= norm:  # also where it is NaN
                norm = row
        stiffness = dt[k] * norm
        if LONGEST < stiffness < np.inf:  # seldom: it is worth to look whether units make it so
            balanced, short = _norm_in(units, F[:, :, k]), LONGEST / dt[k]
            near = max(min(NEAR * known, FEW * short), short)
            if not balanced <= near:  # the last system's units are no longer good
                balanced = _balanced_norm(F[:, :, k], dt[k], units)
                known = balanced if balanced < np.inf else 0.0
            stiffness = dt[k] * min(norm, balanced)
        if stiffness > LONGEST and stiffness < 2.0**MOST_HALVINGS:
            halvings[k] = math.ceil(math.log2(stiffness / LONGEST))
            most = max(most, halvings[k])
        elif not stiffness <= LONGEST:
            dt[k] = np.nan
        half = 2.0 ** -halvings[k]
        h[k] = dt[k] * half
        largest = max(largest, stiffness * half)
    orders = _orders(n, largest)
    noisy = (Qc[:, :, :count] != 0.0).any()
    with_A = with_A or most > 0
    A, B, Q = _series(F, G, Qc, h, orders, noisy, with_A)
    for done in range(most):
        _double(A, B, Q, halvings > done, noisy)
    return A, B, Q


@njit(cache=True, error_model="numpy")
def _orders(n, stiffness):
    """How many orders of the series are summed."""
    limits = LIMITS[2 * min(n - 1, MOST_STATES_APART)]
    for orders in range(1, MOST_ORDERS):
        if stiffness <= limits[orders]:
            return orders
    return MOST_ORDERS


@njit(cache=True, error_model="numpy")
def _series(F, G, Qc, h, orders, noisy, with_A):
    """A, B, Q over the steps h (K,), so many orders of each; A empty unless asked for ``with_A``."""
    n, m, K = G.shape[0], G.shape[1], len(h)
    N = n if with_A else 0
    A, B, Q = np.zeros((N, N, K)), np.empty((n, m, K)), np.empty((n, n, K))
    power, pushed, term = np.zeros((N, N, K)), np.empty((n, m, K)), np.empty((n, n, K))
    next_power, next_pushed, next_term = np.empty_like(A), np.empty_like(B), np.empty_like(Q)
    share = np.empty(K)
    for i in range(n):
        for k in range(K):
            for j in range(m):
                pushed[i, j, k] = B[i, j, k] = h[k] * G[i, j, k]
            for j in range(n):
                term[i, j, k] = Q[i, j, k] = h[k] * Qc[i, j, k]
            if with_A:
                power[i, i, k] = A[i, i, k] = 1.0
    for order in range(1, orders):
        if with_A:
            for k in range(K):
                share[k] = h[k] / order
            _multiply(F, power, K, next_power)
            _add(next_power, share, power, A)
        for k in range(K):
            share[k] = h[k] / (order + 1)
        _multiply(F, pushed, K, next_pushed)
        _add(next_pushed, share, pushed, B)
        if noisy:
            _multiply(F, term, K, next_term)
            for i in range(n):  # F S + S F' of a symmetric S
                for j in range(i + 1):
                    for k in range(K):
                        both = share[k] * (next_term[i, j, k] + next_term[j, i, k])
                        term[i, j, k] = both
                        term[j, i, k] = both
                        Q[i, j, k] += both
                    if j < i:
                        for k in range(K):
                            Q[j, i, k] = Q[i, j, k]
    return A, B, Q


@njit(cache=True, error_model="numpy")
def _double(A, B, Q, more, noisy):
    """A, B, Q of twice the step, in place, of those systems that need ``more`` (K,)."""
    n, _, K = B.shape
    drive, product, square = np.empty_like(B), np.empty_like(A), np.empty_like(A)
    _multiply(A, B, K, drive)
    _add_where(drive, more, B)
    if noisy:
        _multiply(A, Q, K, product)
        for i in range(n):
            for j in range(i + 1):
                for k in range(K):
                    square[i, j, k] = 0.0
                for r in range(n):
                    for k in range(K):
                        square[i, j, k] += product[i, r, k] * A[j, r, k]
                for k in range(K):
                    square[j, i, k] = square[i, j, k]
        _add_where(square, more, Q)
    _multiply(A, A, K, square)
    for i in range(n):
        for j in range(n):
            for k in range(K):
                A[i, j, k] = square[i, j, k] if more[k] else A[i, j, k]


@njit(cache=True, error_model="numpy")
def _multiply(X, Y, K, out):
    """out = X Y, of K systems side by side."""
    for i in range(X.shape[0]):
        for j in range(Y.shape[1]):
            for k in range(K):
                out[i, j, k] = X[i, 0, k] * Y[0, j, k]
            for r in range(1, X.shape[1]):
                for k in range(K):
                    out[i, j, k] += X[i, r, k] * Y[r, j, k]


@njit(cache=True, error_model="numpy")
def _add(following, share, term, total):
    """The next term of a series, and the sum with it."""
    for i in range(term.shape[0]):
        for j in range(term.shape[1]):
            for k in range(len(share)):
                one = share[k] * following[i, j, k]
                term[i, j, k] = one
                total[i, j, k] += one


@njit(cache=True, error_model="numpy")
def _add_where(what, more, total):
    for i in range(total.shape[0]):
        for j in range(total.shape[1]):
            for k in range(len(more)):
                total[i, j, k] += what[i, j, k] if more[k] else 0.0


@njit(cache=True, error_model="numpy")
def _norm_in(units, F):
    """The norm of D^-1 F D, D = diag(``units``)."""
    norm = 0.0
    for i in range(len(F)):
        row = 0.0
        for j in range(len(F)):
            row += abs(F[i, j]) * units[j]
        row /= units[i]
        if not row <= norm:
            norm = row
    return norm


@njit(cache=True, error_model="numpy")
def _balanced_norm(F, dt, units):
    """The norm of F in ``units`` (n,) of the states in which it is small: D^-1 F D with D of powers of two.

    The series and their doubling are the same in any such units, to the last bit, so that only the norm of F
    need be known in them. Rows and columns are made equally large (Parlett, Reinsch 1969), as far as they
    are not small beside a step.
    """
    n = len(F)
    scaled = F.copy()
    units[:] = 1.0
    small = 0.25 * LONGEST / (n * dt)
    for _ in range(SWEEPS):
        moved = False
        for i in range(n):
            row, column = 0.0, 0.0
            for j in range(n):
                if j != i:
                    row += abs(scaled[i, j])
                    column += abs(scaled[j, i])
            if row == column or max(row, column) <= small:
                continue
            factor = math.sqrt(max(row, small) / max(column, small))
            if not 0.0 < factor < np.inf:
                continue
            factor = 2.0 ** round(math.log2(factor))
            if factor == 1.0:
                continue
            moved = True
            units[i] *= factor
            for j in range(n):
                if j != i:
                    scaled[i, j] /= factor
                    scaled[j, i] *= factor
        if not moved:
            break
    return _norm_in(units, F)
