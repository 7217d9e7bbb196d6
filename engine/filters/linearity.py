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
from engine.statespace.checks import check_model
from engine.statespace.model import Array, MixedModel, ThetaLike

NOT_LINEAR = "is not linear Gaussian"  # what the errors of that say
ROWS = 12  # of a series, at which a model is looked at


def why_not_linear(model: MixedModel, theta: ThetaLike = None, series: Series | None = None) -> str:
    """Why a model is not linear Gaussian in x = (a, z), "" where it is, by its values at some points.

    ``series`` gives inputs, times and steps at which it is looked at, a few of its rows; without one these are
    inputs of 0, 1 and -1, times of 0 and 100, steps of 1 s. Of a model that cannot be calculated so
    they are those of :func:`check_model`, and twice and three times its inputs.
    """
    record = model.record(model.theta(theta))
    try:
        points, size = start_probes(model, record)
    except ModelError as error:
        return str(error)
    for k, (u, t, dt) in enumerate(_looked_at(model, series)):
        try:
            transition_matrices(model, record, u, t, dt, points, size)
            observation_matrices(model, record, u, t, points)
        except ModelError as error:
            # of inputs that were made up here a model need not know what to do
            if k == 0 or series is not None or NOT_LINEAR in str(error):
                return str(error)
    return ""


def _looked_at(model: MixedModel, series: Series | None) -> list[tuple[Array, float, float]]:
    """Inputs (nu,), a time and a step each."""
    if series is not None:
        rows = np.unique(np.linspace(0, len(series) - 2, ROWS).astype(int))
        return [(series.u_step[k], float(series.t[k]), float(series.steps[k])) for k in rows]
    tried = check_model(model)
    inputs = [k * tried.u for k in (1.0, 2.0, 3.0)]
    if not tried.u.any():
        inputs = [np.full(model.nu, way) for way in (0.0, 1.0, -1.0)]
    return [(u, t, tried.dt) for t in (0.0, 100.0) for u in inputs]
