"""Where a model comes to rest when nothing drives it: of a spring, where it is not stretched."""

from __future__ import annotations

import numpy as np

from engine.diagnose.effects.rates import Points
from engine.statespace.half_steps import step
from engine.statespace.model import Array, MixedModel

ROUNDS = 20  # of Newton's method
SETTLED = 1e-9  # of a state's size: a step that moves no state farther
BESIDE = 1e-4  # of a state's size, at which slopes are taken
# Of a step: a model that answers less goes on by itself, and is at rest anywhere.
LEAST_SLOPE = 1e-9


@np.errstate(all="ignore")  # where it runs away
def at_rest(model: MixedModel, theta: Array, points: Points, u: Array) -> Array | None:
    """The states (nx,), each in its unit, that a step leaves as they are, with inputs u (nu,) held.

    By Newton's method from the middle of the ``points``. None where there is none, as in what goes on alone.
    EngineError where the model cannot be used on its way.
    """
    x, scale, t, dt = np.median(points.x, axis=0), points.scale, points.t[0], np.median(points.dt)
    ways = BESIDE * np.vstack([np.diag(scale), -np.diag(scale)])
    for _ in range(ROUNDS):
        here, *beside = step(model, theta, np.vstack([x, x + ways]), u, t, dt)
        moved = (here - x) / scale
        ends = np.array(beside).reshape(2, model.nx, model.nx) / scale
        slopes = ((ends[0] - ends[1]) / (2.0 * BESIDE)).T - np.eye(model.nx)
        if not (np.isfinite(moved).all() and np.isfinite(slopes).all()):
            return None
        if np.linalg.svd(slopes, compute_uv=False).min(initial=np.inf) < LEAST_SLOPE:
            return None
        if np.abs(moved).max(initial=0.0) <= SETTLED:
            return x
        x = x - scale * np.linalg.solve(slopes, moved)
    return None
