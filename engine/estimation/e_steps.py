"""The E steps of EM: from theta_k to the Q-function; paper, Algorithm 1, step 2.

An E step is a function of theta and a random generator that returns an :class:`EStep`. RBPS-EM runs
the RBPF and the RB-FFBSi, RTS-EM the Kalman smoother; what follows is the same for all.

Few particles may lose a series without one of them ever being left alone: where there is next to no process
noise, those of t = 1 have to do for all times. A filter that is followed is therefore compared with the moment
filter, which has no such trouble, and run again with more particles where it falls short of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.errors import ModelError, OptionError
from engine.estimation.expectation import expectation
from engine.estimation.linear import as_linear
from engine.estimation.maximization import Objective
from engine.failing import where_it_fails
from engine.filters.kalman import kalman_smoother
from engine.filters.lost import nats_short
from engine.filters.proposals import Proposal, get_proposal
from engine.filters.rbpf import Filtered, check_options, rbpf
from engine.smoothers.exact_conditional import condition_on_trajectories
from engine.smoothers.linear_cost import rb_ffbsi_linear
from engine.smoothers.moments import Moments
from engine.smoothers.rb_ffbsi import rb_ffbsi
from engine.statespace.base import Array, BaseModel
from engine.statespace.checks import failure
from engine.statespace.model import MixedModel, Theta
from engine.statespace.points import Points

SMOOTHERS = ("exact", "algorithm-3", "linear-cost")
LOST_SHARE = 0.05  # a filter that collapses at more than this share of its rows is run again ...
RETRIES = (4, 16)  # ... with this many times the particles


@dataclass(frozen=True, eq=False)
class EStep:
    """The Q-function at theta_k with the log-likelihood and health of the filter behind it.

    ``ess`` is the mean effective sample size, ``collapsed`` the share of rows with one particle left,
    ``times`` how many times the particles asked for were needed. ``failed`` says why there is none, see
    :func:`or_none`.
    """

    q: Objective
    log_likelihood: float
    ess: float
    collapsed: float
    times: int = 1
    failed: str = ""


Expect: TypeAlias = Callable[[Theta, np.random.Generator], EStep]


@dataclass(frozen=True, eq=False)
class _Nowhere:
    """The Q-function of an E step that cannot be made: it knows nothing, and forbids nothing."""

    model: BaseModel

    def value(self, theta: Array) -> float:
        return -np.inf

    def derivatives(self, theta: Array, free: NDArray[np.intp]) -> tuple[float, Array, Array]:
        n = len(free)
        return -np.inf, np.zeros(n), np.zeros((n, n))

    def possible(self, theta: Array) -> bool:
        return True

    def moves_noise_free(self, theta: Array, free: NDArray[np.intp]) -> NDArray[np.bool_]:
        return np.zeros(len(free), dtype=bool)


def or_none(model: BaseModel, expect: Expect, theta: Theta, rng: np.random.Generator) -> EStep:
    """The E step, or one without a likelihood where a calculation of the model fails at theta."""
    try:
        return expect(theta, rng)
    except ModelError as error:
        if not error.numeric:
            raise
        return EStep(_Nowhere(model), -np.inf, 1.0, 0.0, failed=str(error))


@dataclass(frozen=True)
class ParticleStep:
    """The E step by particles: filter every series, smooth it, make the Q-function of all.

    ``run(theta, series, M, rng)`` filters, with more particles where it collapsed and ``recover`` is true;
    ``smooth(filtered, series, rng)`` gives what the ``objective(theta, [...])`` needs of one series.
    ``moment(theta, series)`` is the log-likelihood of the moment filter, if there is one.
    """

    all_series: Sequence[Series]
    run: Callable[..., Any]
    smooth: Callable[[Any, Series, np.random.Generator], Any]
    objective: Callable[[Theta, list[Any]], Objective]
    n_particles: int
    recover: bool
    moment: Callable[[Theta, Series], float] | None = None

    def __call__(self, theta: Theta, rng: np.random.Generator) -> EStep:
        """Q(., theta) with random numbers of ``rng``."""
        return self._step(theta, rng, None)

    def compared(self, theta: Theta, rng: np.random.Generator) -> EStep:
        """The same by filters that do not fall short of the moment filter, as far as more particles help."""
        return self._step(theta, rng, self.moment)

    @where_it_fails(-np.inf)
    def log_likelihood(self, theta: Theta, times: int, rng: np.random.Generator) -> float:
        """Of all series, by filters of ``times`` as many particles; -inf where the model cannot be had."""
        n = times * self.n_particles
        return float(sum(self.run(theta, s, n, rng).log_likelihood for s in self.all_series))

    @where_it_fails(False)
    def follow(self, theta: Theta, rng: np.random.Generator) -> bool:
        """Whether filters do not fall short of the moment filter, if need be with more particles."""
        return all(self._filtered(theta, s, self.moment, rng)[2] for s in self.all_series)

    def _filtered(
        self,
        theta: Theta,
        one: Series,
        moment: Callable[[Theta, Series], float] | None,
        rng: np.random.Generator,
    ) -> tuple[Any, int, bool]:
        """The filter of one series, by how many times the particles, and whether they followed it."""
        wanted = -np.inf if moment is None or not self.recover else moment(theta, one)
        for times in (1, *RETRIES) if self.recover else (1,):
            filtered = self.run(theta, one, times * self.n_particles, rng)
            kept = len(filtered.collapsed) <= LOST_SHARE * len(one)
            short = nats_short(len(one), float(filtered.ess.mean()))
            followed = kept and not filtered.log_likelihood < wanted - short
            if followed:
                break
        return filtered, times, followed

    def _step(
        self,
        theta: Theta,
        rng: np.random.Generator,
        moment: Callable[[Theta, Series], float] | None,
    ) -> EStep:
        smoothed, log_likelihood, ess, lost, most = [], 0.0, 0.0, 0, 1
        for one in self.all_series:
            filtered, times, _ = self._filtered(theta, one, moment, rng)
            smoothed.append(self.smooth(filtered, one, rng))
            log_likelihood += filtered.log_likelihood
            ess += float(filtered.ess.sum())
            lost += len(filtered.collapsed)
            most = max(most, times)
        n = sum(map(len, self.all_series))
        return EStep(self.objective(theta, smoothed), log_likelihood, ess / n, lost / n, most)


def rbps_step(
    model: MixedModel,
    all_series: Sequence[Series],
    n_particles: int,
    n_trajectories: int,
    *,
    proposal: str | Proposal = "adapted",
    resampling: str = "systematic",
    ess_threshold: float = 0.5,
    smoother: str = "exact",
    recover: bool = True,
    moment: Callable[[Theta, Series], float] | None = None,
) -> ParticleStep:
    """RBPF and RB-FFBSi over every series; options as in :func:`engine.rbps_em`, ``moment`` as for the step."""
    check_options(n_particles, resampling, ess_threshold)
    get_proposal(proposal)
    if smoother not in SMOOTHERS:
        raise OptionError(
            f"smoother '{smoother}' is not known; use exact or algorithm-3 or linear-cost",
            "smoother",
        )

    def smooth(filtered: Filtered, one: Series, rng: np.random.Generator) -> Any:
        if smoother == "linear-cost":
            draws = rb_ffbsi_linear(filtered, n_trajectories, rng, condition=False)
        else:
            draws = rb_ffbsi(filtered, n_trajectories, rng, joint=smoother == "exact")
        points = Points(model, one, draws.a, filtered.theta)
        if smoother != "algorithm-3":
            draws = condition_on_trajectories(draws, points)
        return Moments(draws.a, draws.z, draws.cov, draws.cross), points

    filter_by = partial(
        rbpf, model, proposal=proposal, resampling=resampling, ess_threshold=ess_threshold
    )

    @np.errstate(all="ignore")  # at a trial of the parameters
    def run(theta: Theta, one: Series, particles: int, rng: np.random.Generator) -> Filtered:
        filtered = filter_by(theta, one, particles, rng)
        if not np.isfinite(filtered.log_likelihood):  # for want of numbers, or of particles
            failed = failure(model, np.asarray(theta), [one])
            if failed is not None:
                raise failed
        return filtered

    objective = partial(expectation, model)
    return ParticleStep(all_series, run, smooth, objective, n_particles, recover, moment)


def rts_step(model: MixedModel, all_series: Sequence[Series]) -> Expect:
    """The exact Kalman smoother over every series, for linear Gaussian models."""
    linear = as_linear(model)

    def expect(theta: Theta, rng: np.random.Generator) -> EStep:
        smoothed, log_likelihood = [], 0.0
        for one in all_series:
            k = kalman_smoother(model, theta, one)
            points = Points(linear, one, np.zeros((len(one), 1, 0)))
            moments = Moments(points.a, k.x[:, None], k.P[:, None], k.M[:, None])
            smoothed.append((moments, points))
            log_likelihood += k.log_likelihood
        return EStep(expectation(linear, theta, smoothed), log_likelihood, 1.0, 0.0)

    return expect
