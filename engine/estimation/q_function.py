"""One Gaussian term of the Q-function, with its gradient and scoring matrix.

Each of I1, I2 and I3 (paper, eq. (9)) is a sum over points (t, j) of

    E log N(x; m(theta) + A(theta) z, S(theta)),    -2 log N = log det S + Tr(S^{-1} l) + const.,

with l = E (x - m - A z)(x - m - A z)' over the smoothed x and z, paper, eqs. (12)-(19). In I2, x is
x_{t+1}, z is z_t and (m, A, S) = (f, A, Q); in I3 they are y_t, z_t and (h, C, R). With
r = x_bar - m - A z_bar and S = L L',

    l = r r' + Var(x) + A P A' - A Cov(z, x) - Cov(x, z) A'.

Derivatives of m, A and S by theta are differences of the model's own functions, exact to rounding
where theta enters linearly; the chain rule does the rest. The scoring matrix is the expected
negative Hessian: where theta enters m and A linearly and S not at all, it is the Hessian, and one
step theta + H^{-1} g is the weighted least-squares solution.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from engine.kernels.gaussian import any_impossible, psd_cholesky_many, whiten_points
from engine.statespace.model import Array, LinearGaussian

# record of theta -> m (T, N, n), A (T', N', n, nz), S (T', N', n, n)
Evaluate: TypeAlias = Callable[[Any], LinearGaussian]
# for each parameter the records of theta - step and theta + step, and the distance between the two
Neighbours: TypeAlias = list[tuple[Any, Any, float]]

DIFFERS = 1e-13  # of the largest value: less than this between two theta is rounding
LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class GaussianTerm:
    """Sum over t of the mean over j of E log N(x; m + A z, S).

    ``x`` (T, N, n) mean of x; ``z`` (T, N, nz) mean of z; ``P`` (T, B, nz, nz) = Var(z), ``cross``
    (T, B, n, nz) = Cov(x, z), ``var`` (T, B, n, n) = Var(x), with B = 1 where common to all j.
    Directions in which S has no noise leave the term (paper, eq. (15), for singular Q).
    """

    evaluate: Evaluate
    x: Array
    z: Array
    P: Array
    cross: Array
    var: Array

    def value(self, record: Any, rank: int | None = None) -> float:
        """The term at theta; -inf where S has not the rank it must keep, is not finite, or no covariance."""
        return self._at(self.evaluate(record), rank)[0]

    def rank(self, record: Any) -> int:
        """Number of directions with noise, summed over all points at which S was given."""
        S = self.evaluate(record)[2]
        return int(np.count_nonzero(_pivots(_factor(S))))

    def possible(self, record: Any) -> bool:
        """Whether means are finite, and S is a covariance, at every point."""
        m, A, S = self.evaluate(record)
        return bool(np.isfinite(m).all() and np.isfinite(A).all()) and _is_possible(S)

    def moves_noise_free(self, record: Any, neighbours: Neighbours) -> NDArray[np.bool_]:
        """Which of k parameters change x, or the noise, in directions without noise: (k,).

        ``neighbours`` as in :meth:`derivatives`, which looks at the other directions only.
        """
        m, A, S = self.evaluate(record)
        L = _factor(S)
        exact = ~(_pivots(L) > 0.0)
        out = np.zeros(len(neighbours), dtype=bool)
        if not exact.any():
            return out
        sizes = (np.abs(m).max(axis=(0, 1)), np.abs(A).max(axis=(0, 1)))
        for i, (below, above, _) in enumerate(neighbours):
            low, high = self.evaluate(below), self.evaluate(above)
            dm, dA = high[0] - low[0], high[1] - low[1]
            moved = np.abs(dm - _apply(L, whiten_all(L, dm))) > DIFFERS * sizes[0]
            ranks = {int(np.count_nonzero(_pivots(_factor(x[2])))) for x in (low, high)}
            out[i] = (exact & moved).any() or ranks != {int(np.count_nonzero(~exact))}
            if dA.any():
                moved = np.abs(dA - L @ whiten_all(L, dA)) > DIFFERS * sizes[1]
                out[i] |= (exact[..., None] & moved).any()
        return out

    def _at(
        self, model: LinearGaussian, rank: int | None
    ) -> tuple[float, Array, Array, Array, Array]:
        """Value; whitened residual r~ (T, N, n); whitening W; E~ = W l W' - r~ r~' ; factor L."""
        m, A, S = model
        L = _factor(S)
        pivots = _pivots(L)
        noisy = pivots > 0.0
        lost = not (np.isfinite(S).all() and _is_possible(S))
        if lost or (rank is not None and np.count_nonzero(noisy) != rank):
            return -np.inf, m, L, L, L
        r = whiten_all(L, self.x - m - _apply(A, self.z))
        W = whiten_all(L, np.broadcast_to(np.eye(L.shape[-1]), L.shape))
        AP = A @ self.P
        Across = A @ np.swapaxes(self.cross, -1, -2)
        spread = self.var + AP @ np.swapaxes(A, -1, -2) - Across - np.swapaxes(Across, -1, -2)
        spread = W @ spread @ np.swapaxes(W, -1, -2)
        T, N = self.x.shape[:2]
        log_det = 2.0 * np.log(np.where(noisy, pivots, 1.0)).sum(-1) + LOG_2PI * noisy.sum(-1)
        value = -0.5 * (
            _total(log_det, T)
            + float(np.vdot(r, r)) / N
            + _total(np.trace(spread, axis1=-2, axis2=-1), T)
        )
        return value if np.isfinite(value) else -np.inf, r, W, spread, L

    def derivatives(self, record: Any, neighbours: Neighbours) -> tuple[float, Array, Array]:
        """Value, gradient (k,) and scoring matrix (k, k) along k parameters.

        ``neighbours`` holds for each parameter the records of theta - step, theta + step, and the
        distance between the two.
        """
        model = self.evaluate(record)
        value, r, W, spread, L = self._at(model, None)
        T, N = self.x.shape[:2]
        cross = W @ (self.cross - model[1] @ self.P)  # W Cov(r, z)
        gradient, H = np.zeros(len(neighbours)), np.zeros((len(neighbours), len(neighbours)))
        changes: list[_Change] = []
        for i, (below, above, distance) in enumerate(neighbours):
            d = self._change(L, W, self.evaluate(below), self.evaluate(above), distance)
            changes.append(d)
            if d.mean is not None:
                gradient[i] += float(np.vdot(d.mean, r)) / N
            if d.slope is not None:
                gradient[i] += _total((d.slope * cross).sum((-1, -2)), T)
            if d.noise is not None:
                trace = (d.noise * spread).sum((-1, -2)) - np.trace(d.noise, axis1=-2, axis2=-1)
                gradient[i] += 0.5 * (_total(trace, T) + float(np.sum(_apply(d.noise, r) * r)) / N)
            for j, e in enumerate(changes):
                if d.mean is not None and e.mean is not None:
                    H[i, j] += float(np.vdot(d.mean, e.mean)) / N
                if d.slope is not None and e.slope is not None:
                    H[i, j] += _total(((d.slope @ self.P) * e.slope).sum((-1, -2)), T)
                if d.noise is not None and e.noise is not None:
                    H[i, j] += 0.5 * _total((d.noise * e.noise).sum((-1, -2)), T)
                H[j, i] = H[i, j]
        return value, gradient, H

    def _change(
        self, L: Array, W: Array, low: LinearGaussian, high: LinearGaussian, distance: float
    ) -> _Change:
        """The whitened derivatives along one parameter, None where there is none."""
        dm, dA, dS = ((b - a) / distance for a, b in zip(low, high, strict=True))
        mean = dm if dm.any() else None
        if dA.any():
            mean = _apply(dA, self.z) + dm
        return _Change(
            None if mean is None else whiten_all(L, mean),
            W @ dA if dA.any() else None,
            W @ dS @ np.swapaxes(W, -1, -2) if dS.any() else None,
        )


@dataclass(frozen=True, eq=False)
class _Change:
    """Derivatives along one parameter, whitened: of m + A z (T, N, n), of A, and of S."""

    mean: Array | None
    slope: Array | None
    noise: Array | None


def _factor(S: Array) -> Array:
    """Cholesky factors of S (T', N', n, n), zero pivots where there is no noise."""
    factors: Array = psd_cholesky_many(S.reshape(-1, *S.shape[2:])).reshape(S.shape)
    return factors


def _is_possible(S: Array) -> bool:
    return not any_impossible(S.reshape(-1, *S.shape[2:]))


def _pivots(L: Array) -> Array:
    return np.diagonal(L, axis1=-2, axis2=-1)


def whiten_all(L: Array, r: Array) -> Array:
    """L^{-1} r at every point, directions without noise set to zero; r (T, N, n) or (T', N', n, k)."""
    if r.ndim == 3:
        return np.asarray(whiten_points(L, np.ascontiguousarray(r)))
    columns = np.moveaxis(r, -1, 0)
    return np.moveaxis(np.stack([whiten_points(L, np.array(c, order="C")) for c in columns]), 0, -1)


def _apply(A: Array, z: Array) -> Array:
    """A z at every point: A (T', N', n, nz), z (T, N, nz) -> (T, N, n)."""
    if A.shape[:2] == (1, 1):
        common: Array = z @ A[0, 0].T
        return common
    every = np.broadcast_to(A, (*z.shape[:2], *A.shape[2:]))
    each: Array = np.einsum("tjnk,tjk->tjn", every, z)
    return each


def _total(values: Array, T: int) -> float:
    """Sum over t of the mean over j of values (T', N')."""
    return float(values.mean(axis=1).sum() * (T / values.shape[0]))
