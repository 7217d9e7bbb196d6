"""Another maximum of the likelihood where a noise that went to nothing on the way is large.

The likelihood is flat in a standard deviation at 0, so a search that once came there stays: no slope leads on,
and between nothing and as much of it as the data call for there may be a valley. The same noise written as a
logarithm, or as a precision, vanishes far out. The moment filter may have led it there where particles know
better.
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
from engine.estimation.likelihood_step import LikelihoodStep
from engine.estimation.quasi_ml import ENOUGH, QuasiFit, log_likelihoods, quasi_ml, with_scales
from engine.estimation.wandering import clearly_likelier
from engine.filters.sigma_point import free_thetas
from engine.statespace.base import BaseModel, Theta
from engine.statespace.model import Array, MixedModel

NOTHING = 2.0  # nats: what is worth less cannot be told from nothing, and stays there
NEXT_TO = np.array([0.0, 1e-3])  # of the way from its bound, where the model may not be had
SIZES = 10.0 ** np.arange(-2.0, 4.1, 0.5)  # of the typical one, at which it is looked for
STRIDES = np.arange(1.0, 17.0) / 8.0  # of it, from where it stands, if it may be negative
CLIMBS = 3  # at most, from the best of them
NEAR = 0.1  # of its size: so near its lower bound a parameter has vanished for particles ...
FINER = 10.0 ** np.arange(-2.0, 2.1, 0.25)  # ... which look for it at these sizes

FAILURES = (EngineError, ArithmeticError, ValueError, np.linalg.LinAlgError)


def revived(fit: QuasiFit, all_series: Sequence[Series], tolerance: float = ENOUGH) -> QuasiFit:
    """The fit, or a higher one with more of what has vanished in it, searched for up to ``tolerance`` (nats).

    Vanished have free parameters that do as much at one of their bounds or far out, so far as ``NOTHING`` says:
    standard deviations and variances at 0, their logarithms and precisions where nobody would look for them.
    """
    for _ in range(CLIMBS):
        try:
            theta, indices = np.asarray(fit.theta), fit.model.free_indices(fit.free)
            model = with_scales(fit.model, all_series, theta, indices)
            value = fit.log_likelihood
            start = likelier_with_more(model, all_series, theta, indices, value)
            if start is None:
                break
            found = quasi_ml(fit.model, all_series, start, fit.free, tolerance=tolerance)
        except FAILURES:
            break
        if not found.log_likelihood > fit.log_likelihood + NOTHING:
            break
        fit = replace(found, rivals=fit.rivals)
    return fit


def likelier_with_more(
    model: MixedModel,
    all_series: Sequence[Series],
    theta: Array,
    indices: NDArray[np.intp],
    value: float,
) -> Array | None:
    """The likeliest theta (n_theta,) with more of one that has vanished; None where none is likelier.

    ``value`` is the log-likelihood at theta.
    """
    sides = [(int(k), up) for k in indices for up in (False, True)]
    if not sides:
        return None
    without = [without_it(model, theta, k, up) for k, up in sides]
    values = log_likelihoods(model, all_series, _each(theta, sides, without))
    flat = np.abs(values.reshape(len(sides), -1) - value).min(axis=1) <= NOTHING
    gone = [side for side, yes in zip(sides, flat, strict=True) if yes]
    if not gone:
        return None
    more = _each(theta, gone, [more_of_it(model, theta, k, up) for k, up in gone])
    values = log_likelihoods(model, all_series, more)
    return np.asarray(more[int(np.argmax(values))]) if values.max() > value else None


def without_it(model: BaseModel, theta: Array, k: int, up: bool) -> Array:
    """Values (2,) of parameter k at which there is next to nothing of a noise that vanishes to one side.

    At a bound, beside which the model can be had where it cannot be had there; else far out.
    """
    bound = float(model.upper[k] if up else model.lower[k])
    size = parameter_scale(model, theta, k) * (SIZES[-1] if up and model.lower[k] >= 0.0 else 1.0)
    if not np.isfinite(bound):
        bound = theta[k] + (size if up else -size)
    return np.asarray(bound + NEXT_TO * (theta[k] - bound))


def more_of_it(model: BaseModel, theta: Array, k: int, up: bool) -> Array:
    """Values (n,) of parameter k at which to look for a noise that vanished to one side.

    Of many sizes where it cannot be negative, as a standard deviation, or, upwards, a precision; else it may be
    a logarithm, and they are in steps back from where it stands, and around its default.
    """
    p, size = model.parameters[k], parameter_scale(model, theta, k)
    own = abs(p.default) or p.scale or size  # it may have gone anywhere
    if p.bounds[0] < 0.0:
        back = -STRIDES if up else STRIDES
        values = np.concatenate([theta[k] + back * size, p.default + (STRIDES - 1.0) * 2.0 * own])
    else:
        values = own / SIZES**2 if up else size * SIZES
    return np.asarray(np.clip(values, *p.bounds))


def _each(
    theta: Array, sides: Sequence[tuple[int, bool]], values: Sequence[Array] | Array
) -> Array:
    """Theta with the parameter of one side at one of its ``values``, each in turn (K, n_theta)."""
    return np.concatenate(
        [in_turn(theta, np.array([k]), v[None]) for (k, _), v in zip(sides, values, strict=True)]
    )


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
    x, points = np.asarray(theta), list[Array]()
    sizes = {k: parameter_scale(model, x, k) for k in indices.tolist()}
    near = {k for k in sizes if 0.0 <= model.lower[k] >= x[k] - NEAR * sizes[k]}
    sides = [(k, up) for k in sizes if k not in near for up in (False, True)]
    flat = _flat(
        model, theta, [(k, up) for k, up in sides if up or model.lower[k] < 0.0], particles
    )
    for k, size in sizes.items():
        if k in near:
            values = np.clip(FINER * size, model.lower[k], model.upper[k])
            points.extend(free_thetas(x, np.array([k]), values[values > x[k], None]))
        for side in flat:
            if side[0] == k:
                points.extend(_each(x, [side], [more_of_it(model, x, *side)]))
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


@np.errstate(invalid="ignore")  # where the filter of moments is lost
def _flat(
    model: BaseModel, theta: Theta, sides: Sequence[tuple[int, bool]], particles: ParticleStep
) -> list[tuple[int, bool]]:
    """Of ``sides`` (parameter, up) those on the way to which it does nothing, by the moment filter.

    That costs little, and least where one pass over time is made for all of them.
    """
    if particles.moment is None or not isinstance(model, MixedModel) or not sides:
        return []
    x = np.asarray(theta)
    every = _each(x, sides, [without_it(model, x, k, up) for k, up in sides])
    found = LikelihoodStep(model, particles.all_series).of_each(np.concatenate([x[None], every]))
    flat = (np.abs(found[1:].reshape(len(sides), -1) - found[0]) <= NOTHING).any(axis=1)
    return [side for side, yes in zip(sides, flat, strict=True) if yes]
