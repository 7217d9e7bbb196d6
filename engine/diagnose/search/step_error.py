"""Whether what a later round finds is an error of the steps that the model makes.

An effect acts step by step, half a push early. The model that was diagnosed may be exact at any step, and with
the effect it no longer is: on a nearly noise-free record the remainder, a static function of the states that is
in proportion to the step, passes for a further effect of sensors or states. Steps half as long get rid of half
of it, and so of three quarters of what its likelihood ratio would be; of an effect that is there they leave
all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.catalogue import extend
from engine.diagnose.effects.setting import setting_for
from engine.diagnose.search.checkpoint import Kept
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml, whitening
from engine.filters.sigma_point import moment_filter
from engine.statespace.model import Array, MixedModel

EXPLAINED = 0.5  # of a likelihood ratio, from which steps half as long explain it


def of_the_steps(
    gain: float, model: MixedModel, names: Sequence[str], fit: QuasiFit, series: Series, kept: Kept
) -> bool:
    """Whether steps half as long gain most of what an effect does, ``gain`` in 2 x log-likelihood.

    ``fit`` is of ``model`` with the effects ``names``, without the one in question.
    """
    if not model.continuous:
        return False
    finer = series.held(series.hold).refined(2 * series.substeps)
    base = np.asarray(fit.theta)[: len(model.parameters)]
    extended = extend(model, names, setting_for(model, finer, base))
    theta = np.asarray(fit.theta)
    if apart(fit.model, extended, theta, series, finer) < EXPLAINED * gain:
        return False
    try:
        refitted = kept.further("half steps").fit(
            extended, lambda: quasi_ml(extended, finer, theta, fit.free)
        )
    except (EngineError, np.linalg.LinAlgError):
        return False
    return 2.0 * (refitted.log_likelihood - fit.log_likelihood) >= EXPLAINED * gain


def apart(
    model: MixedModel, other: MixedModel, theta: Array, series: Series, finer: Series
) -> float:
    """Squared differences of one-step predictions at the samples, in their own scatter, summed."""
    one, two = (moment_filter(m, theta, s) for m, s in ((model, series), (other, finer)))
    here, there = series.samples, finer.samples
    root = whitening(one.S[here, 0], series.observed[here])
    change = np.nan_to_num(one.innovations[here, 0] - two.innovations[there, 0])
    return float((np.einsum("tij,tj->ti", root, change) ** 2).sum())
