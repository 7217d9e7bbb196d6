"""Square roots and inverses of information matrices that noise has been at, and how well they are known."""

from __future__ import annotations

import numpy as np

from engine.statespace.model import Array

GOOD_GUESS = (0.4, 2.5)  # times the guessed information, between which it is a good one
FLOOR = 0.05  # a round may widen a direction by 1 / sqrt(FLOOR) at most


def good_guess(G: Array) -> bool:
    """Whether information (n, n), in units of a guess, shows that to be a good one."""
    values = np.linalg.eigvalsh(G)
    return bool(GOOD_GUESS[0] <= values[0] and values[-1] <= GOOD_GUESS[1])


def symmetric_root(S: Array) -> Array:
    """The symmetric square root of S: its columns treat all parameters alike."""
    values, vectors = np.linalg.eigh(0.5 * (S + S.T))
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    return root


def root_of_inverse(H: Array) -> Array:
    """A root of H^{-1}, taken of the correlations: rounding must not mix parameters of units far apart."""
    scale = np.sqrt(np.diag(H))
    correlations = np.asarray(np.linalg.inv(H / scale[:, None] / scale), dtype=float)
    return symmetric_root(correlations) / scale[:, None]


def floored_inverse(G: Array) -> Array:
    """G^{-1} with the eigenvalues of G kept above FLOOR, so that noise cannot make it negative."""
    values, vectors = np.linalg.eigh(G)
    inverse: Array = vectors / np.maximum(values, FLOOR) @ vectors.T
    return inverse


def relative_errors(L: Array, G: Array) -> Array:
    """Relative standard error of each standard error, from the replicates G (R, n, n)."""
    R = len(G)
    if R < 2:
        return np.zeros(len(L))
    left_out = (G.sum(axis=0) - G) / (R - 1)
    logs = np.array([0.5 * np.log(np.diag(L @ floored_inverse(g) @ L.T)) for g in left_out])
    return np.asarray(np.sqrt((R - 1) * logs.var(axis=0)))
