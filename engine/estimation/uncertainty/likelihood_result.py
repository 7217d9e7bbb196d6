"""What :func:`engine.likelihood_intervals` returns: ends, how exact they are, what is to be known of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.statespace.model import Array, MixedModel, Theta
from engine.views import Shown, View, sheet, tables
from engine.words import Told, digits_of_ends


@dataclass(frozen=True, eq=False)
class LikelihoodIntervals(Shown):
    """Intervals of the free parameters by the likelihood ratio.

    Attributes
    ----------
    model : MixedModel
        The model that was estimated.
    theta : Theta
        The estimate (n_theta,) about which the intervals are.
    level : float
        Confidence of each interval, such as 0.95.
    values : array (n_theta, 2)
        The intervals; NaN for parameters that are held fixed or at a bound, and for an end that was not found,
        which ``warning`` tells. An end that is the parameter's bound, which may be infinite, says that the
        likelihood does not fall enough before it.
    errors : array (n_theta, 2)
        Monte Carlo standard errors of the ends, NaN where there is no end but a bound.
    maximum : array (n_theta,)
        Value at which each profile is highest: the estimate, if it is the maximum.
    warning : str
        What is to be known: that the estimation was lost; that a maximum is more than a standard error away
        from the estimate; which ends were not found. Else "".
    """

    model: MixedModel
    theta: Theta
    level: float
    values: Array
    errors: Array
    maximum: Array
    warning: str = ""

    def _view(self) -> View:
        rows = [
            (p.name, *(_shown(one, low, high) for one in (value, low, high)), p.unit)
            for p, value, (low, high) in zip(
                self.model.parameters, self.theta.tolist(), self.values.tolist(), strict=True
            )
            if np.isfinite(low) or np.isfinite(high)
        ]
        head = ("parameter", "estimate", f"{100 * self.level:g} % from", "to", "unit")
        title = f"{self.model.name}: intervals by the likelihood ratio"
        return sheet(title, tables().line(self.warning), tables().table(head, rows))


def _shown(value: float, low: float, high: float) -> float | str:
    """A value, or an end, to the digits that the interval needs."""
    return "not found" if np.isnan(value) else Told(value, digits_of_ends(low, high))
