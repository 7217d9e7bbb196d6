"""PS-EM: EM with a particle smoother on the full state (Schon, Wills, Ninness 2011; poster).

For mixed models it is the baseline of the paper, section V; for general nonlinear, non-Gaussian
models, :class:`engine.statespace.general.NonlinearModel`, the poster's method with its quasi-Newton M step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from engine.data.given import as_series_list, check_enough
from engine.data.series import Series
from engine.errors import OptionError
from engine.estimation.e_steps import ParticleStep
from engine.estimation.em import Checkpoint, EmResult, first_of, remark, scaled
from engine.estimation.em_loop import Callback, Loop, iterate
from engine.estimation.expectation import expectation
from engine.estimation.general_em import trajectory_q
from engine.estimation.likelihood_step import LikelihoodStep
from engine.estimation.particle_likelihood import likelihood_of
from engine.filters.particle import ParticleFiltered, particle_filter
from engine.filters.proposals import Proposal, get_proposal
from engine.filters.rbpf import check_options
from engine.smoothers.ffbsi import ffbsi
from engine.smoothers.general import (
    GeneralFiltered,
    check_rows,
    filter_general,
    smooth_general,
)
from engine.smoothers.moments import Moments
from engine.statespace.general import NonlinearModel
from engine.statespace.model import Array, MixedModel, ThetaLike
from engine.statespace.points import Points
from engine.threads import single_threaded


@single_threaded
def ps_em(  # noqa: PLR0913
    model: MixedModel | NonlinearModel,
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
    proposal: str | Proposal = "bootstrap",
    resampling: str = "multinomial",
    ess_threshold: float = 1.0,
    recover: bool = True,
    m_step: str | None = None,
    tolerance: float | None = 1e-3,
) -> EmResult:
    """Estimate theta by EM with the bootstrap PF and FFBSi on x = (a, z); paper, section V.

    The Q-function is that of paper, eqs. (8)-(19), with the drawn states in place of moments, P = 0 and M = 0.

    Parameters
    ----------
    model : MixedModel or NonlinearModel
        A mixed model, paper, eq. (1), or a general one, poster, eq. (1).
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
        Density that new particles are drawn from, as for :func:`rbps_em`; general models need ``bootstrap``.
    resampling : str
        ``multinomial``, ``stratified``, ``systematic``, ``residual`` or ``sorted``, as for :func:`rbpf`.
    ess_threshold : float
        Resample where the effective sample size is at most this share of M (1: at every step, 0: never).
    recover : bool
        Run a filter that collapsed, or fell far short of the moment filter, again with more particles (the
        papers do not).
    m_step : str, optional
        How the M step maximises Q: ``scoring``, the default for mixed models, or ``bfgs``.
    tolerance : float, optional
        Share of a parameter's size by which iterates may still move once they have settled; None uses all
        iterations.

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
    all_series = as_series_list(series, model)
    check_enough(all_series, len(model.free_indices(free)))
    N = n_particles if n_trajectories is None else n_trajectories
    check_options(n_particles, resampling, ess_threshold)
    given, likelihood = model, None
    run: Any
    smooth: Any
    objective: Any
    options: dict[str, Any] = {"resampling": resampling, "ess_threshold": ess_threshold}
    if isinstance(model, NonlinearModel):
        if proposal != "bootstrap":
            raise OptionError("a general model is filtered with proposal='bootstrap'", "proposal")
        check_options(N, resampling, ess_threshold)
        for one in all_series:
            check_rows(one)
        run, smooth = partial(filter_general, model, **options), partial(_trajectories, N)
        objective = partial(trajectory_q, model)
    else:
        get_proposal(proposal)
        model = scaled(model, all_series, theta0, free, resume)
        first = first_of(model, theta0, resume)
        indices = model.free_indices(free)
        likelihood = likelihood_of(model, all_series, first, n_particles, indices)
        run = partial(particle_filter, model, proposal=proposal, **options)
        smooth, objective = partial(_draws, N), partial(expectation, model)
    moment = LikelihoodStep(model, all_series).of if isinstance(model, MixedModel) else None
    expect = ParticleStep(all_series, run, smooth, objective, n_particles, recover, moment)
    chosen = m_step or ("scoring" if likelihood else "bfgs")
    loop = Loop(theta0, free, n_iterations, seed, callback, resume, chosen, tolerance)
    particles = expect if recover else None
    found = iterate(model, expect, loop, likelihood=likelihood, particles=particles)
    message = found.message + remark(given, found, all_series)
    return replace(found, model=given, message=message)


def _trajectories(
    N: int, filtered: GeneralFiltered, series: Series, rng: np.random.Generator
) -> tuple[Series, Array]:
    return series, smooth_general(filtered, N, rng)


def _draws(
    N: int, filtered: ParticleFiltered, series: Series, rng: np.random.Generator
) -> tuple[Moments, Points]:
    draws = ffbsi(filtered, N, rng)
    return draws.moments, Points(filtered.model, series, draws.a)
