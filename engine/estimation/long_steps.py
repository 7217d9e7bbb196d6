"""Whether the steps that a model makes are short enough for the likelihood: by its one-step predictions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.data.series import Series
from engine.errors import EngineError
from engine.estimation.quasi_ml import whitening
from engine.filters.sigma_point import MomentFiltered, moment_filter
from engine.simulation.step_length import said_of, too_long
from engine.statespace.model import Array, MixedModel

FELT = 0.25  # squared differences of predictions, in their scatter: no estimate moves by half an error below it
FOR_ESTIMATES = (
    "That is for estimates: a diagnosis chooses its steps by itself, whatever those of the series are, and "
    "parameters that it shows may be off by more than half their errors."
)


def about_predictions(model: MixedModel, theta: Array, all_series: Sequence[Series]) -> str:
    """A sentence where steps are too long for the predictions of the moment filter; "" where they are not.

    Of models that are ``continuous``: others have no shorter steps. None is said of those that count them.
    """
    if not model.continuous or model.steps_counted:
        return ""
    theta, measured = np.asarray(theta), sum(int(one.observed.sum()) for one in all_series)
    known: dict[tuple[int, int], tuple[MomentFiltered, Series]] = {}

    def filtered(i: int, k: int) -> tuple[MomentFiltered, Series]:
        one = all_series[i]
        if (i, k) not in known:
            fine = one if k == one.substeps else one.held(one.hold).refined(k)
            known[i, k] = moment_filter(model, theta[None], fine), fine
        return known[i, k]

    def change(k: int) -> float:
        each = range(len(all_series))
        squares = sum(apart(*filtered(i, k), *filtered(i, 2 * k)) for i in each)
        return float(np.sqrt(squares / max(measured, 1)))

    substeps = max(one.substeps for one in all_series)
    try:
        found = too_long(change, substeps, float(np.sqrt(FELT / max(measured, 1))))
    except (EngineError, np.linalg.LinAlgError):
        return ""
    what = "one-step predictions change by {} their scatter"
    return said_of(substeps, what, *found) if found else ""


def apart(one: MomentFiltered, series: Series, other: MomentFiltered, finer: Series) -> float:
    """Squared differences of one-step predictions at the samples, in their own scatter, summed."""
    here, there = series.samples, finer.samples
    root = whitening(one.S[here, 0], series.observed[here])
    change = np.nan_to_num(one.innovations[here, 0] - other.innovations[there, 0])
    return float((np.einsum("tij,tj->ti", root, change) ** 2).sum())
