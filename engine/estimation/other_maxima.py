"""Another maximum of the likelihood that the data do not tell from the one an estimation ended at.

Standard errors know one maximum only. Where two solutions explain the data about as well, as the two rates of
absorption and elimination that may change places, they are many of its standard errors apart.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.distributions import chi2_quantile
from engine.estimation.quasi_ml import QuasiFit, log_likelihoods
from engine.statespace.model import MixedModel, Theta

CONFIDENCE = 0.95  # of the region that another maximum is in, by its height
SAME = 0.01  # nats that nobody cares for


def about_other_maxima(
    model: MixedModel,
    all_series: Sequence[Series],
    estimate: Theta,
    known: Sequence[QuasiFit],
    indices: NDArray[np.intp],
) -> str:
    """A sentence on the likeliest of the maxima ``known`` that is as likely as the estimate and elsewhere.

    As likely: the confidence region of the free parameters ``indices``, by the moment filter's likelihood, has
    both. Elsewhere: the estimate is not in the region that the other's information gives. Empty without one.
    """
    threshold = chi2_quantile(CONFIDENCE, len(indices))
    apart = []
    for fit in known:
        d = (np.asarray(estimate) - np.asarray(fit.theta))[indices]
        if float(d @ fit.information @ d) > threshold:
            apart.append(np.asarray(fit.theta))
    if not apart:
        return ""
    own, *others = log_likelihoods(model, all_series, np.array([np.asarray(estimate), *apart]))
    differences = np.array(others) - own
    alike = np.flatnonzero(2.0 * np.abs(differences) <= threshold)
    if not len(alike):
        return ""
    best = alike[np.argmax(differences[alike])]
    there = ", ".join(f"{model.parameter_names[k]} = {apart[best][k]:.4g}" for k in indices)
    return (
        f"These data hardly tell the estimate from another maximum, at {there}, whose log-likelihood is "
        f"{_height(float(differences[best]))} by the moment filter. Standard errors and intervals are of the "
        "one alone: decide by what else is known, and let bounds leave out the other."
    )


def _height(difference: float) -> str:
    if abs(difference) < SAME:
        return "the same"
    return f"{abs(difference):.2g} {'higher' if difference > 0.0 else 'lower'}"
