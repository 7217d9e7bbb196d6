"""Readings in steps are often alike: no outliers are seen in that, and those that are there still are."""

import numpy as np
import pytest

import engine
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.screening.tails import fit_tails
from engine.estimation.quasi_ml import quasi_ml

T, STEP = 200, 0.2  # V

FILTER = engine.continuous(
    name="filter",
    drift=lambda a, u, t, th: ([u[0] / th.tau], [[-1.0 / th.tau]]),
    diffusion=lambda a, u, t, th: [[th.q]],
    measurement=lambda a, u, t, th: ([0.0], [[1.0]], [[th.r]]),
    initial=lambda th: (None, [0.0], [[1e-2]]),
    linear={"v": "V"},
    inputs={"drive": "V"},
    outputs={"out": "V"},
    parameters=[
        engine.Parameter("tau", 5.0, "ms", (0.1, 100.0)),
        engine.Parameter("q", 1e-4, "V^2/ms", (1e-9, 10.0)),
        engine.Parameter("r", 0.01, "V^2", (1e-8, 10.0)),
    ],
)


@pytest.mark.parametrize("glitches", [0, 5])
def test_outliers_of_readings_in_steps(glitches):
    rng, x, y = np.random.default_rng(5), 0.0, np.empty(T)
    u = np.repeat(rng.uniform(0.0, 4.0, T // 40), 40)
    for t in range(T):
        x += 0.0 if t == 0 else (1 - np.exp(-1 / 5.0)) * (u[t - 1] - x)
        y[t] = x + 0.02 * rng.standard_normal()
    y[60 : 60 + glitches * 25 : 25] += 1.5
    series = engine.Series(y=STEP * np.round(y / STEP), u=u, dt=1.0)
    fit = quasi_ml(FILTER, series)
    effect = make_effect("heavy-tails:out", setting_for(FILTER, series, np.asarray(fit.theta)))
    gain, theta = fit_tails(fit, effect, series)
    least = min(STEP**2 / 12.0, fit.theta["r"])
    assert theta[FILTER.parameter_names.index("r")] > 0.9 * least
    assert gain > 100.0 if glitches else gain < 10.0
