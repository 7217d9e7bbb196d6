"""Another maximum of the likelihood where a noise that went to nothing on the way is large.

The likelihood is flat in a standard deviation at 0, so a search that once came there stays: no slope leads on,
and between nothing and as much of it as the data call for there may be a valley. The moment filter may have led
it there where particles know better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.errors import EngineError
from engine.estimation.e_steps import ParticleStep
from engine.estimation.edges import in_turn
from engine.estimation.expectation import parameter_scale
from engine.estimation.quasi_ml import ENOUGH, QuasiFit, log_likelihoods, quasi_ml, with_scales
from engine.estimation.wandering import clearly_likelier
from engine.filters.sigma_point import free_thetas
from engine.statespace.base import BaseModel, Theta
from engine.statespace.model import Array

NOTHING = 2.0  # nats: what is worth less cannot be told from nothing, and stays there
NEXT_TO = np.array([0.0, 1e-3])  # of the way from its bound, where the model may not be had
SIZES = 10.0 ** np.arange(-2.0, 4.1, 0.5)  # of the typical one, at which it is looked for
CLIMBS = 3  # at most, from the best of them
NEAR = 0.1  # of its size: so near its lower bound a parameter has vanished for particles ...
FINER = 10.0 ** np.arange(-2.0, 2.1, 0.25)  # ... which look for it at these sizes

FAILURES = (EngineError, ArithmeticError, ValueError, np.linalg.LinAlgError)


def revived(fit: QuasiFit, all_series: Sequence[Series], tolerance: float = ENOUGH) -> QuasiFit:
    """The fit, or a higher one with more of what has vanished in it, searched for up to ``tolerance`` (nats).

    Vanished have free parameters that cannot be negative and do as much at their lower bound, as far as
    ``NOTHING`` tells.
    """
    for _ in range(CLIMBS):
        try:
            start = _more_of_it(fit, all_series)
            if start is None:
                break
            found = quasi_ml(fit.model, all_series, start, fit.free, tolerance=tolerance)
        except FAILURES:
            break
        if not found.log_likelihood > fit.log_likelihood + NOTHING:
            break
        fit = replace(found, rivals=fit.rivals)
    return fit


def _more_of_it(fit: QuasiFit, all_series: Sequence[Series]) -> Array | None:
    """The likeliest theta (n_theta,) with more of one that has vanished; None where none is likelier."""
    theta, indices = np.asarray(fit.theta), fit.model.free_indices(fit.free)
    model = with_scales(fit.model, all_series, theta, indices)
    sizes = indices[model.lower[indices] >= 0.0]
    value = fit.log_likelihood
    if not sizes.size:
        return None
    least = model.lower[sizes, None] + NEXT_TO * (theta[sizes] - model.lower[sizes])[:, None]
    without = log_likelihoods(model, all_series, in_turn(theta, sizes, least))
    gone = sizes[np.abs(without.reshape(least.shape) - value).min(axis=1) <= NOTHING]
    if not gone.size:
        return None
    scales = np.array([parameter_scale(model, theta, int(k)) for k in gone])
    low, high = model.lower[gone, None], model.upper[gone, None]
    more = in_turn(theta, gone, np.clip(scales[:, None] * SIZES, low, high))
    values = log_likelihoods(model, all_series, more)
    if not values.max() > value:
        return None
    return np.asarray(more[int(np.argmax(values))])


def revived_by_particles(
    model: BaseModel,
    theta: Theta,
    indices: NDArray[np.intp],
    particles: ParticleStep,
    seed: int,
) -> Theta | None:
    """Theta with more of a free parameter that has vanished; None where that is not clearly likelier.

    By particle filters, as the moment filter may be what made it vanish.
    """
    x = np.asarray(theta)
    points: list[Array] = []
    for k in indices[model.lower[indices] >= 0.0].tolist():
        size = parameter_scale(model, x, k)
        if x[k] - model.lower[k] <= NEAR * size:
            values = np.clip(FINER * size, model.lower[k], model.upper[k])
            points.extend(free_thetas(x, np.array([k]), values[values > x[k], None]))
    best, highest = None, -np.inf
    for one in (Theta(point, theta.names) for point in points):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
        try:
            value = particles.log_likelihood(one, 1, rng)
        except FAILURES:  # so far out a user's function may fail
            continue
        if value > highest:
            best, highest = one, value
    return best if best is not None and clearly_likelier(theta, best, particles, seed) else None
