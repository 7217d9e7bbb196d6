"""Noise parameters by restricted likelihood: what the other parameters have taken up is given back.

Parameters that are fitted to a record take up some of what its noise does, above all of slow process noise
where inputs move seldom; the maximum of the likelihood then takes the noise for smaller than it is, or for
none. With lambda the parameters that move predictions and psi those of the noise,

    l_R(psi) = max over lambda of l(lambda, psi) - 1/2 log det H_lambda(lambda, psi)

(Patterson, Thompson 1971; Cox, Reid 1987) counts what lambda has taken up. For a linear regression its maximum
divides the squares by the readings less the parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from engine.arrays import Array
from engine.data.series import Series
from engine.estimation.expectation import either_side
from engine.estimation.maximization import scoring_step
from engine.estimation.quasi_ml import DAMPING, QuasiFit, derivatives, with_scales
from engine.statespace.model import MixedModel, Theta
from engine.statespace.refutation import repeated_if_refuted

STEPS = 12
SETTLED = 0.01  # an expected gain in log-likelihood below this ends the search
HALVINGS = 8  # of a step
DIFFERENCE = 0.01  # of a noise parameter's scale, between which log det H is compared
RIDGE = 1e-8  # of H scaled to a unit diagonal: what no record tells of counts alike everywhere


@repeated_if_refuted
def restricted(fit: QuasiFit, series: Series, noise: NDArray[np.bool_]) -> QuasiFit:
    """The fit with its noise parameters at the restricted maximum, and the others moved along.

    ``noise`` (n_free,) marks the noise parameters among the free ones. ``log_likelihood`` stays that of the
    record, without log det H. Where all parameters are of one kind it is the fit as it was.
    """
    theta = np.asarray(fit.theta)
    indices = fit.model.free_indices(fit.free)
    if noise.all() or not noise.any():
        return fit
    model = with_scales(fit.model, [series], theta, indices)
    moving, psi = indices[~noise], indices[noise]
    lower, upper = model.lower[indices], model.upper[indices]
    value, g, H = derivatives(model, [series], theta, indices)
    scale = np.sqrt(np.maximum(np.diag(H)[~noise], np.finfo(float).tiny))

    def taken(at: Array) -> float:
        scaled = derivatives(model, [series], at, moving)[2] / np.outer(scale, scale)
        return float(np.linalg.slogdet(scaled + RIDGE * np.eye(len(scale)))[1])

    own = taken(theta)
    for _ in range(STEPS):
        g[noise] -= 0.5 * np.array([_slope(taken, model, theta, int(k)) for k in psi])
        direction = scoring_step(theta[indices], g, H, lower, upper, DAMPING)
        if not float(g @ direction) > SETTLED:
            break
        for step in 0.5 ** np.arange(HALVINGS):
            moved = theta.copy()
            moved[indices] = np.clip(theta[indices] + step * direction, lower, upper)
            there, then = derivatives(model, [series], moved, indices), taken(moved)
            if there[0] - 0.5 * then > value - 0.5 * own:
                break
        else:
            break
        theta, (value, g, H), own = moved, there, then
    best = Theta(theta, model.parameter_names)
    return replace(fit, theta=best, log_likelihood=float(value), information=H)


def _slope(function: Callable[[Array], float], model: MixedModel, theta: Array, k: int) -> float:
    low, high = either_side(model, theta, k, DIFFERENCE)
    return float((function(high) - function(low)) / (high[k] - low[k]))
