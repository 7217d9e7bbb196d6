"""What a refit is: an effect estimated together with the model's parameters, and what it costs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.refits.amplitude import amplitude_of
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.statespace.model import Array

TOLERANCE = 0.02  # of a log-likelihood: refits are compared, the best one is then finished
HOPE = 10.0  # a large effect is far away, where a search gains many times what it expects

UNLIKELIER = 4.0  # of the score, that an odd effect is behind beforehand: one to seven
LEAST_ERRORS = 2.0  # standard errors that a size must be away from zero


@dataclass(frozen=True, eq=False)
class Refit:
    """An effect estimated together with the model's parameters.

    ``gain`` is 2 (log-likelihood gained), ``score`` that less its costs.
    """

    effect: Effect
    fit: QuasiFit
    gain: float
    score: float

    @property
    def size(self) -> float:
        """The estimated size."""
        return float(self.fit.theta[self.effect.size.name])

    @property
    def standard_error(self) -> float:
        """Its standard error."""
        return float(self.fit.standard_errors[self.fit.free.index(self.effect.size.name)])

    @property
    def is_sure(self) -> bool:
        """Whether the size may not as well be zero."""
        size, error = self.sized
        return abs(size) >= LEAST_ERRORS * error

    @property
    def sized(self) -> tuple[float, float]:
        """The size and its standard error, of a wave its amplitude: one of its parts may be zero."""
        amplitude, error = amplitude_of(self.effect, self.fit)
        if amplitude is None or error is None:
            return self.size, self.standard_error
        return amplitude, error


def weighed(effect: Effect, fit: QuasiFit, null: float, series: Series) -> Refit:
    """A refit with its gain over the log-likelihood ``null`` without the effect."""
    gain = 2.0 * (fit.log_likelihood - null)
    return Refit(effect, fit, gain, gain - cost(effect, series))


def cost(effect: Effect, series: Series) -> float:
    """What an effect's further parameters must gain before they count: log T each (Schwarz 1978).

    One that is odd at its channel must be likelier by as much as it was less likely before the data.
    """
    odds = UNLIKELIER if effect.traits.odd else 0.0
    return further_parameters(effect) * float(np.log(series.n_measured)) + odds


def further_parameters(effect: Effect) -> int:
    """How many parameters are estimated beside the size."""
    return len(effect.parameters) - 1 - len(effect.held)


def free_parameters(effect: Effect) -> list[str]:
    """The effect's own parameters that are estimated by slopes."""
    fixed = {*effect.sought, *effect.held}
    return [p.name for p in effect.parameters if p.name not in fixed]


def finished(
    fit: QuasiFit, series: Series, told: Callable[[int], object] | None = None
) -> QuasiFit:
    """A refit to the usual tolerance; as it is where its likelihood is on an edge."""
    try:
        return quasi_ml(fit.model, series, fit.theta, fit.free, callback=told)
    except EngineError:
        return fit


def held_out_terms(fit: QuasiFit, series: Series) -> Array:
    """One-step predictive log-densities (T,) of a series under a fitted model."""
    return fit.log_terms(series)
