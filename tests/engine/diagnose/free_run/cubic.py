"""An oscillator whose cubic stiffness its model does not know, and the fit of its free run."""

import numpy as np

import engine
from engine.data.series import Series
from engine.diagnose.free_run_fits.fitted import Fitted, fit_runs
from engine.simulation.free_run import free_run

MODEL = engine.get_model("oscillator")
FREE = ("omega", "zeta", "gain")


def fit_beside_cubic(seed: int) -> Fitted:
    """On 400 readings that are nearly free of noise."""
    rng = np.random.default_rng(seed)
    T, dt = 400, 0.05
    u = np.convolve(rng.standard_normal(T + 20), np.ones(20) / 5.0)[20 : T + 20]
    empty = Series(np.full(T, np.nan), u, dt=dt)
    hidden = engine.get_model("oscillator", ["cubic:position->velocity"])
    truth = free_run(hidden, {"cubic_position__velocity": -4.0}, empty)
    series = empty.replace(y=truth.y + 1e-3 * rng.standard_normal((T, 1)))
    return fit_runs(MODEL, [series], MODEL.theta(), FREE, np.zeros((1, 2)))
