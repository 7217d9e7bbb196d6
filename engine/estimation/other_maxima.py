"""Another maximum of the likelihood that the data do not tell from the one an estimation ended at.

Standard errors know one maximum only. Where two solutions explain the data about as well, as the two rates of
absorption and elimination that may change places, they are many of its standard errors apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.distributions import chi2_quantile
from engine.errors import ModelError
from engine.estimation.quasi_ml import QuasiFit, log_likelihoods, quasi_ml
from engine.statespace.model import MixedModel, Theta
from engine.ties import flat_directions, to_hold

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
    both. Elsewhere: the estimate is not in the region that the other's information gives, nor does a ridge of
    parameters that are only determined together lead there. Empty without one.
    """
    threshold = chi2_quantile(CONFIDENCE, len(indices))
    apart = []
    for fit in known:
        d = (np.asarray(estimate) - np.asarray(fit.theta))[indices]
        if float(d @ fit.information @ d) > threshold:
            apart.append(fit)
    if not apart:
        return ""
    thetas = [np.asarray(one) for one in (estimate, *(fit.theta for fit in apart))]
    own, *others = log_likelihoods(model, all_series, np.array(thetas))
    differences = np.array(others) - own
    order = np.argsort(-differences)
    alike = [int(k) for k in order if 2.0 * abs(differences[k]) <= threshold]
    ridge = partial(_on_one_ridge, model, all_series, estimate, indices=indices)
    best = next((k for k in alike if not ridge(apart[k])), None)
    if best is None:
        return ""
    values = np.asarray(apart[best].theta)
    there = ", ".join(f"{model.parameter_names[k]} = {values[k]:.4g}" for k in indices)
    return (
        f"These data hardly tell the estimate from another maximum, at {there}, whose log-likelihood is "
        f"{_height(float(differences[best]))} by the moment filter. Standard errors and intervals are of the "
        "one alone: decide by what else is known, and let bounds leave out the other."
    )


def _on_one_ridge(
    model: MixedModel,
    all_series: Sequence[Series],
    estimate: Theta,
    other: QuasiFit,
    indices: NDArray[np.intp],
) -> bool:
    """Whether the estimate and the other maximum are points of one ridge along which parameters are tied.

    The tied ones that could be held are set to the other's values. On one ridge the rest then leads to the
    other maximum.
    """
    flat = flat_directions(other.information)
    held = to_hold(flat)
    rest = np.setdiff1d(np.arange(len(indices)), held)
    if not len(held) or not len(rest):
        return False
    start, goal = np.array(estimate), np.asarray(other.theta)
    start[indices[held]] = goal[indices[held]]
    names = [model.parameter_names[k] for k in indices[rest]]
    try:
        found = quasi_ml(model, all_series, start, names)
    except (ModelError, ArithmeticError, ValueError, np.linalg.LinAlgError):
        return False
    d = (np.asarray(found.theta) - goal)[indices[rest]]
    information = other.information[np.ix_(rest, rest)]
    return bool(d @ information @ d <= chi2_quantile(CONFIDENCE, len(indices)))


def _height(difference: float) -> str:
    if abs(difference) < SAME:
        return "the same"
    return f"{abs(difference):.2g} {'higher' if difference > 0.0 else 'lower'}"
