"""Parameters of a model written by Euler's rule are those of its steps, and a note says so."""

import numpy as np
import pytest

import engine
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.steps.own_steps import about_own_steps
from engine.estimation.quasi_ml import quasi_ml

DT, K, LAG = 0.15, 900.0, 0.25


def motor(gain, rest, model=engine.MixedModel, **more):
    """A speed in rpm behind a voltage: ``gain`` and ``rest`` of a step (dt, theta)."""
    return model(
        name="motor",
        dynamics=lambda a, u, t, dt, theta: (
            [gain(dt, theta) * u[0]],
            [[rest(dt, theta)]],
            [[1.0]],
        ),
        measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r]]),
        initial=lambda theta: (None, [0.0], [[1.0]]),
        linear={"speed": "rpm"},
        inputs={"voltage": "V"},
        outputs={"tacho": "rpm"},
        parameters=[
            engine.Parameter("K", 500.0, "rpm/V/s", (0.0, 1e5)),
            engine.Parameter("T", 0.3, "s", (0.01, 10.0)),
            engine.Parameter("r", 50.0, "rpm^2", (1e-3, 1e6)),
        ],
        **more,
    )


def exact_gain(dt, theta):
    return theta.K * theta.T * (1.0 - np.exp(-dt / theta.T))


EULER = motor(lambda dt, theta: dt * theta.K, lambda dt, theta: 1.0 - dt / theta.T)
EXACT = motor(exact_gain, lambda dt, theta: np.exp(-dt / theta.T))


def record(noise=8.0):
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-12.0, 12.0, 30), 10)
    series = engine.simulate(EXACT, {"K": K, "T": LAG, "r": noise**2}, 300, rng, u=u, dt=DT).series
    return series


def note(model, series):
    fit = quasi_ml(model, series)
    return fit, about_own_steps(fit, series, setting_for(model, series, fit.theta))


def test_a_lag_by_eulers_rule_is_told_to_be_that_of_its_steps():
    """T was 0.332 +- 0.001 s where 0.25 s is right, with nothing found and no word about it."""
    fit, text = note(EULER, record())
    assert fit.theta["T"] == pytest.approx(DT / (1.0 - np.exp(-DT / LAG)), abs=2e-3)
    halves = 0.5 * DT / (1.0 - np.exp(-0.5 * DT / LAG))
    assert f"T would be {halves:.3f} s instead of {fit.theta['T']:.3f} s" in text
    assert "engine.continuous" in text


def test_exact_steps_need_no_word():
    fit, text = note(EXACT, record())
    assert fit.theta["T"] == pytest.approx(LAG, abs=2e-3)
    assert text == ""


def test_errors_larger_than_what_the_steps_change_need_no_word():
    assert note(EULER, record(noise=900.0))[1] == ""


@pytest.mark.long
def test_the_page_says_so_with_and_without_a_cause():
    series = record()
    found = engine.diagnose(EULER, series, effects=["bias"], processes=1)
    assert found.verdict.value == "nothing"
    assert any("steps of half the length" in text for text in found.notes)
    off = series.y + 400.0 * (series.t >= 20.0)[:, None]
    moved = engine.Series(off, u=series.u, dt=DT)
    found = engine.diagnose(EULER, moved, effects=["step"], processes=1)
    assert [cause.effect for cause in found.causes] == ["step:tacho"]
    assert any("steps of half the length" in text for text in found.notes)
