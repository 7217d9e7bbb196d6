"""M steps that are stopped early.

The M step of the paper is "a BFGS Quasi-Newton method"; how far it went in each iteration is not said.
Stopped after a number of its iterations it leaves a generalised EM: Q grows, but theta stays short of its
maximum. The first iteration of BFGS is a step along the gradient with a line search.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from engine.errors import OptionError
from engine.estimation.e_steps import EStep, Expect
from engine.estimation.maximization import Objective
from engine.statespace.base import BaseModel
from engine.statespace.model import Array, Theta

SHARP = 1e12  # weight of a :class:`Point`: a step above 1e-9 is worth taking for the M step


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

    def possible(self, theta: Array) -> bool:
        """Always: its noise depends on no parameter."""
        return True

    def moves_noise_free(self, theta: Array, free: NDArray[np.intp]) -> NDArray[np.bool_]:
        """None (n,): all noise is there."""
        return np.zeros(len(free), dtype=bool)
