"""A point beside a maximum at the bound of a noise, where particles can follow the series.

Where a reading depends on the states nonlinearly and has next to no noise, hardly a particle agrees with it.
The data hardly tell such a noise from none, so that the moment filter's maximum may lie at its bound. A little
away from there the likelihood is the same, and particles follow.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from engine.estimation.e_steps import ParticleStep
from engine.estimation.expectation import parameter_scale
from engine.statespace.base import BaseModel, Theta

AT_BOUND = 1e-3  # of a parameter's size, within which it counts as at its bound
SHARES = 0.25 ** np.arange(
    16
)  # of the way back to the start value that are tried, the largest first
GIVEN_AWAY = 0.5  # nats that one parameter may cost, next to nothing beside what particles lose


def followable(
    model: BaseModel,
    theta: Theta,
    start: Theta,
    indices: NDArray[np.intp],
    particles: ParticleStep,
    seed: int,
) -> Theta:
    """Theta, or where particles lose the series there and free parameters are at bounds a point beside it.

    Each of those goes as far towards ``start`` as costs ``GIVEN_AWAY`` nats of the moment filter's likelihood.
    """
    moment = particles.moment
    at_bound = [k for k in indices.tolist() if _at_bound(model, theta, k)]
    if moment is None or not at_bound or _follow(particles, theta, seed):
        return theta
    beside = _off(theta, start, at_bound, lambda x: sum(moment(x, s) for s in particles.all_series))
    return beside if _follow(particles, beside, seed) else theta


def _follow(particles: ParticleStep, theta: Theta, seed: int) -> bool:
    return particles.follow(
        theta, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
    )


def _at_bound(model: BaseModel, theta: Theta, k: int) -> bool:
    near = AT_BOUND * parameter_scale(model, np.asarray(theta), k)
    return bool(min(theta[k] - model.lower[k], model.upper[k] - theta[k]) <= near)


def _off(
    theta: Theta, start: Theta, at_bound: list[int], moment: Callable[[Theta], float]
) -> Theta:
    """Theta with the parameters ``at_bound`` moved towards ``start``, one after the other."""
    values = np.array(theta)
    for k in at_bound:
        least = moment(Theta(values, theta.names)) - GIVEN_AWAY
        for share in SHARES:
            other = values.copy()
            other[k] += share * (start[k] - values[k])
            if moment(Theta(other, theta.names)) >= least:
                values = other
                break
    return Theta(values, theta.names)
