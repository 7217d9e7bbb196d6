"""RBPS-EM and PS-EM with parts of the loop changed: what Table II of the paper may have been made with.

The M step of the paper is "a BFGS Quasi-Newton method"; how far it went in each iteration is not said.
Here it can be stopped after a number of its iterations, which leaves a generalised EM: Q grows, but theta
stays short of its maximum. The first iteration of BFGS is a step along the gradient with a line search.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from engine.base_model import BaseModel
from engine.e_steps import EStep, Expect, rbps_step
from engine.em import EmResult, iterate
from engine.errors import OptionError
from engine.maximization import Objective
from engine.model import Array, MixedModel, Theta, ThetaLike
from engine.series import Series
from engine.studies.guarded import GUARD
from engine.studies.guarded_em import guarded_step

SHARP = 1e12  # weight of a :class:`Point`: a step above 1e-9 is worth taking for the M step


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
    return iterate(
        model, used, theta0, free, n_iterations, seed, None, None, "scoring", tolerance=None
    )


def varied_ps_em(
    model: MixedModel,
    series: Series,
    theta0: ThetaLike = None,
    free: Sequence[str] | None = None,
    n_particles: int = 50,
    n_iterations: int = 100,
    seed: int = 0,
    *,
    guard: float = GUARD,
    m_step_iterations: int = 0,
) -> EmResult:
    """As :func:`engine.studies.guarded_em.guarded_ps_em`, with M steps that are stopped early.

    Raises OptionError.
    """
    indices = model.free_indices(free)
    expect = guarded_step(model, series, n_particles, guard)
    used = stopping(expect, model, indices, m_step_iterations)
    return iterate(
        model, used, theta0, free, n_iterations, seed, None, None, "scoring", tolerance=None
    )


def stopping(expect: Expect, model: BaseModel, free: NDArray[np.intp], iterations: int) -> Expect:
    """An E step whose objective has its maximum where BFGS is after a number of ``iterations``.

    0 leaves the E step as it is. Raises OptionError.
    """
    if iterations < 0:
        raise OptionError(f"m_step_iterations = {iterations} is negative", "m_step_iterations")

    def stopped(theta: Theta, rng: np.random.Generator) -> EStep:
        step = expect(theta, rng)
        if not np.isfinite(step.log_likelihood):
            return step
        to = stopped_bfgs(step.q, np.asarray(theta), free, iterations)
        return replace(step, q=Point(model, to))

    return stopped if iterations else expect


def stopped_bfgs(q: Objective, theta: Array, free: NDArray[np.intp], iterations: int) -> Array:
    """Where BFGS, started at theta, is after a number of iterations; never less likely than theta."""
    lower, upper = q.model.lower[free], q.model.upper[free]

    def at(x: Array) -> Array:
        out = theta.copy()
        out[free] = np.clip(x, lower, upper)
        return out

    def negative(x: Array) -> tuple[float, Array]:
        value, gradient, _ = q.derivatives(at(x), free)
        if not np.isfinite(value):
            return 1e300, np.zeros_like(x)
        return -value, -gradient

    last = minimize(negative, theta[free], jac=True, method="BFGS", options={"maxiter": iterations})
    found = at(last.x)
    return found if q.value(found) >= q.value(theta) else theta


@dataclass(frozen=True, eq=False)
class Point:
    """An objective with its maximum at ``theta``: an M step that was made already."""

    model: BaseModel
    theta: Array

    def value(self, theta: Array) -> float:
        """Minus half the weighted squared distance."""
        return float(-0.5 * SHARP * np.sum((theta - self.theta) ** 2))

    def derivatives(self, theta: Array, free: NDArray[np.intp]) -> tuple[float, Array, Array]:
        """Value, gradient (n,) and scoring matrix (n, n) in the n free parameters."""
        gradient = SHARP * (self.theta - np.asarray(theta))[free]
        return self.value(np.asarray(theta)), gradient, SHARP * np.eye(len(free))
