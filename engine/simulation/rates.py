"""Whether a model of steps was written as a differential equation: it returns a rate for its next state.

It runs all the same, as another model, and everything that is estimated or found with it then is of that one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from engine.data.series import Series
from engine.errors import EngineError, ModelError
from engine.simulation.fit import fit_simulation
from engine.statespace.checks import ignores_dt
from engine.statespace.model import Array, MixedModel, Theta

FAR_BETTER = 0.3  # of the free run's error: what rates leave of it where the equations are rates
GOOD = 0.3  # of the readings' spread: an error with which either is believed
ROWS = 1000  # of a record that are simulated
STARTS, EVALUATIONS = 1, 40  # of fits that are compared


def check_no_rates(model: MixedModel, series: Series, theta: Theta) -> None:
    """Raise ModelError where a model that never reads dt simulates a record far better as one of rates."""
    if model.continuous or model.steps_counted or not ignores_dt(model, theta, series):
        return
    part = series.part(0, min(len(series), ROWS))
    try:
        other = _error(by_rates(model), part, theta)  # of most models off by more than that
        own = _error(model, part, theta) if other < GOOD else 0.0
    except (EngineError, np.linalg.LinAlgError):
        return
    if own > GOOD and other < FAR_BETTER * own:  # an unstable map is off by more than any level
        raise ModelError(
            f"model '{model.name}', dynamics: what it returns does not depend on dt, and is taken for the "
            "next state. Taken for its rate of change it explains these data: free runs are off by "
            f"{other:.2g} instead of {own:.2g} times the readings' spread. Where equations are rates, return "
            "a[:, 0] + dt * (...), or write engine.continuous(drift=..., diffusion=...)."
        )


def by_rates(model: MixedModel) -> MixedModel:
    """The model whose state goes on by dt times what the dynamics of ``model`` return."""
    na, nx = model.na, model.nx
    same = np.vstack([np.zeros((na, model.nz)), np.eye(model.nz)])

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        f, A, Q = model.transition(a, u, t, dt, theta)
        length = np.asarray(dt)[..., None]  # one for all rows, or each its own
        here = np.hstack([a, np.zeros((len(a), nx - na))])
        return here + length * f, same + length[..., None] * A, length[..., None] * Q

    return replace(model, dynamics=dynamics)


def _error(model: MixedModel, series: Series, theta: Theta) -> float:
    """What a fitted free run is off by, as a share of the readings' spread."""
    return fit_simulation(model, series, theta, None, STARTS, 0, EVALUATIONS).nrmse
