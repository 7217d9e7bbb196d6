"""A model with a parameter too many: only ratios of its parameters show, and one of them ends at its bound."""

from __future__ import annotations

import numpy as np
import pytest

import engine
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.screening.screening import screen_effects
from engine.diagnose.search.pipeline import told_together
from engine.estimation.quasi_ml import quasi_ml


@pytest.fixture(scope="module")
def reed():
    """m v' = b u - k x - c v: only b / m, k / m and c / m show; it rings on."""
    parameters = [
        engine.Parameter("m", 4.0, "kg", (0.1, 4.0)),
        engine.Parameter("k", 900.0, "N/m", (0.0, 1e5)),
        engine.Parameter("c", 0.4, "N s/m", (0.0, 100.0)),
        engine.Parameter("b", 50.0, "N/V", (0.0, 1e4)),
        engine.Parameter("q", 1e-4, "(m/s)^2/s", (1e-10, 1.0)),
        engine.Parameter("r", 1e-5, "m^2", (1e-10, 1.0)),
    ]

    def drift(a, u, t, th):
        return [0.0, th.b * u[0] / th.m], [[0.0, 1.0], [-th.k / th.m, -th.c / th.m]]

    return engine.continuous(
        name="reed",
        drift=drift,
        diffusion=lambda a, u, t, th: [[0.0, 0.0], [0.0, th.q]],
        measurement=lambda a, u, t, th: ([0.0], [[1.0, 0.0]], [[th.r]]),
        initial=lambda th: (None, [0.0, 0.0], [[1e-6, 0.0], [0.0, 1e-6]]),
        nonlinear={},
        linear={"x": "m", "v": "m/s"},
        kinematic=["x"],
        inputs={"u": "V"},
        outputs={"y": "m"},
        parameters=parameters,
    )


@pytest.fixture(scope="module")
def series(reed):
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-1.0, 1.0, 30), 10)
    return engine.simulate(reed, None, 300, rng, u=u, dt=0.05).series


@pytest.mark.long
def test_a_right_model_with_a_parameter_too_many_raises_no_alarm(reed, series):
    """A difference on one side of a bound leaves more than rounding of the open direction: chi2 of 3e4 once."""
    fit = quasi_ml(reed, series, reed.theta())
    assert fit.theta["m"] == 4.0
    assert set(fit.tied) == {"m", "k", "c", "b"}
    setting = setting_for(reed, series, np.asarray(fit.theta))
    seen = screen_effects(fit, series, setting, ["step", "pulse", "ramp"], 0.05, 1, lambda *_: None)
    assert max(score.statistic for score in seen.scores) < 20.0
    assert seen.p_value > 0.05


@pytest.mark.long
def test_what_is_determined_together_only_is_told(reed, series):
    (said,) = told_together(quasi_ml(reed, series, reed.theta()))
    assert "Only determined together, keep one of them fixed: m, k, c, b." in said
    free = [name for name in reed.parameter_names if name != "m"]
    assert told_together(quasi_ml(reed, series, reed.theta(), free)) == []
