"""How uncertain what was fitted to free runs is: their errors are hardly ever white."""

from __future__ import annotations

import numpy as np

from engine.diagnose.free_run.fitted import Fitted
from engine.diagnose.free_run.folds import folds_of
from engine.statespace.model import Array


def run_covariance(fit: Fitted) -> Array:
    """Covariance (n_p, n_p) of p from the free run: a sandwich over blocks of rows.

    (J'J)^-1 (sum of s_b s_b') (J'J)^-1 with s_b = J_b' e_b; Liang and Zeger (1986), "Longitudinal data
    analysis using generalized linear models", with blocks for subjects.
    """
    block = folds_of(fit.records).block
    lengths = np.linalg.norm(fit.J, axis=0)
    lengths[lengths == 0.0] = np.inf
    J = fit.J / lengths
    bread = np.linalg.pinv(J.T @ J, rcond=1e-10, hermitian=True)
    scores = np.array([J[block == b].T @ fit.e[block == b] for b in np.unique(block)])
    n = len(scores)
    return np.asarray(
        (n / max(n - 1, 1)) * (bread @ scores.T @ scores @ bread) / np.outer(lengths, lengths)
    )
