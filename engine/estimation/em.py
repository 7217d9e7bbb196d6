"""Maximum likelihood by EM; paper, Algorithm 1: RBPS-EM, and the exact EM of linear Gaussian models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from engine.data.faults import about_faults
from engine.data.given import as_series_list, check_enough
from engine.data.series import Series
from engine.data.shared_rows import about_shared_rows
from engine.errors import OptionError
from engine.estimation.about_edges import about_edges
from engine.estimation.beginnings import about_beginnings
from engine.estimation.e_steps import rbps_step, rts_step
from engine.estimation.em_loop import Callback, Loop, iterate
from engine.estimation.em_result import Checkpoint as Checkpoint
from engine.estimation.em_result import EmResult as EmResult
from engine.estimation.em_result import Iteration as Iteration
from engine.estimation.likelihood_step import LikelihoodStep
from engine.estimation.long_steps import about_predictions
from engine.estimation.other_maxima import about_other_maxima
from engine.estimation.outcome import Outcome
from engine.estimation.own_steps import about_own_steps
from engine.estimation.particle_likelihood import likelihood_of
from engine.estimation.quasi_ml import with_scales
from engine.estimation.quasi_newton import Ascent
from engine.estimation.start import WarmStart
from engine.estimation.summit import Summit
from engine.filters.proposals import Proposal
from engine.statespace.base import BaseModel
from engine.statespace.clock import about_clock
from engine.statespace.model import MixedModel, Theta, ThetaLike
from engine.statespace.on_tape import about_calls
from engine.threads import single_threaded

METHODS = ("quasi-newton", "em")
UPHILL = "uphill"
STANDS_STILL = "Converged: the iterates stand still."  # there is no Monte Carlo noise
WORTH = 20.0  # nats per parameter and ``tolerance`` that Monte Carlo noise may cost


@single_threaded
def rbps_em(  # noqa: PLR0913
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
    warm_start: bool | str = True,
    method: str = "quasi-newton",
) -> EmResult:
    """Estimate theta from one or several series by maximum likelihood; paper, Algorithm 1 (RBPS-EM).

    Parameters of equations without noise have no M step; they are moved by steps on the likelihood instead, and
    ``message`` of the result says so.

    Parameters
    ----------
    model : MixedModel
        The model, paper, eq. (1).
    series : Series or sequence of Series
        One experiment or several; y (T, ny) with NaN where missing, u (T, nu), times.
    theta0 : Theta, mapping, array or None
        Start values: all as (n_theta,), some by name, or None for the model's defaults.
    free : sequence of str, optional
        Names of the parameters to estimate, all by default; the others keep their start value.
    n_particles : int
        Number of particles M.
    n_trajectories : int, optional
        Number of trajectories N; as many as particles by default.
    n_iterations : int
        Upper limit on iterations; fewer where the iterates settle.
    seed : int
        Seed of all random numbers; the same seed gives the same result to the last bit.
    callback : callable, optional
        Called with every :class:`Iteration`; stops the run by returning True or raising StopIteration.
    resume : Checkpoint or EmResult, optional
        Earlier iterations to go on from, in place of ``theta0``; the result is that of a run that was never
        stopped, to the last bit.
    proposal : str or callable
        Density that new particles are drawn from: ``adapted`` uses y_t, ``bootstrap`` does not; or a function
        of a :class:`engine.filters.proposals.Step` that returns draws (M, na) and their log-densities (M,).
    resampling : str
        ``multinomial``, ``stratified``, ``systematic``, ``residual`` or ``sorted``, as for :func:`rbpf`.
    ess_threshold : float
        Resample where the effective sample size is at most this share of M (1: at every step, 0: never).
    smoother : str
        Moments of z for the E step. ``exact``: given whole trajectories of a, which converge as M grows.
        ``algorithm-3``: those of the report, eqs. (61), whose P and M keep the bias of Approximation 2.
        ``linear-cost``: as ``exact``, with trajectories drawn by Markov chain Monte Carlo moves in O(M).
    recover : bool
        Run a filter that collapsed, or fell far short of the moment filter, again with more particles.
        ``quasi-newton`` then ends at a point that the moment filter finds ahead, where the particle filter
        finds it likelier, too. Where the model is linear Gaussian it ends at the maximum of the exact
        likelihood. Where iterates settle with a noise that vanished, next to its lower bound or where its
        logarithm does nothing, they go on from more of it that particles find clearly likelier. The papers do
        none of this.
    m_step : str
        How the M step maximises Q: ``scoring`` by Fisher scoring, ``bfgs`` by quasi-Newton steps.
    tolerance : float, optional
        Share of a parameter's size by which the means of older and newer iterates may differ once they have
        settled, beside their Monte Carlo error. For ``method="quasi-newton"`` the log-likelihood that Monte
        Carlo noise may cost is 20 nats per parameter times it. None uses all iterations.
    warm_start : bool or "uphill"
        True searches around ``theta0`` for the maxima of the moment filter's approximate likelihood, and starts
        from the one above ``theta0``, or from another that particles find clearly likelier; "uphill" climbs to
        the one above ``theta0`` alone, in a fraction of the time, where starts are spread already or lie near
        the maximum; False always starts at ``theta0``.
    method : str
        ``quasi-newton`` takes steps on the log-likelihood by the score that each E step gives, and steps of EM
        where it cannot; ``em`` is Algorithm 1 of the paper.

    Returns
    -------
    EmResult
        The estimate, the trace (K+1, n_theta), log-likelihoods, and how it ended in words.

    Raises
    ------
    OptionError
        An option is not known or out of its range; ``field`` names it.
    SeriesError
        Channels or units are not the model's, or nothing was measured; names the channel. Or there are no more
        readings than free parameters.
    ModelError
        A function of the model fails, or returns a wrong shape or covariance; names the function and the time.
    """
    newton = _is_newton(method)
    all_series = as_series_list(series, model)
    check_enough(all_series, len(model.free_indices(free)))
    given, model = model, scaled(model, all_series, theta0, free, resume)
    first = first_of(model, theta0, resume)
    indices = model.free_indices(free)
    likelihood = likelihood_of(model, all_series, first, n_particles, indices)
    expect = rbps_step(
        model,
        all_series,
        n_particles,
        n_particles if n_trajectories is None else n_trajectories,
        proposal=proposal,
        resampling=resampling,
        ess_threshold=ess_threshold,
        smoother=smoother,
        recover=recover,
        moment=LikelihoodStep(model, all_series).of,
    )
    start = _start(model, all_series, indices, warm_start)
    loop = Loop(theta0, free, n_iterations, seed, callback, resume, m_step, tolerance)
    ascent = _ascent(likelihood, indices, tolerance) if newton else None
    particles = expect if recover else None
    summit = None
    if newton and recover and type(likelihood) is LikelihoodStep:
        worth = ascent.worth * len(indices) if ascent is not None else 0.0
        exact = LikelihoodStep(model, all_series, exact=True, worth=1e-8)
        summit = Summit(exact, worth, partial(_known, start, first))
    found = iterate(model, expect, loop, start, likelihood, ascent, particles, summit)
    note = f" {start.note}" if start is not None and start.note else ""
    note += remark(given, found, all_series)
    note += _other_maxima(start, found, first, all_series)
    return replace(found, model=given, message=found.message + note)


@single_threaded
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
    method: str = "quasi-newton",
) -> EmResult:
    """Estimate a linear Gaussian model by the exact smoother (RTS-EM of the paper, section V).

    There are no random numbers.

    Parameters
    ----------
    model : MixedModel
        The model, paper, eq. (1).
    series : Series or sequence of Series
        One experiment or several; y (T, ny) with NaN where missing, u (T, nu), times.
    theta0 : Theta, mapping, array or None
        Start values: all as (n_theta,), some by name, or None for the model's defaults.
    free : sequence of str, optional
        Names of the parameters to estimate, all by default; the others keep their start value.
    n_iterations : int
        Upper limit on iterations; fewer where the iterates settle.
    callback : callable, optional
        Called with every :class:`Iteration`; stops the run by returning True or raising StopIteration.
    resume : Checkpoint or EmResult, optional
        Earlier iterations to go on from, in place of ``theta0``; the result is that of a run that was never
        stopped, to the last bit.
    m_step : str
        How the M step maximises Q: ``scoring`` or ``bfgs``, as for :func:`rbps_em`.
    tolerance : float, optional
        Share of a parameter's size by which iterates may still move once they have settled; None uses all
        iterations.
    method : str
        ``quasi-newton``, or ``em`` as in the paper, as for :func:`rbps_em`.

    Returns
    -------
    EmResult
        The estimate, the trace (K+1, n_theta), log-likelihoods, and how it ended in words.

    Raises
    ------
    ModelError
        The model is not linear Gaussian.
    OptionError
        An option is not known or out of its range; ``field`` names it.
    SeriesError
        Channels or units are not the model's, or nothing was measured; names the channel. Or there are no more
        readings than free parameters.
    """
    newton = _is_newton(method)
    all_series = as_series_list(series, model)
    check_enough(all_series, len(model.free_indices(free)))
    given, model = model, scaled(model, all_series, theta0, free, resume)
    loop = Loop(theta0, free, n_iterations, 0, callback, resume, m_step, tolerance)
    likelihood = LikelihoodStep(model, all_series, exact=True, worth=1e-8)
    ascent = _ascent(likelihood, model.free_indices(free), tolerance, True) if newton else None
    expect = rts_step(model, all_series)
    summit = Summit(likelihood, 0.0, checked=True)
    found = iterate(model, expect, loop, likelihood=likelihood, ascent=ascent, summit=summit)
    said = found.message.replace(Outcome.CONVERGED.value, STANDS_STILL)
    message = said + remark(given, found, all_series)
    return replace(found, model=given, message=message)


def _start(
    model: MixedModel, all_series: Sequence[Series], indices: NDArray[np.intp], given: bool | str
) -> WarmStart | None:
    """The search for a start that was asked for. Raises OptionError."""
    if given not in (True, False, UPHILL):
        raise OptionError(
            f"warm_start = {given!r} is not known; use True, False or '{UPHILL}'", "warm_start"
        )
    return WarmStart(model, all_series, indices, around=given != UPHILL) if given else None


def _known(start: WarmStart | None, first: Theta) -> list[Theta]:
    """The maxima around the first theta that a search for a start has found, or would have."""
    if start is None or not start.around:
        return []
    if not start.searches:  # this run went on from a checkpoint
        start(first)
    return [fit.theta for fit in start.apart]


def _other_maxima(
    start: WarmStart | None, found: EmResult, first: Theta, all_series: Sequence[Series]
) -> str:
    """What is to be said, after a space, of maxima that the search for a start has found."""
    if start is None or not found.outcome.success:
        return ""
    _known(start, first)
    said = about_other_maxima(start.model, all_series, found.theta, start.apart, start.indices)
    return f" {said}" if said else ""


def _is_newton(method: str) -> bool:
    if method not in METHODS:
        raise OptionError(f"method '{method}' is not known; use {' or '.join(METHODS)}", "method")
    return method == "quasi-newton"


def _ascent(
    likelihood: LikelihoodStep,
    indices: NDArray[np.intp],
    tolerance: float | None,
    exact: bool = False,
) -> Ascent:
    """The rule of the quasi-Newton method for the free parameters ``indices``."""
    worth = np.inf if tolerance is None else WORTH * tolerance
    information = partial(likelihood.information, indices=indices)
    return Ascent(likelihood.model, indices, information, likelihood.rows, worth, exact)


def remark(model: BaseModel, found: EmResult, all_series: Sequence[Series]) -> str:
    """What is to be said of the records, the model's clock and steps at an estimate, each after a space."""
    gaussian = isinstance(model, MixedModel) and not model.random_scales
    told = [about_faults(model.outputs, model.inputs, all_series, outliers=gaussian)]
    told.append(about_shared_rows(all_series))
    if isinstance(model, MixedModel):
        told.append(about_clock(model, all_series))
        told.append(about_calls([model.transitions, model.observations]))
        if found.outcome.success:
            told.append(about_edges(model, found.theta, found.free, all_series))
            if gaussian:
                told.append(about_beginnings(model, found.theta, all_series))
            told.append(about_predictions(model, found.theta, all_series))
            told.append(about_own_steps(model, found.theta, found.free, all_series))
    return "".join(f" {said}" for said in told if said)


def scaled(
    model: MixedModel,
    all_series: Sequence[Series],
    theta0: ThetaLike,
    free: Sequence[str] | None,
    resume: Checkpoint | EmResult | None,
) -> MixedModel:
    """The model with the scales that its parameters have at the start of the trace."""
    first = np.asarray(first_of(model, theta0, resume))
    return with_scales(model, all_series, first, model.free_indices(free))


def first_of(model: MixedModel, theta0: ThetaLike, resume: Checkpoint | EmResult | None) -> Theta:
    """Where the trace starts; for a checkpoint of another model, of which ``iterate`` tells, the defaults."""
    if resume is None:
        return model.theta(theta0)
    row = np.asarray(resume.trace[0])
    fits = row.shape == (len(model.parameters),)
    return Theta(row, model.parameter_names) if fits else model.theta()
