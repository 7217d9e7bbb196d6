"""How much of a difference a rival explains by more noise.

Its noise is estimated too, and grows with what the rival does not explain. Let v = L^{-1} Delta be the
difference that is left, and S(w) = sum_k w_k S_k the covariance of the readings with the variances of the noise
w_k times as large; A_k = L^{-1} S_k L^{-T} is the share of each. Twice the log-likelihood lost is the least
over w of

    f(w) = log det(C) + tr(C^{-1}) (N - p) / N - N + v' C^{-1} v,      C = I + sum_k (w_k - 1) A_k,

with N readings, of which the p parameters of the mean adapt to as many, beside f without v. In a basis that
makes all A_k diagonal it is a sum over a spectrum: A_k of one measurement and one process noise are so, but for
what the first state adds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from engine.design.candidates import Candidate
from engine.design.runs import Experiments, Runs, linearised
from engine.estimation.expectation import either_side
from engine.kernels.whitening import whitened
from engine.statespace.model import Array

MOST_ROWS = 128  # readings from which the spectrum is found
NOISE_STEP = 0.02  # of a noise parameter's size, for differences
GRID = np.array([0.0, *np.geomspace(0.05, 20.0, 14)])  # squares of v, as shares of |v|^2
STEPS, LONGEST = 12, 1.5  # Fisher scoring on log w, and the longest step of it
SMALL = 1e-6  # ridge of the information, as a share


@dataclass(frozen=True, eq=False)
class NoiseRoom:
    """The noises of a rival that is estimated: ``shares`` (K, M) of each in a ``basis`` (M, M) of readings."""

    basis: Array
    shares: Array

    def spectrum(self, v: Array) -> Array:
        """Squares (M,) of v (N,) along the basis, block by block of M readings."""
        M = len(self.basis)
        blocks = np.zeros((-(-len(v) // M), M)) if len(v) else np.zeros((1, M))
        blocks.reshape(-1)[: len(v)] = v
        squares: Array = ((blocks @ self.basis) ** 2).sum(axis=0)
        return squares

    def left(self, v: Array, adapted: float) -> tuple[Array, Array, Array]:
        """For squares X (G,) of v (N,): X, twice the log-likelihood lost, and the statistic of a score test.

        ``adapted`` is p, how many readings the parameters of the mean adapt to.
        """
        own = float(v @ v)
        X = GRID * own
        if not len(self.shares) or not own > 0.0:
            return X, X, X
        N, M = float(len(v)), len(self.basis)
        still = max(N - adapted, 1.0)
        c = self.spectrum(v) / own
        a, eta = self.shares, np.zeros((len(X), len(self.shares)))
        for _ in range(STEPS):
            w = np.exp(eta)
            d = 1.0 + (w - 1.0) @ a
            slope = N / M / d - (still / M + X[:, None] * c) / d**2
            gradient = w * (slope @ a.T)
            information = (w[:, :, None] * w[:, None]) * np.einsum(
                "km,lm,gm->gkl", a, a, N / M / d**2, optimize=True
            )
            size = np.trace(information, axis1=1, axis2=2)
            information += SMALL * size[:, None, None] * np.eye(len(a))
            step = np.linalg.solve(information, gradient[..., None])[..., 0]
            eta = np.clip(eta - np.clip(step, -LONGEST, LONGEST), -12.0, 12.0)
        d = 1.0 + (np.exp(eta) - 1.0) @ a
        f = (N / M * np.log(d) + (still / M + X[:, None] * c) / d).sum(axis=1)
        return X, np.maximum.accumulate(f - f[0]), X * (c / d).sum(axis=1)


def noise_room(
    rival: Candidate, theta: Array, runs: Runs, experiment: Experiments, seen: NDArray[np.bool_]
) -> NoiseRoom:
    """The noises among a rival's free parameters, those that do not move its runs, along these."""
    rows = np.flatnonzero(seen.ravel())[:MOST_ROWS]
    silent = ~(runs.dy != 0.0).any(axis=(0, 1, 2))
    noise = [k for k, quiet in zip(rival.indices, silent, strict=True) if quiet and theta[k] != 0.0]
    n, ny = seen.shape
    unit = np.zeros((1, n, ny, len(rows)))
    unit.reshape(n * ny, -1)[rows, np.arange(len(rows))] = 1.0
    inverse = _inverse(runs, unit, seen, rows)
    parts = []
    for k in noise:
        low, high = either_side(rival.model, theta, k, NOISE_STEP)
        moved = high if high[k] > theta[k] else low
        changed = linearised(rival.model, moved, experiment, (), runs.x)
        B = solve_triangular(_inverse(changed, unit, seen, rows).T, inverse.T, lower=False).T
        more = (moved[k] / theta[k]) ** 2 - 1.0  # a deviation's variance
        parts.append((B @ B.T - np.eye(len(rows))) / more)
    if not parts:
        return NoiseRoom(np.eye(len(rows)), np.zeros((0, len(rows))))
    together = sum((k + 1.0) * one for k, one in enumerate(parts))
    basis = np.linalg.eigh(together)[1]
    shares = np.array([np.einsum("im,ij,jm->m", basis, one, basis, optimize=True) for one in parts])
    shares = np.maximum(shares, 0.0)
    return NoiseRoom(basis, shares / np.maximum(shares.sum(axis=0), 1.0))


def _inverse(runs: Runs, unit: Array, seen: NDArray[np.bool_], rows: NDArray[np.intp]) -> Array:
    """L^{-1} of the first readings, as a matrix."""
    W = np.asarray(whitened(runs.J, runs.H, runs.Q, runs.R, runs.P1, unit, seen))
    return W.reshape(-1, W.shape[-1])[rows]
