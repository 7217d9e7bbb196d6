"""How long the errors of a free run are remembered: an autoregression of each output's residuals.

Process noise adds up in a free run, and what remains after a fit is shorter and smaller than what the fit was
led astray by. So the autoregression is that of greatest restricted likelihood, which no part of the residuals
that the parameters could have taken up changes (Patterson and Thompson 1971): with Z = (e, J), c = (1, -phi)
and u = sum_i c_i L^i Z, where L shifts by a row and errors begin at zero, as the first state is fitted,

    2 l = -(n - n_p) log |u_e - u_J b|^2 - log |u_J' u_J|,      b by least squares.

Both logarithms are concave in what is quadratic in c, so that their tangents' minimum, a linear equation,
increases l (a minorization as in EM). All that it needs of n rows are products of Z with shifted ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_banded

from engine.statespace.model import Array

LONGEST = 8  # rows back, at most
PATIENCE = 3  # orders that are tried beyond the best
ROUNDS, PRECISE = 200, 1e-7  # of the ascent; change of 2 l at which it ends
FEW = 4  # rows a parameter: records with less are not asked what they take up of shared ones
SHARE = 1e-4  # of the size of phi: distance of difference quotients
LEAST = 0.02  # of the tangents' curvature: l has no less


@dataclass(frozen=True, eq=False)
class Memory:
    """An autoregression: ``phi`` (p,), and its covariance (p, p)."""

    phi: Array
    covariance: Array


def shocks(values: Array, phi: Array) -> Array:
    """What is new in values (n,) or (n, m) of consecutive rows of one record."""
    out = values.copy()
    for j, share in enumerate(phi, 1):
        out[j:] -= share * values[: len(values) - j]
    return out


def response(weights: Array, phi: Array) -> Array:
    """By how much each shock counts (n, m) in the sum of weights (n, m) times errors."""
    n, p = len(weights), min(len(phi), len(weights) - 1)
    bands = np.ones((p + 1, n))
    bands[:p] = -phi[:p][::-1, None]
    return np.asarray(solve_banded((0, p), bands, weights))


def memory_of(parts: Sequence[tuple[Array, Array]]) -> Memory:
    """That of residuals e (n,) with derivatives J (n, n_p) in each record.

    The order is that of Akaike's criterion, corrected for few rows.
    """
    n, size = sum(len(e) for e, _ in parts), np.sqrt(sum(float(e @ e) for e, _ in parts))
    none = Memory(np.zeros(0), np.zeros((0, 0)))
    bases = [_basis(own) for own in _taken_up([J for _, J in parts])]
    left = n - sum(basis.shape[1] for basis in bases)
    longest = min(LONGEST, left // 4)
    if longest < 1 or not size > 0.0:
        return none
    unit = np.sqrt(n) / size
    Z = [np.column_stack((e * unit, own)) for (e, _), own in zip(parts, bases, strict=True)]
    products = _products(Z, longest)
    phi, best, found = np.zeros(0), np.inf, np.zeros(0)
    for p in range(longest + 1):
        if p:
            phi = _greatest(products, np.append(phi, 0.0), left)
        value = _minus_twice(products, phi, left)[0]
        value += 2.0 * (p + 1) * left / max(left - p - 2, 1)
        if value < best:
            best, found = value, phi
        elif p >= len(found) + PATIENCE:
            break
    return Memory(found, _covariance(products, found, left)) if len(found) else none


def _taken_up(parts: Sequence[Array]) -> list[Array]:
    """The derivatives (n, .) that count in each record, as if parameters were its own: so records are apart.

    In records of few rows only what is their own anyway, as first states are: shared ones take up little there.
    """
    there = np.array([(J != 0.0).any(axis=0) for J in parts])
    alone = there & (there.sum(axis=0) == 1)
    return [
        J[:, own if len(J) >= FEW * own.sum() or len(parts) == 1 else first]
        for J, own, first in zip(parts, there, alone, strict=True)
    ]


def _basis(J: Array) -> Array:
    """Of its columns, as far as these are apart."""
    U, s, _ = np.linalg.svd(J, full_matrices=False)
    return np.asarray(U[:, s > 1e-9 * s.max(initial=0.0)])


def _products(parts: Sequence[Array], longest: int) -> Array:
    """(L^i Z)' (L^j Z) of each record as (S, i, j, m, m); columns that one does not have are as of length 1."""
    m = max(Z.shape[1] for Z in parts)
    out = np.zeros((len(parts), longest + 1, longest + 1, m, m))
    for own, Z in zip(out, parts, strict=True):
        n, k = Z.shape
        for i in range(min(longest + 1, n)):
            for j in range(i, min(longest + 1, n)):
                own[i, j, :k, :k] = Z[j - i : n - i].T @ Z[: n - j]
                own[j, i, :k, :k] = own[i, j, :k, :k].T
        own[0, 0, range(k, m), range(k, m)] = 1.0
    return out


def _minus_twice(products: Array, phi: Array, left: int) -> tuple[float, Array]:
    """-2 l, and Q (p + 1, p + 1) of its tangents: c' Q c and a constant touch it from above."""
    c = np.append(1.0, -phi)
    own = products[:, : len(c), : len(c)]
    W = np.einsum("i,j,sijab->sab", c, c, own)
    inverse = np.linalg.inv(W[:, 1:, 1:])
    v = np.concatenate(
        (np.ones((len(W), 1)), -np.einsum("sab,sb->sa", inverse, W[:, 1:, 0])), axis=1
    )
    squares = max(float(np.einsum("sa,sab,sb->", v, W, v)), np.finfo(float).tiny)
    Q = np.einsum("sa,sijab,sb->ij", v, own, v) * (left / squares)
    Q += np.einsum("sab,sijba->ij", inverse, own[:, :, :, 1:, 1:])
    value = left * np.log(squares) + np.linalg.slogdet(W[:, 1:, 1:])[1].sum()
    return float(value), 0.5 * (Q + Q.T)


def _greatest(products: Array, phi: Array, left: int) -> Array:
    """The phi of greatest restricted likelihood, as far as errors do not grow."""
    last = np.inf
    for _ in range(ROUNDS):
        value, Q = _minus_twice(products, phi, left)
        if last - value < PRECISE:
            break
        last = value
        phi = _bounded(np.asarray(np.linalg.solve(Q[1:, 1:], Q[1:, 0])))
    return phi


def _bounded(phi: Array) -> Array:
    """The same where nothing is remembered for ever with growing size, else with its roots on the circle."""
    growth = float(np.abs(np.roots(np.append(1.0, -phi))).max(initial=0.0))
    return phi if growth <= 1.0 else phi / growth ** np.arange(1, len(phi) + 1)


def _covariance(products: Array, phi: Array, left: int) -> Array:
    """Of phi, by the curvature of l; directions in which it has none are as open as the tangents say."""
    h = SHARE * max(float(np.abs(phi).max()), 1.0)

    def slope(at: Array) -> Array:
        Q = _minus_twice(products, at, left)[1]
        return np.asarray(-(Q @ np.append(1.0, -at))[1:])

    steps = h * np.eye(len(phi))
    curvature = np.array([slope(phi + one) - slope(phi - one) for one in steps]) / (2.0 * h)
    most = np.linalg.cholesky(_minus_twice(products, phi, left)[1][1:, 1:])
    inner = np.linalg.solve(most, np.linalg.solve(most, 0.5 * (curvature + curvature.T)).T)
    values, vectors = np.linalg.eigh(inner)
    half = np.linalg.solve(most.T, vectors)
    return np.asarray((half / np.maximum(values, LEAST)) @ half.T)
