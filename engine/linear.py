"""A linear Gaussian model with all its states in z, so that one E step serves it exactly."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from engine.kalman import linear_start, linear_step
from engine.model import Array, Gaussian, MixedModel


def as_linear(model: MixedModel) -> MixedModel:
    """The same model with x = (a, z) as its linear state and no nonlinear one.

    Its functions raise ModelError where the model is not linear Gaussian in x.
    """
    if model.na == 0:
        return model

    def dynamics(a: Array, u: Array, t: float, dt: float, theta: Any) -> tuple[Any, Any, Any]:
        step = linear_step(model, theta, u, t, dt)
        return step.f, step.F, step.Q

    def measurement(a: Array, u: Array, t: float, theta: Any) -> tuple[Any, Any, Any]:
        step = linear_step(model, theta, u, t, 1.0)
        return step.h, step.H, step.R

    def initial(theta: Any) -> tuple[Gaussian, Any, Any]:
        mean, P = linear_start(model, theta)
        return Gaussian(np.empty(0), np.empty((0, 0))), mean, P

    return replace(
        model,
        nonlinear={},
        linear={**model.nonlinear, **model.linear},
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
    )
