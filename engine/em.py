"""Maximum likelihood by EM; paper, Algorithm 1: one loop, several E steps.

Iteration k draws all its random numbers from ``SeedSequence(seed, spawn_key=(k,))`` and looks at
nothing but the trace before it, so a run stopped after any iteration and resumed from its
:class:`Checkpoint` gives the same bits as one that was never stopped.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from engine import display, plots
from engine.base_model import BaseModel
from engine.convergence import WINDOW, has_settled
from engine.e_steps import LOST_SHARE, EStep, Expect, rbps_step, rts_step
from engine.errors import OptionError
from engine.expectation import parameter_scale
from engine.likelihood_step import LikelihoodStep
from engine.maximization import Objective, maximize
from engine.model import Array, MixedModel, Theta, ThetaLike
from engine.outcome import Outcome
from engine.proposals import Proposal
from engine.quasi_ml import with_scales
from engine.series import Series, as_series_list
from engine.warm_start import FAR, moment_maximum


@dataclass(frozen=True)
class Iteration:
    """What the callback sees: iteration k of n, theta_k, and how the E step before it went.

    ``log_likelihood`` is that of the previous theta; ``ess`` the mean effective sample size;
    ``collapsed`` the share of rows at which the filter had one particle left.
    """

    k: int
    n_iterations: int
    theta: Theta
    log_likelihood: float
    ess: float
    seconds: float
    collapsed: float


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """All that resuming needs: trace (k+1, n_theta), log_likelihood, ess, seconds, collapsed (k,)."""

    trace: Array
    log_likelihood: Array
    ess: Array
    seconds: Array
    collapsed: Array


@dataclass(frozen=True, eq=False)
class EmResult:
    """The estimate and how it came about.

    ``theta`` the estimate; ``trace`` (K+1, n_theta) with the start first; ``log_likelihood`` (K,) of
    trace[:K] as estimated by each E step; ``ess`` (K,); ``seconds`` (K,); ``collapsed`` (K,) share of
    rows at which the filter collapsed; ``outcome``; ``message`` with the particulars;
    ``not_estimated`` names the free parameters that nothing could move: they are where they started.
    """

    model: BaseModel
    free: tuple[str, ...]
    theta: Theta
    trace: Array
    log_likelihood: Array
    ess: Array
    seconds: Array
    collapsed: Array
    outcome: Outcome
    message: str
    not_estimated: tuple[str, ...] = ()

    @property
    def checkpoint(self) -> Checkpoint:
        """What ``resume=`` takes to go on from here."""
        return Checkpoint(self.trace, self.log_likelihood, self.ess, self.seconds, self.collapsed)

    def plot(self, intervals: Array | None = None) -> plots.Figures:
        """``convergence``: every free parameter by iteration, log-likelihood, effective sample size.

        ``intervals`` (n_theta, 2) are drawn as bands: ``standard_errors(...).interval()``. Needs the
        extra ``plot``.
        """
        at = self.model.free_indices(self.free)
        figure = plots.convergence(
            {self.model.parameters[i].name: self.model.parameters[i].unit for i in at},
            self.trace[:, at],
            np.asarray(self.theta)[at],
            self.log_likelihood,
            self.ess,
            None if intervals is None else intervals[at],
        )
        return plots.Figures(convergence=figure)

    def _repr_html_(self) -> str:
        rows = [
            (p.name, value, p.unit, start, self._remark(p.name))
            for p, value, start in zip(
                self.model.parameters, self.theta.tolist(), self.trace[0].tolist(), strict=True
            )
        ]
        return display.show(
            f"{self.model.name}: {len(self.log_likelihood)} iterations of EM",
            display.line(self.message),
            display.table(("parameter", "estimate", "unit", "start", ""), rows),
        )

    def _remark(self, name: str) -> str:
        if name in self.not_estimated:
            return "not estimated"
        return "" if name in self.free else "fixed"


Callback: TypeAlias = Callable[[Iteration], Any]


def rbps_em(
    model: MixedModel,
    series: Series | Sequence[Series],
    theta0: ThetaLike = None,
    free: Sequence[str] | None = None,
    n_particles: int = 50,
    n_trajectories: int | None = None,
    n_iterations: int = 100,
    seed: int = 0,
    callback: Callback | None = None,
    resume: Checkpoint | EmResult | None = None,
    *,
    proposal: str | Proposal = "adapted",
    resampling: str = "systematic",
    ess_threshold: float = 0.5,
    smoother: str = "exact",
    recover: bool = True,
    m_step: str = "scoring",
    tolerance: float | None = 1e-3,
    warm_start: bool = True,
) -> EmResult:
    """Estimate theta from one or several series; paper, Algorithm 1 (RBPS-EM).

    ``theta0`` start values (default: the parameters' defaults); ``free`` names of the parameters to
    estimate (default: all); ``n_trajectories`` N (default: ``n_particles``); ``tolerance`` of the
    convergence rule in :mod:`engine.convergence`, None to use all iterations; ``callback`` sees every
    :class:`Iteration` and stops the run by returning True or raising StopIteration.

    ``smoother``: "exact" uses moments of z given whole trajectories of a, which converge as M grows;
    "algorithm-3" those of the report, eqs. (61), whose P and M keep the bias of Approximation 2;
    "linear-cost" is "exact" with trajectories drawn by MCMC moves, in O(M), see :mod:`engine.linear_cost`.
    ``recover``: run a filter that collapsed again with more particles (the paper does not).
    ``m_step``: "scoring" or "bfgs", see :mod:`engine.maximization`.
    ``warm_start``: let the first iteration leave from the maximum of an approximate likelihood where
    theta0 is far less likely, see :mod:`engine.warm_start`; False always starts EM at theta0.
    Parameters that move what has no noise are moved by :mod:`engine.likelihood_step`; ``message`` says so.
    Raises OptionError, SeriesError, ModelError.
    """
    listed = as_series_list(series, model)
    given, model = model, scaled(model, listed, theta0, free, resume)
    expect = rbps_step(
        model,
        listed,
        n_particles,
        n_particles if n_trajectories is None else n_trajectories,
        proposal=proposal,
        resampling=resampling,
        ess_threshold=ess_threshold,
        smoother=smoother,
        recover=recover,
    )
    indices = model.free_indices(free)
    found = iterate(
        model,
        expect,
        theta0,
        free,
        n_iterations,
        seed,
        callback,
        resume,
        m_step,
        tolerance,
        ahead=partial(moment_maximum, model, listed, indices) if warm_start else None,
        likelihood=LikelihoodStep(model, listed),
    )
    return replace(found, model=given)


def rts_em(
    model: MixedModel,
    series: Series | Sequence[Series],
    theta0: ThetaLike = None,
    free: Sequence[str] | None = None,
    n_iterations: int = 100,
    callback: Callback | None = None,
    resume: Checkpoint | EmResult | None = None,
    *,
    m_step: str = "scoring",
    tolerance: float | None = 1e-6,
) -> EmResult:
    """Exact EM for linear Gaussian models (RTS-EM of the paper, section V); no random numbers.

    Raises ModelError where the model is not linear Gaussian.
    """
    listed = as_series_list(series, model)
    given, model = model, scaled(model, listed, theta0, free, resume)
    found = iterate(
        model,
        rts_step(model, listed),
        theta0,
        free,
        n_iterations,
        0,
        callback,
        resume,
        m_step,
        tolerance,
        likelihood=LikelihoodStep(model, listed, "the exact"),
    )
    return replace(found, model=given)


def scaled(
    model: MixedModel,
    listed: Sequence[Series],
    theta0: ThetaLike,
    free: Sequence[str] | None,
    resume: Checkpoint | EmResult | None,
) -> MixedModel:
    """The model with the scales that its parameters have at the start of the trace."""
    start = model.theta(theta0 if resume is None else resume.trace[0])
    return with_scales(model, listed, start, model.free_indices(free))


def iterate(
    model: BaseModel,
    expect: Expect,
    theta0: ThetaLike,
    free: Sequence[str] | None,
    n_iterations: int,
    seed: int,
    callback: Callback | None,
    resume: Checkpoint | EmResult | None,
    m_step: str,
    tolerance: float | None,
    ahead: Callable[[Theta], Theta | None] | None = None,
    likelihood: LikelihoodStep | None = None,
) -> EmResult:
    """The loop of Algorithm 1: E step, M step, settled?

    ``ahead`` may name a point from which the first iteration leaves if that is far more likely;
    ``likelihood`` moves the parameters to which the Q-function is no guide.
    """
    if int(n_iterations) != n_iterations or n_iterations < 1:
        raise OptionError(
            f"n_iterations = {n_iterations}; a positive whole number is needed", "n_iterations"
        )
    indices = model.free_indices(free)
    names = tuple(model.parameter_names[i] for i in indices)
    log = _Log(model, theta0, resume, n_iterations)
    step = _Iterate(expect, indices, seed, m_step, ahead, likelihood)
    outcome, last = Outcome.ITERATIONS_USED_UP, None
    settled = log.settled(indices, tolerance)
    for k in range(log.k + 1, n_iterations + 1):
        if settled:
            break
        started = time.perf_counter()
        last = step(k, log.theta)
        it = log.add(k, last.theta, last.seen, time.perf_counter() - started)
        if not last.finite:
            outcome = Outcome.DIVERGED
            break
        settled = log.settled(indices, tolerance)
        if _stops(callback, it):
            outcome = Outcome.STOPPED_BY_CALLER
            break
    if settled and outcome is not Outcome.STOPPED_BY_CALLER:
        outcome = Outcome.CONVERGED
    if last is None and log.k:  # all was done before: the last iteration again, for what it said
        last = step(log.k, log.trace[-2])
    return log.result(names, outcome, last)


@dataclass(frozen=True, eq=False)
class _Iterated:
    """One iteration: theta after it, the E step before it; what the M step left from, and how it went."""

    theta: Theta
    seen: EStep
    finite: bool
    q: Objective
    at: Theta
    by_likelihood: tuple[str, ...] = ()
    whose: str = ""
    stuck: tuple[str, ...] = ()

    def not_moved(self, indices: Sequence[int]) -> tuple[str, ...]:
        """Names of the free parameters that neither Q nor the likelihood depends on."""
        silent = ~(np.diag(self.q.derivatives(self.at, np.array(indices, np.intp))[2]) > 0.0)
        moved = self.by_likelihood
        there = (self.theta.names[k] for k, quiet in zip(indices, silent, strict=True) if quiet)
        names = {*self.stuck, *(name for name in there if name not in moved)}
        return tuple(name for name in self.theta.names if name in names)


@dataclass(frozen=True, eq=False)
class _Iterate:
    """Iteration k from theta_{k-1}; it depends on nothing else."""

    expect: Expect
    indices: NDArray[np.intp]
    seed: int
    m_step: str
    ahead: Callable[[Theta], Theta | None] | None
    likelihood: LikelihoodStep | None

    def __call__(self, k: int, theta: Theta) -> _Iterated:
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(k,)))
        step = self.expect(theta, rng)
        origin, at = step, theta
        if k == 1 and self.ahead is not None:
            at, origin = _more_likely(self.expect, self.ahead(theta), theta, step, rng)
        if not np.isfinite(origin.log_likelihood):
            return _Iterated(at, step, False, origin.q, at)
        q, names = origin.q, np.array(theta.names)
        exact = q.moves_noise_free(at, self.indices)  # Q says nothing, or too little, about these
        new = Theta(maximize(q, at, self.indices[~exact], self.m_step), theta.names)
        stuck = exact.copy()
        if exact.any() and self.likelihood is not None:
            new, stuck[exact] = self.likelihood(new, self.indices[exact])
        return _Iterated(
            new,
            step,
            bool(np.isfinite(np.asarray(new)).all()),
            q,
            at,
            tuple(names[self.indices[exact & ~stuck]]),
            "" if self.likelihood is None else self.likelihood.whose,
            tuple(names[self.indices[stuck]]),
        )


def _more_likely(
    expect: Expect, other: Theta | None, theta: Theta, step: EStep, rng: np.random.Generator
) -> tuple[Theta, EStep]:
    """Theta with its E step, or the other if that is far more likely by the particle filter."""
    if other is not None:
        there = expect(other, rng)
        gain = there.log_likelihood - step.log_likelihood
        if np.isfinite(there.log_likelihood) and not gain < FAR:
            return other, there
    return theta, step


def _stops(callback: Callback | None, iteration: Iteration) -> bool:
    if callback is None:
        return False
    try:
        return callback(iteration) is True
    except StopIteration:
        return True


class _Log:
    """The trace as it grows."""

    def __init__(
        self,
        model: BaseModel,
        theta0: ThetaLike,
        resume: Checkpoint | EmResult | None,
        n_iterations: int,
    ) -> None:
        self.model, self.n_iterations = model, n_iterations
        self.lost_at = ""
        if resume is None:
            self.trace = [model.theta(theta0)]
            self.rows: list[tuple[float, float, float, float]] = []
            return
        if resume.trace.shape != (len(resume.log_likelihood) + 1, len(model.parameters)):
            raise OptionError(
                f"resume has a trace of shape {resume.trace.shape} and "
                f"{len(resume.log_likelihood)} log-likelihoods; model '{model.name}' needs "
                f"(k + 1, {len(model.parameters)}) and k",
                "resume",
            )
        self.trace = [model.theta(row) for row in resume.trace]
        self.rows = list(
            zip(
                resume.log_likelihood.tolist(),
                resume.ess.tolist(),
                resume.seconds.tolist(),
                resume.collapsed.tolist(),
                strict=True,
            )
        )

    @property
    def k(self) -> int:
        return len(self.rows)

    @property
    def theta(self) -> Theta:
        return self.trace[-1]

    def add(self, k: int, theta: Theta, step: EStep, seconds: float) -> Iteration:
        self.trace.append(theta)
        self.lost_at = step.lost_at or self.lost_at
        self.rows.append((step.log_likelihood, step.ess, seconds, step.collapsed))
        return Iteration(
            k, self.n_iterations, theta, step.log_likelihood, step.ess, seconds, step.collapsed
        )

    def settled(self, indices: Any, tolerance: float | None) -> bool:
        if tolerance is None or self.k < 2 * WINDOW:
            return False
        trace = np.array(self.trace[-2 * WINDOW - 1 :])
        theta = np.asarray(self.theta)
        scale = np.array([parameter_scale(self.model, theta, k) for k in indices])
        return has_settled(trace[:, indices], scale, tolerance)

    def result(self, names: tuple[str, ...], outcome: Outcome, last: _Iterated | None) -> EmResult:
        trace = np.array([np.asarray(row) for row in self.trace])
        columns = np.array(self.rows).reshape(-1, 4).T
        theta = trace[-1]
        if outcome is Outcome.CONVERGED:
            theta = trace[-WINDOW:].mean(axis=0)
        lost = columns[3][-WINDOW:].mean() if self.k else 0.0
        if outcome is not Outcome.DIVERGED and lost > LOST_SHARE:
            outcome = Outcome.COLLAPSED
        message = outcome.value
        if lost > 0.0:
            message += f" The filter was left with one particle at {100 * lost:.1f} % of the rows"
            message += f", first at {self.lost_at}." if self.lost_at else "."
        stuck: tuple[str, ...] = ()
        if last is not None and outcome is not Outcome.DIVERGED:
            stuck = last.not_moved([self.model.index(name) for name in names])
        if last is not None and last.by_likelihood:
            message += (
                f" Estimated by scoring on {last.whose} likelihood, as EM cannot move what enters "
                f"without noise: {', '.join(last.by_likelihood)}."
            )
        if stuck:
            message += (
                f" Not estimated, as the likelihood does not depend on them here or cannot be had: "
                f"{', '.join(stuck)}. Hold them fixed (free=), or start elsewhere."
            )
        return EmResult(
            self.model,
            names,
            Theta(theta, self.model.parameter_names),
            trace,
            columns[0],
            columns[1],
            columns[2],
            columns[3],
            outcome,
            message,
            stuck,
        )
