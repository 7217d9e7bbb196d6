"""RBPS-EM with parts of the loop changed: what Table II of the paper may have been made with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.data.series import Series
from engine.estimation.e_steps import EStep, rbps_step
from engine.estimation.em import EmResult
from engine.estimation.em_loop import Loop, iterate
from engine.statespace.model import MixedModel, Theta, ThetaLike
from tests.studies.stopped import stopping


def varied_em(
    model: MixedModel,
    series: Series,
    theta0: ThetaLike = None,
    free: Sequence[str] | None = None,
    n_particles: int = 50,
    n_trajectories: int = 50,
    n_iterations: int = 100,
    seed: int = 0,
    *,
    m_step_iterations: int = 0,
    common_numbers: bool = False,
    proposal: str = "bootstrap",
    resampling: str = "multinomial",
    ess_threshold: float = 1.0,
    smoother: str = "algorithm-3",
) -> EmResult:
    """As :func:`engine.rbps_em` with the paper's settings, but for what is asked for.

    ``m_step_iterations`` of BFGS, in the parameters as they are, in each M step; 0 goes to the maximum.
    ``common_numbers`` draws the same random numbers in every iteration. Raises OptionError.
    """
    indices = model.free_indices(free)
    expect = rbps_step(
        model,
        [series],
        n_particles,
        n_trajectories,
        proposal=proposal,
        resampling=resampling,
        ess_threshold=ess_threshold,
        smoother=smoother,
        recover=False,
    )

    def same_numbers(theta: Theta, rng: np.random.Generator) -> EStep:
        return expect(theta, np.random.default_rng(seed))

    used = stopping(same_numbers if common_numbers else expect, model, indices, m_step_iterations)
    return iterate(model, used, Loop(theta0, free, n_iterations, seed, tolerance=None))
