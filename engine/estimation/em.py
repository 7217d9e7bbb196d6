"""Maximum likelihood by EM; paper, Algorithm 1: RBPS-EM, and the exact EM of linear Gaussian models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from engine.data.series import Series, as_series_list
from engine.estimation.e_steps import rbps_step, rts_step
from engine.estimation.em_loop import Callback, Loop, iterate
from engine.estimation.em_result import Checkpoint as Checkpoint
from engine.estimation.em_result import EmResult as EmResult
from engine.estimation.em_result import Iteration as Iteration
from engine.estimation.likelihood_step import LikelihoodStep
from engine.estimation.quasi_ml import with_scales
from engine.estimation.start import WarmStart
from engine.filters.proposals import Proposal
from engine.statespace.model import MixedModel, ThetaLike


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
    convergence rule in :mod:`engine.estimation.convergence`, None to use all iterations; ``callback`` sees
    every :class:`Iteration` and stops the run by returning True or raising StopIteration.

    ``smoother``: "exact" uses moments of z given whole trajectories of a, which converge as M grows;
    "algorithm-3" those of the report, eqs. (61), whose P and M keep the bias of Approximation 2;
    "linear-cost" is "exact" with trajectories drawn by MCMC moves, in O(M), see
    :mod:`engine.smoothers.linear_cost`.
    ``recover``: run a filter that collapsed again with more particles (the paper does not).
    ``m_step``: "scoring" or "bfgs", see :mod:`engine.estimation.maximization`.
    ``warm_start``: let the first iteration leave from the maximum of an approximate likelihood where
    theta0 is far less likely, see :mod:`engine.estimation.start`; False always starts EM at theta0.
    Parameters that move what has no noise are moved by :mod:`engine.estimation.likelihood_step`;
    ``message`` says so. Raises OptionError, SeriesError, ModelError.
    """
    all_series = as_series_list(series, model)
    given, model = model, scaled(model, all_series, theta0, free, resume)
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
    )
    indices = model.free_indices(free)
    start = WarmStart(model, all_series, indices) if warm_start else None
    loop = Loop(theta0, free, n_iterations, seed, callback, resume, m_step, tolerance)
    found = iterate(model, expect, loop, start, LikelihoodStep(model, all_series))
    note = f" {start.note}" if start is not None and start.note else ""
    return replace(found, model=given, message=found.message + note)


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
    all_series = as_series_list(series, model)
    given, model = model, scaled(model, all_series, theta0, free, resume)
    loop = Loop(theta0, free, n_iterations, 0, callback, resume, m_step, tolerance)
    likelihood = LikelihoodStep(model, all_series, "the exact", worth=1e-8)
    found = iterate(model, rts_step(model, all_series), loop, likelihood=likelihood)
    return replace(found, model=given)


def scaled(
    model: MixedModel,
    all_series: Sequence[Series],
    theta0: ThetaLike,
    free: Sequence[str] | None,
    resume: Checkpoint | EmResult | None,
) -> MixedModel:
    """The model with the scales that its parameters have at the start of the trace."""
    start = model.theta(theta0) if resume is None else resume.trace[0]
    if np.shape(start) != (len(model.parameters),):
        return model  # a checkpoint of another model; ``iterate`` says so
    return with_scales(model, all_series, start, model.free_indices(free))
