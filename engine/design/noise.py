"""How much of a rival's readings is each of its noises.

Its noise is estimated too, and grows with what the rival does not explain. With S(w) = sum_k w_k S_k the
covariance of the readings with the variances of the noise w_k times as large, and S = L L' as it is,

    L^{-1} S(w) L^{-T} = I + sum_k (w_k - 1) A_k,      A_k = L^{-1} S_k L^{-T}.

A_k is found from a small change of a parameter: by a factor, as the parameter may be a variance, a standard
deviation or a logarithm. Where all noises are estimated, their shares A_k make up I, which tells the factors;
a noise that is none yet has no part in I, and may only grow. In a basis that makes all A_k diagonal they are a
spectrum: A_k of one measurement and one process noise are so, but for what the first state adds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from engine.design.candidates import Candidate
from engine.design.criterion import whiten
from engine.design.runs import Experiments, Runs, linearised
from engine.estimation.expectation import either_side
from engine.statespace.model import Array

MOST_ROWS = 128  # readings from which the spectrum is found
NOISE_STEP = 0.02  # of a noise parameter's size, for differences
LEAST_SHARE = 0.01  # of all readings' variance, below which a noise counts as none yet
LEAST_CHANGE = (
    1e-9  # of the readings' variance by such a step, below which there is nothing but rounding
)


@dataclass(frozen=True, eq=False)
class NoiseRoom:
    """The noises of a rival that is estimated: ``shares`` (K, M) of each in a ``basis`` (M, M) of readings.

    Noises that are ``there`` (K,) have these shares of the readings' noise as it is; the others would, if they
    grew to it.
    """

    basis: Array
    shares: Array
    there: NDArray[np.bool_]

    def of(self, N: int) -> NoiseRoom:
        """That of N readings: of fewer than M, their own; of more, block by block."""
        if len(self.basis) <= N:
            return self
        own = self.basis[:N]
        parts = np.array([(own * share) @ own.T for share in self.shares])
        basis, shares = _diagonal(parts)
        return NoiseRoom(basis, _at_most_all(shares, self.there), self.there)


def noise_room(
    rival: Candidate, theta: Array, runs: Runs, experiment: Experiments, seen: NDArray[np.bool_]
) -> NoiseRoom:
    """The noises among a rival's free parameters, those that do not move its runs, along these."""
    rows = np.flatnonzero(seen.ravel())[:MOST_ROWS]
    silent = ~(runs.dy != 0.0).any(axis=(0, 1, 2))
    noise = [k for k, quiet in zip(rival.indices, silent, strict=True) if quiet]
    inverse = _inverse(runs, rows, seen)
    noisy = np.diag(inverse) > 0.0  # a reading without noise tells of none
    rows, inverse = rows[noisy], inverse[np.ix_(noisy, noisy)]
    parts = []
    for k in noise:
        low, high = either_side(rival.model, theta, k, NOISE_STEP)
        moved = high if high[k] > theta[k] else low
        changed = linearised(rival.model, moved, experiment, (), runs.x)
        B = solve_triangular(_inverse(changed, rows, seen).T, inverse.T, lower=False).T
        change = B @ B.T - np.eye(len(rows))
        mean = float(np.trace(change)) / max(len(rows), 1)
        if abs(mean) > LEAST_CHANGE:
            parts.append(change / mean)
    if not parts:
        return NoiseRoom(np.eye(len(rows)), np.zeros((0, len(rows))), np.zeros(0, dtype=bool))
    basis, shares = _diagonal(np.array(parts))
    factors = nnls(shares.T, np.ones(len(rows)))[0]
    there = factors > LEAST_SHARE
    factors[~there] = 1.0
    return NoiseRoom(basis, _at_most_all(factors[:, None] * shares, there), there)


def _diagonal(parts: Array) -> tuple[Array, Array]:
    """A basis (M, M) in which matrices (K, M, M) are diagonal, and their diagonals (K, M) there."""
    together = np.tensordot(np.arange(1.0, len(parts) + 1.0), parts, axes=1)
    basis = np.linalg.eigh(together)[1]
    return basis, np.maximum(((parts @ basis) * basis).sum(axis=1), 0.0)


def _at_most_all(shares: Array, there: NDArray[np.bool_]) -> Array:
    """Shares (K, M) of which those that are there do not make up more than the whole."""
    whole = np.maximum(shares[there].sum(axis=0), 1.0)
    return np.where(there[:, None], shares / whole, shares)


def _inverse(runs: Runs, rows: NDArray[np.intp], seen: NDArray[np.bool_]) -> Array:
    """L^{-1} of some readings, by their rows among all, as a matrix."""
    unit = np.zeros((1, *seen.shape, len(rows)))
    unit.reshape(seen.size, -1)[rows, np.arange(len(rows))] = 1.0
    W = whiten(runs, unit, seen)
    return np.asarray(W.reshape(-1, len(rows))[rows])
