"""Whether a model is linear Gaussian, so that the Kalman smoother and RTS-EM are exact for it."""

from __future__ import annotations

import numpy as np

from engine.data.series import Series
from engine.errors import ModelError
from engine.filters.kalman import (
    observation_matrices,
    start_probes,
    transition_matrices,
)
from engine.statespace.model import MixedModel, ThetaLike


def why_not_linear(model: MixedModel, theta: ThetaLike = None, series: Series | None = None) -> str:
    """Why a model is not linear Gaussian in x = (a, z), "" where it is, by its values at some points.

    ``series`` gives the input and the step at which it is looked at; without one, u = 0 and dt = 1 s.
    """
    record = model.record(model.theta(theta))
    u, t, dt = np.zeros(model.nu), 0.0, 1.0
    if series is not None:
        u, t, dt = series.u_step[0], float(series.t[0]), float(series.steps[0])
    try:
        points, size = start_probes(model, record)
        transition_matrices(model, record, u, t, dt, points, size)
        observation_matrices(model, record, u, t, points)
    except ModelError as error:
        return str(error)
    return ""
