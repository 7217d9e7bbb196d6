"""Noise does not know the inputs: errors that are large where one of them has just moved are no outliers.

What a model gets wrong when its input is switched, a second time constant say or a path that it lacks, lasts
a few samples each time. Where inputs are switched now and then, such errors are rare and large as outliers
are, and a noise with heavy tails explains them one step ahead better than many a cause. Inputs that moved over
the step before are asked, not those of the reading's own row: a controller answers an outlier in that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.data.series import Series
from engine.diagnose.refits.rounds import Round
from engine.diagnose.screening.tails import (
    OUTLYING,
    first_of_each,
    pit_of,
    standardised_errors,
)
from engine.distributions import binomial_sf
from engine.estimation.quasi_ml import QuasiFit
from engine.filters.sigma_point import moment_path
from engine.statespace.model import Array
from engine.words import percent, probability

SELDOM = 0.2  # share of the samples at which an input may move, or move most, and still be asked
LEVEL = 1e-3  # of the p-value, by Bonferroni over outputs and inputs


def outliers_at_inputs(
    found: Sequence[Round], base: QuasiFit, series: Series, seed: int
) -> list[str]:
    """A sentence where outliers are named, and the largest errors of the ``base`` come where an input moves."""
    named = [
        r.refits[0].effect for r in found if r.equivalent and r.refits[0].effect.traits.outliers
    ]
    if not named or series.u.shape[1] == 0 or series.begins:
        return []
    path = moment_path(base.model, np.asarray(base.theta), series)
    errors = np.abs(standardised_errors(path, series.observed, pit_of(base, series, seed)))
    rows = np.asarray(series.samples)
    sizes, u = np.nan_to_num(errors[rows]), series.u[rows]
    tests = sizes.shape[1] * u.shape[1]
    for j in range(sizes.shape[1]):
        large = sizes[:, j] > OUTLYING
        outlying = first_of_each(sizes[:, j], np.flatnonzero(large))
        for channel, values in zip(base.model.inputs, u.T, strict=True):
            moved = _moved(values)
            there = int(moved[outlying].sum())
            p = float(binomial_sf(there, len(outlying), moved.mean()))
            if not 0 < moved.sum() <= SELDOM * len(moved) or tests * p > LEVEL:
                continue
            return [
                f"{there} of the {len(outlying)} largest errors come where {channel} has just moved, which it "
                f"does at {percent(moved.mean())} of the samples ({probability(tests * p)} by chance): noise "
                f"does not know the inputs, so {named[0].name} stands in for what the model gets wrong when "
                f"{channel} moves."
            ]
    return []


def _moved(values: Array) -> Array:
    """Whether an input (T,) moved between the two rows before each: at all, or by more than it usually does."""
    change = np.abs(np.diff(values))
    most = change > np.quantile(change, 1.0 - SELDOM / 2.0) if len(change) else change > 0.0
    any_ = change > 0.0
    moved = any_ if any_.mean() <= SELDOM else most
    return np.concatenate([[False, False], moved[:-1]])
