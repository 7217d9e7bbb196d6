"""The M step: theta_{k+1} = argmax Q(theta, theta_k) within the parameters' bounds; paper, eq. (5)."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from engine.errors import OptionError
from engine.estimation.expectation import parameter_scale
from engine.failing import where_it_fails
from engine.statespace.base import Array, BaseModel
from engine.statespace.refutation import repeated_if_refuted

M_STEPS = ("scoring", "bfgs")
SCORING_STEPS = 8  # scoring steps at most; one is exact where theta enters linearly
GAIN_NATS = 1e-7  # an expected gain in Q (nats) below this is not worth a step
# After a full step with an expected gain below this, what is left is not worth another.
LAST_NATS = 1e-2
DAMPING = 4.0  # factor by which the damping grows until no component is longer than its reach ...
MOST_DAMPING = 1e12  # ... or it is this
SCALED_RIDGE = 1e-10  # of the scaled scoring matrix, for parameters the data say nothing about


class Objective(Protocol):
    """What an M step maximises; :class:`engine.estimation.expectation.QFunction` is one."""

    @property
    def model(self) -> BaseModel:
        """The model whose bounds are kept."""

    def value(self, theta: Array) -> float:
        """Q(theta, theta_k); -inf where theta is impossible."""

    def derivatives(self, theta: Array, free: NDArray[np.intp]) -> tuple[float, Array, Array]:
        """Value, gradient (n,) and a non-negative scoring matrix (n, n) in the free parameters."""

    def possible(self, theta: Array) -> bool:
        """Whether all noise has a covariance at theta: nothing else is needed of a step that is not Q's."""

    def moves_noise_free(self, theta: Array, free: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Which free parameters (n,) move what has no noise, so that Q is no guide to them."""


def check_m_step(method: str) -> None:
    """Raise OptionError where there is no such M step."""
    if method not in M_STEPS:
        raise OptionError(f"m_step '{method}' is not known; use {' or '.join(M_STEPS)}", "m_step")


@repeated_if_refuted
def maximize(q: Objective, theta: Array, free: NDArray[np.intp], method: str = "scoring") -> Array:
    """The maximiser of Q over the free parameters, started at theta. Raises OptionError.

    ``scoring`` takes Fisher scoring steps with a line search, ``bfgs`` is the paper's quasi-Newton
    method (L-BFGS-B, which keeps the bounds). Neither ever returns a smaller Q than it was given.
    """
    check_m_step(method)
    step = _scoring if method == "scoring" else _bfgs
    return step(q, np.array(theta, dtype=float), free)


def _scoring(q: Objective, theta: Array, free: NDArray[np.intp]) -> Array:
    lower, upper = q.model.lower[free], q.model.upper[free]
    for _ in range(SCORING_STEPS):
        value, g, H = q.derivatives(theta, free)
        if not (np.isfinite(value) and np.isfinite(g).all() and np.isfinite(H).all()):
            return theta
        x = theta[free]
        direction = scoring_step(x, g, H, lower, upper, SCALED_RIDGE)
        expected = float(g @ direction)
        if not expected > GAIN_NATS:
            return theta
        step = 1.0
        while step > 1e-4:
            trial = theta.copy()
            trial[free] = np.clip(x + step * direction, lower, upper)
            if q.value(trial) >= value + 1e-4 * float(g @ (trial[free] - x)):
                break
            step *= 0.5
        else:
            return theta
        theta = trial
        if step == 1.0 and expected < LAST_NATS:
            return theta
    return theta


def scoring_step(x: Array, g: Array, H: Array, lower: Array, upper: Array, ridge: float) -> Array:
    """H^{-1} g in the parameters that are not held at a bound, H scaled to a unit diagonal and ridged."""
    moving = ~(((x <= lower) & (g < 0.0)) | ((x >= upper) & (g > 0.0)) | (np.diag(H) <= 0.0))
    direction = np.zeros_like(x)
    if moving.any():
        H = H[np.ix_(moving, moving)]
        scale = 1.0 / np.sqrt(np.diag(H))
        scaled = H * scale[:, None] * scale[None, :] + ridge * np.eye(len(scale))
        direction[moving] = np.linalg.solve(scaled, g[moving] * scale) * scale
    return direction


def step_within(
    x: Array, g: Array, H: Array, lower: Array, upper: Array, ridge: float, reach: Array
) -> Array:
    """The scoring step, damped where a component would be longer than its ``reach`` (n,)."""
    d = scoring_step(x, g, H, lower, upper, ridge)
    damping = DAMPING
    while (np.abs(d) > reach).any() and damping < MOST_DAMPING:
        d = scoring_step(x, g, H + np.diag(damping / reach**2), lower, upper, ridge)
        damping *= DAMPING
    return np.asarray(np.clip(d, -reach, reach))


def _bfgs(q: Objective, theta: Array, free: NDArray[np.intp]) -> Array:
    scale = np.array([parameter_scale(q.model, theta, k) for k in free])

    def negative(x: Array) -> tuple[float, Array]:
        trial = theta.copy()
        trial[free] = np.clip(x * scale, q.model.lower[free], q.model.upper[free])
        nothing = np.zeros_like(x)
        value, g, _ = where_it_fails((-np.inf, nothing, nothing))(q.derivatives)(trial, free)
        if not np.isfinite(value):
            return 1e300, nothing
        return -value, -g * scale

    bounds = list(zip(q.model.lower[free] / scale, q.model.upper[free] / scale, strict=True))
    start = theta[free] / scale
    found = minimize(negative, start, jac=True, method="L-BFGS-B", bounds=bounds)
    best = theta.copy()
    best[free] = np.clip(found.x * scale, q.model.lower[free], q.model.upper[free])
    return best if q.value(best) >= q.value(theta) else theta
