"""A linear Gaussian model with all its states in z, so that one E step serves it exactly."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from engine.filters.kalman import (
    linear_start,
    observation_matrices,
    start_probes,
    transition_matrices,
)
from engine.statespace.evaluation import TIME
from engine.statespace.model import Array, Gaussian, MixedModel
from engine.statespace.reads import reads


def as_linear(model: MixedModel) -> MixedModel:
    """The same model with x = (a, z) as its linear state and no nonlinear one.

    Its functions raise ModelError where the model is not linear Gaussian in x.
    """
    if model.na == 0:
        return model

    last: list[Any] = [None, None]  # theta and its points: asked for at every time step

    def probed(theta: Any) -> tuple[Array, Array]:
        if last[0] is not theta:
            last[:] = theta, start_probes(model, theta)
        points, size = last[1]
        return points, size

    def dynamics(a: Array, u: Array, t: float, dt: float, theta: Any) -> tuple[Any, Any, Any]:
        return transition_matrices(model, theta, u, t, dt, *probed(theta))

    def measurement(a: Array, u: Array, t: float, theta: Any) -> tuple[Any, Any, Any]:
        return observation_matrices(model, theta, u, t, probed(theta)[0])

    # that they do not read t is to be seen: then a few calls tell them for all times
    def dynamics_at_any_time(
        a: Array, u: Array, t: float, dt: float, theta: Any
    ) -> tuple[Any, Any, Any]:
        return transition_matrices(model, theta, u, 0.0, dt, *probed(theta))

    def measurement_at_any_time(a: Array, u: Array, t: float, theta: Any) -> tuple[Any, Any, Any]:
        return observation_matrices(model, theta, u, 0.0, probed(theta)[0])

    def initial(theta: Any) -> tuple[Gaussian, Any, Any]:
        mean, P = linear_start(model, theta)
        return Gaussian(np.empty(0), np.empty((0, 0))), mean, P

    return replace(
        model,
        nonlinear={},
        linear={**model.nonlinear, **model.linear},
        dynamics=dynamics if reads(model.dynamics, TIME) else dynamics_at_any_time,
        measurement=measurement if reads(model.measurement, TIME) else measurement_at_any_time,
        initial=initial,
    )
