"""Estimates next to a bound where nothing but a search has taken them: of parameters only known together.

Where only the ratio of a force and a mass shows, any mass is as likely, and a search ends wherever its starts
and steps lead: often at a bound, as all that lies beyond is put there. What is added to the model is then
stopped by that bound: a mass that grows has no size. So a parameter that is nearer to a bound than to where its
search began is brought back there, and the others with it.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from engine.data.series import Series
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.statespace.model import Array, Theta
from engine.ties import flat_directions

LOST = 0.02  # of the log-likelihood: what a climb to the usual tolerance may leave


def off_tied_edges(fit: QuasiFit, series: Series, start: Theta) -> QuasiFit:
    """The fit with tied parameters off their bounds, at their ``start``, where it is as likely there."""
    for name in fit.tied:
        if not _next_to_a_bound(fit, name, start[name]):
            continue
        others = [other for other in fit.free if other != name]
        with suppress(EngineError, np.linalg.LinAlgError):
            moved = quasi_ml(fit.model, series, _along_the_tie(fit, name, start[name]), others)
            if moved.log_likelihood >= fit.log_likelihood - LOST:
                fit = quasi_ml(fit.model, series, moved.theta, fit.free)
    return fit


def _next_to_a_bound(fit: QuasiFit, name: str, start: float) -> bool:
    """Whether a parameter is nearer to one of its bounds than to its ``start``."""
    k = fit.model.index(name)
    value = fit.theta[name]
    left = min(value - fit.model.lower[k], fit.model.upper[k] - value)
    return bool(left < abs(value - start))


def _along_the_tie(fit: QuasiFit, name: str, value: float) -> Array:
    """theta with the parameter ``name`` at ``value``, and what is tied to it moved as the likelihood allows."""
    diagonal = np.diag(fit.information)
    scale = np.where(diagonal > 0.0, 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)), 1.0)
    directions = flat_directions(fit.information)
    k = fit.free.index(name)
    direction = scale * (directions @ directions[k])
    theta = np.asarray(fit.theta).copy()
    indices = fit.model.free_indices(fit.free)
    theta[indices] += direction * (value - fit.theta[name]) / direction[k]
    theta[indices[k]] = value
    return np.clip(theta, fit.model.lower, fit.model.upper)
