"""Noise is random: a name for its outliers, or for what it varies with, claims that rows are independent.

What a model gets wrong in a rhythm or for a while makes large errors now and then, as counts that come late
after each weekend do. Heavy tails explain these better than many a cause, but what they leave is no noise. So
errors of the extended model are tested for correlation in time (Ljung and Box 1978), by their ranks, which an
outlier does not reach. Where it is beyond doubt, records simulated by the same model say whether its filter
makes it so. Those that run away say nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtri

from engine.data.series import Series
from engine.diagnose.refits.calibration import drawn_from
from engine.diagnose.symptoms.residuals import whiteness
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit
from engine.filters.sigma_point import moment_path
from engine.statespace.model import Array
from engine.words import enumerated, probability

SURE = 1e-6  # p-value: fits that have not quite arrived, and filters that are nearly right, make 1e-4 of noise
SIMULATED = 7  # records


def dependent_rows(fit: QuasiFit, series: Series, names: Sequence[str], seed: int) -> str:
    """A sentence where errors of a model with noise of these ``names`` depend on earlier rows; else ""."""
    try:
        seen = _tail(fit, series)
    except (EngineError, np.linalg.LinAlgError):  # no evidence against the name
        return ""
    if seen > SURE or any(_as_dependent(fit, series, seen, [seed, 8, k]) for k in range(SIMULATED)):
        return ""
    return (
        f"Noise is random, and what {enumerated(list(names))} leaves does not: errors of the extended model "
        f"depend on those of earlier rows ({probability(seen)}). So what is wrong has a course in time."
    )


def _as_dependent(fit: QuasiFit, series: Series, seen: float, seed: Sequence[int]) -> bool:
    """Whether a record simulated by the model looks as dependent."""
    try:
        one = drawn_from(fit, series, np.random.default_rng(seed))
        return _tail(fit, one) <= seen
    except (EngineError, np.linalg.LinAlgError):
        return False


def _tail(fit: QuasiFit, series: Series) -> float:
    """The least p-value of correlation in time of the errors of an output, by their ranks."""
    path = moment_path(fit.model, np.asarray(fit.theta), series)
    scale = np.sqrt(np.diagonal(path.S_predicted, axis1=1, axis2=2))
    errors = np.where(series.observed, path.innovations / scale, np.nan)[series.samples]
    white = whiteness(_normal_scores(errors), tuple(fit.model.outputs))
    return min(1.0, len(white) * min((one.p_value for one in white), default=1.0))


def _normal_scores(x: Array) -> Array:
    """Columns by their ranks, as if they were normal (van der Waerden 1952); NaN where missing."""
    scores = np.full(x.shape, np.nan)
    for column, out in zip(x.T, scores.T, strict=True):
        there = np.isfinite(column)
        _, which, counts = np.unique(column[there], return_inverse=True, return_counts=True)
        ranks = np.cumsum(counts) - 0.5 * (counts - 1)  # of equal values the middle one
        out[there] = ndtri(ranks[which] / (1.0 + there.sum()))
    return scores
