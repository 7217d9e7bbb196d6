"""Outliers come at any time; large errors that come where an input has just moved are none."""

from types import SimpleNamespace
from typing import Any

import numpy as np

import engine
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.judging.at_inputs import outliers_at_inputs
from engine.diagnose.refits.rounds import Round
from engine.distributions import binomial_sf
from engine.estimation.quasi_ml import quasi_ml
from tests.engine.plain_models import oven

T = 300

OVEN = oven()


def asked(u, jumps):
    """What is said where the state has jumped by 5 K on the way to these samples."""
    rng, x, y = np.random.default_rng(2), 0.0, np.empty(T)
    for t in range(T):
        if t:
            x = x * np.exp(-1 / 20.0) + 2.0 * (1 - np.exp(-1 / 20.0)) * u[t - 1]
        x += 0.1 * rng.standard_normal() + 5.0 * (t in jumps)
        y[t] = x + 0.1 * rng.standard_normal()
    series = engine.Series(y=y, u=u, dt=1.0)
    fit = quasi_ml(OVEN, series)
    setting = setting_for(OVEN, series, np.asarray(fit.theta))
    tails: Any = SimpleNamespace(effect=make_effect("heavy-tails:above", setting))
    found = [Round(SimpleNamespace(), (tails,), None, (tails,))]  # type: ignore[arg-type]
    return outliers_at_inputs(found, fit, series, seed=0)


def switched():
    return np.repeat(np.random.default_rng(3).uniform(5.0, 30.0, T // 30), 30)


def test_errors_where_the_input_is_switched_are_no_outliers():
    (said,) = asked(switched(), {30 * k + 1 for k in range(1, 9)})
    assert "where heater has just moved" in said
    assert "heavy-tails:above stands in for" in said


def test_outliers_at_other_times_are_outliers():
    assert asked(switched(), {17, 44, 75, 102, 140, 168, 233, 259}) == []


def test_an_input_that_answers_an_outlier_does_not_bring_it_about():
    jumps = {17, 44, 75, 102, 140, 168, 233, 259}
    u = np.full(T, 10.0)
    for t in jumps:
        u[t : t + 1] = 5.0
    assert asked(u, jumps) == []


def test_the_tail_of_a_binomial():
    assert binomial_sf(0, 5, 0.1) == 1.0
    assert np.isclose(binomial_sf(2, 2, 0.1), 0.01)
