"""The score of the free parameters.

Fisher's identity gives it as the gradient of the Q-function at its own theta,

    s(theta) = d log p_theta(y) / d theta = d Q(theta', theta) / d theta' at theta' = theta,

so that any E step yields it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.errors import ModelError
from engine.estimation.e_steps import Expect, ParticleStep, rbps_step, rts_step
from engine.estimation.likelihood_step import LikelihoodStep, score_of
from engine.estimation.particle_likelihood import ParticleLikelihood, likelihood_of
from engine.estimation.quasi_ml import log_likelihoods, with_scales
from engine.filters.sigma_point import free_thetas
from engine.statespace.model import Array, MixedModel, Theta


@dataclass(frozen=True, eq=False)
class Score:
    """The score in the parameters ``indices`` (n,), the others held at ``theta``.

    It is an average over trajectories drawn by the particle smoother, or, where ``exact``, comes
    from the Kalman smoother and needs no random numbers. Fisher's identity does not hold for parameters
    that move what has no noise: theirs is that of ``likelihood``, see :mod:`engine.estimation.likelihood_step`.
    """

    model: MixedModel
    theta: Theta
    indices: NDArray[np.intp]
    expect: Expect
    exact: bool
    likelihood: LikelihoodStep
    particles: ParticleStep | None = None

    @classmethod
    def of(
        cls,
        model: MixedModel,
        theta: Theta,
        all_series: Sequence[Series],
        indices: NDArray[np.intp],
        n_particles: int,
        n_trajectories: int,
        exact: bool,
    ) -> Score:
        """With the default particle smoother, or the exact one (linear Gaussian models)."""
        model = with_scales(model, all_series, theta, indices)
        likelihood = LikelihoodStep(model, all_series, exact)
        if exact:
            return cls(model, theta, indices, rts_step(model, all_series), True, likelihood)
        moment = _remembered(likelihood.of)
        likelihood = likelihood_of(model, all_series, theta, n_particles, indices)
        expect = rbps_step(model, all_series, n_particles, n_trajectories, moment=moment)
        return cls(model, theta, indices, expect.compared, False, likelihood, expect)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters it is taken in."""
        return tuple(self.model.parameter_names[i] for i in self.indices)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper (n,)."""
        return self.model.lower[self.indices], self.model.upper[self.indices]

    @property
    def x(self) -> Array:
        """The parameters it is taken in (n,), at ``theta``."""
        return np.asarray(self.theta)[self.indices]

    def value(self, x: Array) -> float:
        """The log-likelihood at values x (n,) of the parameters, by the filter of moments or the exact one."""
        values = np.array(self.theta)
        values[self.indices] = x
        return self.likelihood.of(Theta(values, self.theta.names))

    def values(self, points: Array) -> Array:
        """The same at points (..., n), by the filter of moments; NaN for all where it cannot be had."""
        thetas = free_thetas(np.asarray(self.theta), self.indices, points.reshape(-1, len(self.x)))
        try:
            found = log_likelihoods(self.model, self.likelihood.all_series, thetas)
        except (ModelError, ArithmeticError, ValueError, np.linalg.LinAlgError):
            found = np.full(len(thetas), np.nan)
        return found.reshape(points.shape[:-1])

    def information(self, x: Array) -> Array | None:
        """Of the parameters (n, n) at values x (n,), by the filter of moments; None where it cannot be had."""
        if isinstance(self.likelihood, ParticleLikelihood):  # that filter is blind
            return None
        values = np.array(self.theta)
        values[self.indices] = x
        return self.likelihood.information(values, self.indices)

    def at(self, x: Array, seed: np.random.SeedSequence) -> tuple[Array, Array]:
        """Score (n,) at values x (n,) of the parameters, and complete-data information (n, n)."""
        values = np.array(self.theta)
        values[self.indices] = x
        theta = Theta(values, self.theta.names)
        if isinstance(self.likelihood, ParticleLikelihood) and self.guided:
            return self.likelihood.drawn(seed).score(theta, self.indices)
        q = self.expect(theta, np.random.default_rng(seed)).q
        return score_of(q, theta, self.indices, self.likelihood)[:2]

    @cached_property
    def guided(self) -> bool:
        """Whether one of the parameters moves what has no noise, or a jump."""
        q = self.expect(self.theta, np.random.default_rng(0)).q
        return bool(self.likelihood.guides(q, self.theta, self.indices).any())


def _remembered(moment: Callable[[Theta, Series], float]) -> Callable[[Theta, Series], float]:
    """The same, asked once for each theta and series: the score is drawn many times at one point."""
    known: dict[tuple[bytes, int], float] = {}

    def remembered(theta: Theta, series: Series) -> float:
        key = (np.asarray(theta).tobytes(), id(series))
        if key not in known:
            known[key] = moment(theta, series)
        return known[key]

    return remembered


def shift_within(x: Array, step: Array, lower: Array, upper: Array, most: float) -> float:
    """The largest share (at most ``most``) of a step from x (n,) that stays well within the bounds."""
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(
            step > 0.0, (upper - x) / step, np.where(step < 0.0, (lower - x) / step, np.inf)
        )
    return float(min(most, 0.9 * room.min()))


def inside(model: MixedModel, theta: Theta, free: Sequence[str] | None) -> NDArray[np.intp]:
    """Positions of the free parameters that are not at one of their bounds."""
    indices = model.free_indices(free)
    within = (theta[indices] > model.lower[indices]) & (theta[indices] < model.upper[indices])
    out: NDArray[np.intp] = indices[within]
    return out
