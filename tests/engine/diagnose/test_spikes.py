"""A known first state that may be anything meets the first reading exactly: what that gains is no effect's."""

import numpy as np
import pytest

import engine
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.refits.refit import refit
from engine.diagnose.screening.screening import screen_effects
from engine.estimation.quasi_ml import quasi_ml

RIVER = engine.MixedModel(
    name="river",
    dynamics=lambda a, u, t, dt, th: ([0.0], [[1.0]], [[th.q * dt]]),
    measurement=lambda a, u, t, th: ([0.0], [[1.0]], [[th.r]]),
    initial=lambda th: (None, [th.level], [[0.0]]),
    linear={"level": "m"},
    outputs={"flow": "m"},
    parameters=[
        engine.Parameter("q", 13.0, "m^2/s", (0.0, 1e4)),
        engine.Parameter("r", 8.0, "m^2", (1e-9, 1e4)),
        engine.Parameter("level", 100.0, "m", (0.0, 1e3)),
    ],
)


@pytest.mark.long
@pytest.mark.parametrize("seed", [142, 147, 183])
def test_no_wave_gains_what_a_first_reading_met_exactly_gains(seed):
    """Three of 160 series without a wave, for which one gained 32 to 34."""
    series = engine.simulate(RIVER, None, 100, np.random.default_rng(seed), dt=1.0).series
    fit = quasi_ml(RIVER, series, RIVER.theta())
    setting = setting_for(RIVER, series, np.asarray(fit.theta))
    kinds, silent = ["harmonic:flow"], lambda *_: None
    (score,) = screen_effects(fit, series, setting, kinds, 0.05, seed, silent).scores
    assert 0.0 < refit(fit, series, score).gain < 20.0
