"""How much of a rival's readings is each of its noises.

Its noise is estimated too, and grows with what the rival does not explain. With S(w) = sum_k w_k S_k the
covariance of the readings with the variances of the noise w_k times as large, and S = L L' as it is,

    L^{-1} S(w) L^{-T} = I + sum_k (w_k - 1) A_k,      A_k = L^{-1} S_k L^{-T}.

In a basis that makes all A_k diagonal they are a spectrum: A_k of one measurement and one process noise are so,
but for what the first state adds.
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


@dataclass(frozen=True, eq=False)
class NoiseRoom:
    """The noises of a rival that is estimated: ``shares`` (K, M) of each in a ``basis`` (M, M) of readings."""

    basis: Array
    shares: Array

    def of(self, N: int) -> tuple[Array, Array]:
        """The basis and shares of N readings: of fewer than M, their own; of more, block by block."""
        if len(self.basis) <= N:
            return self.basis, self.shares
        own = self.basis[:N]
        return _diagonal(np.array([(own * share) @ own.T for share in self.shares]))


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
    return NoiseRoom(*_diagonal(np.array(parts)))


def _diagonal(parts: Array) -> tuple[Array, Array]:
    """A basis (M, M) in which matrices (K, M, M) are diagonal, and their diagonals (K, M) there."""
    together = np.tensordot(np.arange(1.0, len(parts) + 1.0), parts, axes=1)
    basis = np.linalg.eigh(together)[1]
    shares = np.maximum(((parts @ basis) * basis).sum(axis=1), 0.0)
    return basis, shares / np.maximum(shares.sum(axis=0), 1.0)


def _inverse(runs: Runs, unit: Array, seen: NDArray[np.bool_], rows: NDArray[np.intp]) -> Array:
    """L^{-1} of the first readings, as a matrix."""
    W = np.asarray(whitened(runs.J, runs.H, runs.Q, runs.R, runs.P1, unit, seen))
    return W.reshape(-1, W.shape[-1])[rows]
