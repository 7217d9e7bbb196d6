"""A sensor that is nearly free of noise and clips 3 % of its readings."""

from functools import cache

import numpy as np

import engine
from engine.data.series import Series
from engine.diagnose.search.pipeline import Causes, find_causes
from engine.simulation.simulate import simulate

MODEL = engine.get_model("oscillator")
KINDS = ["saturation-sensor", "variance", "heavy-tails", "pulse", "step", "cubic-sensor", "lag"]


@cache
def series() -> Series:
    """300 readings of an oscillator."""
    rng = np.random.default_rng(3)
    T = 300
    u = np.convolve(rng.standard_normal(T + 20), np.ones(20) / 5.0)[20 : T + 20]
    theta = MODEL.theta({"sigma_y": 2e-4, "sigma_v": 0.02})
    whole = simulate(MODEL, theta, T, rng, u=u, dt=0.05).series.replace(y_names=("y",))
    return whole.replace(y=np.minimum(whole.y, np.quantile(whole.y, 0.97)))


@cache
def found() -> Causes:
    """What a search among a few kinds finds."""
    return find_causes(MODEL, series(), effects=KINDS, seed=1)
