"""PS-EM: EM with a particle smoother on the full state (Schon, Wills, Ninness 2011; poster).

For mixed models it is the baseline of the paper, section V; for general nonlinear, non-Gaussian
models, :class:`engine.statespace.general.NonlinearModel`, the poster's method with its quasi-Newton M step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from engine.data.series import Series, as_series_list
from engine.errors import OptionError
from engine.estimation.e_steps import LOST_SHARE, RETRIES, EStep, Expect
from engine.estimation.em import Checkpoint, EmResult, scaled
from engine.estimation.em_loop import Callback, Loop, iterate
from engine.estimation.expectation import expectation
from engine.estimation.general_em import general_step
from engine.estimation.likelihood_step import LikelihoodStep
from engine.filters.particle import ParticleFiltered, particle_filter
from engine.filters.proposals import Proposal, get_proposal
from engine.filters.rbpf import check_options
from engine.smoothers.ffbsi import ffbsi
from engine.statespace.general import NonlinearModel
from engine.statespace.model import MixedModel, Theta, ThetaLike
from engine.statespace.points import Points


def ps_em(
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

    The Q-function is that of paper, eqs. (8)-(19), with the drawn states in place of moments, P = 0
    and M = 0. Arguments, result and errors as in :func:`engine.estimation.em.rbps_em`; ``recover=False`` is
    the paper's method to the letter, which goes on with a filter that has collapsed. ``m_step`` is
    "scoring" by default for mixed models, "bfgs" for general ones, which know no ``proposal`` but
    the bootstrap's.
    """
    listed = as_series_list(series, model)
    n_trajectories = n_particles if n_trajectories is None else n_trajectories
    given, likelihood = model, None
    if isinstance(model, NonlinearModel):
        if proposal != "bootstrap":
            raise OptionError("a general model is filtered with proposal='bootstrap'", "proposal")
        expect = general_step(
            model,
            listed,
            n_particles,
            n_trajectories,
            resampling=resampling,
            ess_threshold=ess_threshold,
            recover=recover,
        )
        m_step = m_step or "bfgs"
    else:
        model = scaled(model, listed, theta0, free, resume)
        likelihood = LikelihoodStep(model, listed)
        expect = ps_step(
            model,
            listed,
            n_particles,
            n_trajectories,
            proposal=proposal,
            resampling=resampling,
            ess_threshold=ess_threshold,
            recover=recover,
        )
    chosen = m_step or "scoring"
    loop = Loop(theta0, free, n_iterations, seed, callback, resume, chosen, tolerance)
    found = iterate(model, expect, loop, likelihood=likelihood)
    return replace(found, model=given)


def ps_step(
    model: MixedModel,
    listed: Sequence[Series],
    n_particles: int,
    n_trajectories: int,
    *,
    proposal: str | Proposal = "bootstrap",
    resampling: str = "multinomial",
    ess_threshold: float = 1.0,
    recover: bool = True,
) -> Expect:
    """Particle filter and FFBSi over every series; options as in :func:`ps_em`."""
    check_options(n_particles, resampling, ess_threshold)
    get_proposal(proposal)

    def run_filter(theta: Theta, one: Series, rng: np.random.Generator) -> ParticleFiltered:
        for times in (1, *RETRIES) if recover else (1,):
            filtered = particle_filter(
                model, theta, one, times * n_particles, rng, proposal, resampling, ess_threshold
            )
            if len(filtered.collapsed) <= LOST_SHARE * len(one):
                break
        return filtered

    def expect(theta: Theta, rng: np.random.Generator) -> EStep:
        smoothed, log_likelihood, ess, lost = [], 0.0, 0.0, 0
        for one in listed:
            filtered = run_filter(theta, one, rng)
            draws = ffbsi(filtered, n_trajectories, rng)
            smoothed.append((draws.moments, Points(model, one, draws.a)))
            log_likelihood += filtered.log_likelihood
            ess += float(filtered.ess.sum())
            lost += len(filtered.collapsed)
        n = sum(map(len, listed))
        return EStep(expectation(model, theta, smoothed), log_likelihood, ess / n, lost / n)

    return expect
