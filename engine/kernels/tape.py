"""A tape of operations gone through for many rows at once.

A tape (A. Griewank, A. Walther, Evaluating Derivatives, 2nd ed. 2008, ch. 4) is what a model's function
calculates, one operation a line: a code, up to three operands and the result, each a row of the work space
W (., M). What it does to M rows of states takes no call of the function (:mod:`engine.statespace.tape`).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from engine.kernels.van_loan import BLOCK, integrals

# Codes of operations: functions of NumPy by their names, and what else there is.
NAMES = """
    add subtract multiply true_divide negative power square sqrt exp log sin cos tanh absolute sign
    maximum minimum where less less_equal greater greater_equal equal not_equal logical_and
    logical_or logical_not tan arctan arctan2 arcsin arccos sinh cosh expm1 log1p log10 log2 exp2
    hypot remainder fmod floor ceil rint trunc copysign reciprocal isfinite isnan erf floor_divide
    fmax fmin heaviside cbrt arcsinh arccosh arctanh expit check_finite over_a_step interp before up_to entry
    holds fails
""".split()  # noqa: SIM905
CODES = {name: code for code, name in enumerate(NAMES)}
(
    ADD, SUBTRACT, MULTIPLY, TRUE_DIVIDE, NEGATIVE, POWER, SQUARE, SQRT, EXP, LOG, SIN, COS,
    TANH, ABSOLUTE, SIGN, MAXIMUM, MINIMUM, WHERE, LESS, LESS_EQUAL, GREATER, GREATER_EQUAL,
    EQUAL, NOT_EQUAL, LOGICAL_AND, LOGICAL_OR, LOGICAL_NOT, TAN, ARCTAN, ARCTAN2, ARCSIN,
    ARCCOS, SINH, COSH, EXPM1, LOG1P, LOG10, LOG2, EXP2, HYPOT, REMAINDER, FMOD, FLOOR, CEIL,
    RINT, TRUNC, COPYSIGN, RECIPROCAL, ISFINITE, ISNAN, ERF, FLOOR_DIVIDE, FMAX, FMIN, HEAVISIDE,
    CBRT, ARCSINH, ARCCOSH, ARCTANH, EXPIT, CHECK_FINITE, OVER_A_STEP, INTERP, BEFORE, UP_TO,
    ENTRY, HOLDS, FAILS,
) = range(len(NAMES))  # fmt: skip


@njit(cache=True, error_model="numpy")
def go_through(tape, links, W, lost):
    """Do the operations (n, 5): code, three operands, result; whether all conditions are as they were recorded.

    ``links`` (k, .) are the operands of those that take matrices. ``lost`` are the number of states, the first
    rows of W, and marks (M,): of rows whose states are no numbers, and which another condition would hold for.
    """
    M = W.shape[1]
    for line in range(tape.shape[0]):
        code = tape[line, 0]
        # rows by their numbers: a view of each, counted wherever it goes, takes longer than the operation
        x, y, z, out = tape[line, 1], tape[line, 2], tape[line, 3], tape[line, 4]
        if code <= WHERE:
            if code == ADD:
                for m in range(M):
                    W[out, m] = W[x, m] + W[y, m]
            elif code == SUBTRACT:
                for m in range(M):
                    W[out, m] = W[x, m] - W[y, m]
            elif code == MULTIPLY:
                for m in range(M):
                    W[out, m] = W[x, m] * W[y, m]
            elif code == TRUE_DIVIDE:
                for m in range(M):
                    W[out, m] = W[x, m] / W[y, m]
            elif code == NEGATIVE:
                for m in range(M):
                    W[out, m] = -W[x, m]
            elif code == POWER:
                for m in range(M):
                    W[out, m] = W[x, m] ** W[y, m]
            elif code == SQUARE:
                for m in range(M):
                    W[out, m] = W[x, m] * W[x, m]
            elif code == SQRT:
                for m in range(M):
                    W[out, m] = math.sqrt(W[x, m]) if W[x, m] >= 0.0 else np.nan
            elif code == EXP:
                for m in range(M):
                    W[out, m] = np.exp(W[x, m])
            elif code == LOG:
                for m in range(M):
                    W[out, m] = np.log(W[x, m])
            elif code == SIN:
                for m in range(M):
                    W[out, m] = np.sin(W[x, m])
            elif code == COS:
                for m in range(M):
                    W[out, m] = np.cos(W[x, m])
            elif code == TANH:
                for m in range(M):
                    W[out, m] = np.tanh(W[x, m])
            elif code == ABSOLUTE:
                for m in range(M):
                    W[out, m] = abs(W[x, m])
            elif code == SIGN:
                for m in range(M):
                    W[out, m] = np.sign(W[x, m])
            elif code == MAXIMUM:
                for m in range(M):
                    W[out, m] = np.maximum(W[x, m], W[y, m])
            elif code == MINIMUM:
                for m in range(M):
                    W[out, m] = np.minimum(W[x, m], W[y, m])
            else:
                for m in range(M):
                    W[out, m] = W[y, m] if W[x, m] != 0.0 else W[z, m]
        elif code <= LOGICAL_NOT:
            for m in range(M):
                if code == LESS:
                    true = W[x, m] < W[y, m]
                elif code == LESS_EQUAL:
                    true = W[x, m] <= W[y, m]
                elif code == GREATER:
                    true = W[x, m] > W[y, m]
                elif code == GREATER_EQUAL:
                    true = W[x, m] >= W[y, m]
                elif code == EQUAL:
                    true = W[x, m] == W[y, m]
                elif code == NOT_EQUAL:
                    true = W[x, m] != W[y, m]
                elif code == LOGICAL_AND:
                    true = W[x, m] != 0.0 and W[y, m] != 0.0
                elif code == LOGICAL_OR:
                    true = W[x, m] != 0.0 or W[y, m] != 0.0
                else:
                    true = W[x, m] == 0.0
                W[out, m] = 1.0 if true else 0.0
        elif code == CHECK_FINITE:
            for m in range(M):
                if not (math.isfinite(W[x, m]) or _is_lost(m, W, lost)):
                    return False
                W[out, m] = W[x, m]
        elif code >= HOLDS:
            for m in range(M):
                if (W[x, m] != 0.0) != (code == HOLDS) and not _is_lost(m, W, lost):
                    return False
        elif code == OVER_A_STEP:
            _over_a_step(links[tape[line, 1]], W)
        elif code == INTERP:
            _interp(links[tape[line, 1]], W, out)
        elif code == ENTRY:
            if not _entry(links[tape[line, 1]], W, out, lost):
                return False
        elif code >= BEFORE:
            if not _searched(links[tape[line, 1]], W, out, code == UP_TO, lost):
                return False
        else:
            for m in range(M):
                W[out, m] = _seldom(code, W[x, m], W[y, m])
    return True


@njit(cache=True, error_model="numpy")
def _is_lost(m, W, lost):
    """Whether row m has states that are no numbers, the first rows of W; it is marked then."""
    na, marks = lost
    for i in range(na):
        if not math.isfinite(W[i, m]):
            marks[m] = True
    return marks[m]


@njit(cache=True, error_model="numpy")
def _over_a_step(link, W):
    """A_d, B, Q of F, G, Qc, dt for each row; ``link``: n, m, their rows of W, the first of the results'.

    Last whether A_d is used, whose rows of W are left as they are if not.
    Rows that have them from the row before, as all of one filter where no state changes them, are found once.
    """
    n, m, M = link[0], link[1], W.shape[1]
    size, wide = n * n, n * m
    first, with_A = link[3 + 2 * size + wide], link[4 + 2 * size + wide] != 0
    F_, G_, S_, dt_ = link[2:], link[2 + size :], link[2 + size + wide :], link[2 + 2 * size + wide]
    leads, which = _distinct(link[2 : 3 + 2 * size + wide], W)
    width = min(len(leads), BLOCK)
    F, S, G = np.empty((n, n, width)), np.empty((n, n, width)), np.empty((n, m, width))
    steps = np.empty(width)
    for start in range(0, len(leads), width):
        count = min(width, len(leads) - start)
        lost = np.zeros(count, dtype=np.bool_)
        for k in range(count):
            row, total = leads[start + k], 0.0
            for i in range(n):
                for j in range(n):
                    F[i, j, k] = W[F_[i * n + j], row]
                    S[i, j, k] = 0.5 * (W[S_[i * n + j], row] + W[S_[j * n + i], row])
                    total += abs(F[i, j, k]) + abs(S[i, j, k])
                for j in range(m):
                    G[i, j, k] = W[G_[i * m + j], row]
                    total += abs(G[i, j, k])
            steps[k] = W[dt_, row]
            lost[k] = not total < np.inf
            if lost[k]:  # it takes no other row with it
                F[:, :, k], S[:, :, k], G[:, :, k] = 0.0, 0.0, 0.0
        A, B, Q = integrals(F, G, S, steps, count, with_A)
        end = leads[start + count] if start + count < len(leads) else M
        for row in range(leads[start], end):
            k = which[row] - start
            for i in range(n):
                for j in range(n):
                    if with_A:
                        W[first + i * n + j, row] = np.nan if lost[k] else A[i, j, k]
                    W[first + size + wide + i * n + j, row] = np.nan if lost[k] else Q[i, j, k]
                for j in range(m):
                    W[first + size + i * m + j, row] = np.nan if lost[k] else B[i, j, k]


@njit(cache=True, error_model="numpy")
def _interp(link, W, out):
    """``np.interp`` for each row; ``link``: n, the row of W that has x, those of n points and of n heights."""
    n, x_ = link[0], link[1]
    points, heights = link[2 : 2 + n], link[2 + n : 2 + 2 * n]
    for m in range(W.shape[1]):
        x = W[x_, m]
        if not x < W[points[n - 1], m]:
            W[out, m] = W[heights[n - 1], m] if x == x else np.nan
        elif x < W[points[0], m]:
            W[out, m] = W[heights[0], m]
        else:
            i, j = 0, n - 1
            while j - i > 1:
                k = (i + j) // 2
                if x < W[points[k], m]:
                    j = k
                else:
                    i = k
            low, left = W[heights[i], m], W[points[i], m]
            slope = (W[heights[j], m] - low) / (W[points[j], m] - left)
            W[out, m] = slope * (x - left) + low


@njit(cache=True, error_model="numpy")
def _searched(link, W, out, up_to, lost):
    """How many of n ordered points are before x, or ``up_to`` it; ``link``: n, the rows of x and of the points.

    Whether x is finite in all rows that are not lost.
    """
    n, x_ = link[0], link[1]
    for m in range(W.shape[1]):
        x = W[x_, m]
        if not (math.isfinite(x) or _is_lost(m, W, lost)):
            return False
        i, j = 0, n
        while i < j:
            k = (i + j) // 2
            point = W[link[2 + k], m]
            if point < x or (up_to and point == x):
                i = k + 1
            else:
                j = k
        W[out, m] = i
    return True


@njit(cache=True, error_model="numpy")
def _entry(link, W, out, lost):
    """The k-th of n entries, from the end where k < 0; ``link``: n, the row of W that has k, and theirs.

    Whether there is one, in all rows that are not lost.
    """
    n, k_ = link[0], link[1]
    for m in range(W.shape[1]):
        k = W[k_, m]
        if k >= -n and k < n and k == math.floor(k):
            W[out, m] = W[link[2 + (int(k) + n) % n], m]
        elif _is_lost(m, W, lost):
            W[out, m] = np.nan
        else:
            return False
    return True


@njit(cache=True, error_model="numpy")
def _distinct(operands, W):
    """Rows with other operands than the row before, and for each row (M,) which of them it has them from."""
    M = W.shape[1]
    leads, which, count = np.empty(M, dtype=np.int64), np.empty(M, dtype=np.int64), 0
    for row in range(M):
        new = row == 0
        for operand in operands:
            if new:
                break
            new = W[operand, row] != W[operand, row - 1]
        if new:
            leads[count] = row
            count += 1
        which[row] = count - 1
    return leads[:count], which


@njit(cache=True, error_model="numpy")
def _seldom(code, x, y):
    """One operation on one row that few models have."""
    if code == TAN:
        return np.tan(x)
    if code == ARCTAN:
        return np.arctan(x)
    if code == ARCTAN2:
        return np.arctan2(x, y)
    if code == ARCSIN:
        return np.arcsin(x)
    if code == ARCCOS:
        return np.arccos(x)
    if code == SINH:
        return np.sinh(x)
    if code == COSH:
        return np.cosh(x)
    if code == EXPM1:
        return np.expm1(x)
    if code == LOG1P:
        return np.log1p(x)
    if code == LOG10:
        return np.log10(x)
    if code == LOG2:
        return np.log2(x)
    if code == EXP2:
        return np.exp2(x)
    if code == HYPOT:
        return np.hypot(x, y)
    if code == REMAINDER:
        return np.remainder(x, y)
    if code == FMOD:
        return np.fmod(x, y)
    if code == FLOOR:
        return np.floor(x)
    if code == CEIL:
        return np.ceil(x)
    if code == RINT:
        return np.rint(x)
    if code == TRUNC:
        return np.trunc(x)
    if code == COPYSIGN:
        return np.copysign(x, y)
    if code == RECIPROCAL:
        return 1.0 / x
    if code == ISFINITE:
        return 1.0 if math.isfinite(x) else 0.0
    if code == ISNAN:
        return 1.0 if math.isnan(x) else 0.0
    if code == FLOOR_DIVIDE:
        return x // y
    if code == FMAX:
        return np.fmax(x, y)
    if code == FMIN:
        return np.fmin(x, y)
    if code == HEAVISIDE:
        return x if math.isnan(x) else 0.0 if x < 0.0 else y if x == 0.0 else 1.0
    if code == CBRT:
        return np.copysign(abs(x) ** (1.0 / 3.0), x)
    if code == ARCSINH:
        return np.arcsinh(x)
    if code == ARCCOSH:
        return np.arccosh(x)
    if code == ARCTANH:
        return np.arctanh(x)
    if code == EXPIT:
        return 1.0 / (1.0 + np.exp(-x))
    return math.erf(x)


@njit(cache=True, error_model="numpy")
def _put(places, W, into):
    """Entries of a result (1 or M, .): ``places`` (n, 2) say which, and the row of W that has them."""
    for n in range(places.shape[0]):
        entry, slot = places[n, 0], places[n, 1]
        for m in range(into.shape[0]):
            into[m, entry] = W[slot, m]


@njit(cache=True, error_model="numpy")
def evaluate(tape, links, W, places, into, a, u, t, dt):
    """One call: the states a (M, na), inputs u, t and dt to the head of W, through the tape, to the results.

    ``into`` are the three results, flat (1 or M, .), and ``places`` what of each is found anew.
    """
    M, na = a.shape
    for i in range(na):
        for m in range(M):
            W[i, m] = a[m, i]
    for m in range(M):
        for j in range(u.size):
            W[na + j, m] = u[j]
        W[na + u.size, m], W[na + u.size + 1, m] = t, dt
    lost = np.zeros(M, dtype=np.bool_)
    if not go_through(tape, links, W, (na, lost)):
        return False
    _put(places[0], W, into[0])
    _put(places[1], W, into[1])
    _put(places[2], W, into[2])
    for row in range(M):
        if lost[row]:
            into[0][row] = np.nan
    return True
