"""A record that is cut from a run: what only makes up for where it begins has no name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import Round
from engine.diagnose.search.begun_elsewhere import begun_elsewhere
from engine.estimation.quasi_ml import quasi_ml

P = engine.Parameter


def drive(scale: float = 1.0) -> engine.MixedModel:
    """A drive that begins at rest at its zero, its angle in ``1 / scale`` rad."""

    def dynamics(a, u, t, dt, theta):
        keep = np.exp(-theta.rate * dt)
        turn = (1.0 - keep) / theta.rate
        push = scale * theta.gain * u[0]
        f = [push * (dt - turn) / theta.rate, push * turn]
        return f, [[1.0, turn], [0.0, keep]], np.diag([0.0, scale**2 * theta.q * dt])

    return engine.MixedModel(
        name="drive",
        nonlinear={},
        linear={"angle": "rad", "speed": "rad/s"},
        inputs={"volt": "V"},
        outputs={"pos": "rad"},
        parameters=[
            P("gain", 5.0, "rad/s^2/V", (0.1, 50.0)),
            P("rate", 2.5, "1/s", (0.1, 50.0)),
            P("q", 1e-3, "(rad/s)^2/s", (0.0, 100.0)),
            P("r", 1e-4, "", (1e-10, 1.0)),
        ],
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([0.0], [[1.0, 0.0]], [[scale**2 * theta.r]]),
        initial=lambda theta: (
            engine.Gaussian([], np.zeros((0, 0))),
            [0.0, 0.0],
            np.diag([0.01, 0.01]) * scale**2,
        ),
    )


def run(seed: int, first: int, scale: float = 1.0, bias: float = 0.0) -> engine.Series:
    rng = np.random.default_rng(seed)
    n, dt = 300 + first, 0.02
    u = np.repeat(rng.uniform(-8.0, 8.0, n // 25 + 1), 25)[:n]
    theta = {"gain": 6.0, "rate": 3.0, "q": 1e-3, "r": 1e-4}
    series = engine.simulate(drive(), theta, n, rng, u=u, dt=dt).series
    y = scale * (series.y[first:] + bias)
    return engine.Series(y, series.u[first:], dt=dt, y_names=["pos"], u_names=["volt"])


def said(series, scale, name, share):
    """Of an effect that gains such a share of what another beginning does."""
    model = drive(scale)
    base = quasi_ml(model, series)
    wide = replace(
        model,
        initial=lambda theta: (
            engine.Gaussian([], np.zeros((0, 0))),
            [0.0, 0.0],
            np.diag([100.0, 100.0]) * scale**2,
        ),
    )
    worth = 2.0 * (quasi_ml(wide, series).log_likelihood - base.log_likelihood)
    effect = make_effect(name, setting_for(model, series, base.theta))
    led = Refit(effect, base, share * worth, share * worth)
    found = Search(base, base, (Round(None, (led,), None, (led,)),), False)
    return begun_elsewhere(found, series)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("scale", [1e-3, 1.0, 57.3])
def test_what_gains_less_than_another_beginning_is_told(seed, scale):
    series = run(seed, 150, scale)
    text = said(series, scale, "gain:pos", 0.9)
    assert text.startswith("The record begins where the model's first state says that none does")
    assert "more than gain:pos explains" in text
    assert said(series, scale, "gain:pos", 1.1) == ""
    assert said(series, scale, "start:angle", 0.9) == ""


@pytest.mark.parametrize("seed", range(3))
def test_a_record_that_begins_as_said_keeps_its_names(seed):
    assert said(run(seed, 0), 1.0, "gain:pos", 0.9) == ""


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_no_fault_of_the_sensor_is_named_for_a_part_of_a_run(seed):
    found = engine.diagnose(
        drive(), run(seed, 150), effects=["gain", "bias", "start"], seed=1, processes=1
    )
    assert found.verdict.value == "unknown"
    assert "widen the covariances of initial" in found.why[0]
