"""Parameters that are only known together, next to a bound: they are brought back to where a search began."""

from __future__ import annotations

import numpy as np
import pytest

import engine
from engine.estimation.quasi_ml import quasi_ml
from engine.estimation.tied_edges import off_tied_edges

P = engine.Parameter


def cart(unit: float = 1.0, limit: float = 3.0) -> engine.MixedModel:
    """v' = (gain u - drag v) / mass + w: all three may be larger together; masses in ``unit`` kg."""

    def dynamics(a, u, t, dt, theta):
        m = theta.mass * unit
        return [dt * theta.gain * u[0] / m], [[1.0 - dt * theta.drag / m]], [[theta.q * dt]]

    return engine.MixedModel(
        name="cart",
        linear={"v": "m/s"},
        inputs={"throttle": "%"},
        outputs={"speed": "m/s"},
        parameters=[
            P("gain", 0.2, "N/%", (0.0, 10.0)),
            P("drag", 0.5, "N s/m", (0.0, 50.0)),
            P("mass", 1.4 / unit, "kg", (0.5 / unit, limit / unit)),
            P("q", 1e-3, "(m/s)^2/s", (1e-9, 1.0)),
            P("r", 1e-2, "(m/s)^2", (1e-6, 1.0)),
        ],
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r]]),
        initial=lambda theta: (None, [0.0], [[0.1]]),
    )


def record(model: engine.MixedModel, seed: int) -> engine.Series:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-10.0, 10.0, 15), 10)
    truth = {"gain": 0.3, "drag": 0.7}
    return engine.simulate(model, truth, 150, rng, u=u, dt=0.1).series


@pytest.mark.parametrize("unit", [1.0, 1e-3])
@pytest.mark.parametrize("at", [3.0, 2.9, 0.5])
def test_a_mass_comes_back_from_its_bound_with_what_is_tied_to_it(unit, at):
    model = cart(unit)
    series = record(model, 1)
    share = at / 1.4
    begun = {"gain": 0.3 * share, "drag": 0.7 * share, "mass": at / unit}
    fit = quasi_ml(model, series, begun)
    back = off_tied_edges(fit, series, model.theta())
    assert set(fit.tied) == {"gain", "drag", "mass"}
    assert back.theta["mass"] == pytest.approx(1.4 / unit, rel=0.05)
    for name in ("gain", "drag"):
        ratio = back.theta[name] / back.theta["mass"]
        assert ratio == pytest.approx(fit.theta[name] / fit.theta["mass"], rel=0.02)
    assert back.log_likelihood == pytest.approx(fit.log_likelihood, abs=0.02)
    assert back.free == fit.free


def test_what_the_data_put_at_a_bound_stays_there():
    model = cart()
    series = record(model, 2)
    free = ["gain", "drag", "q", "r"]
    tight = engine.MixedModel(
        **{
            **{name: getattr(model, name) for name in ("linear", "inputs", "outputs", "name")},
            "dynamics": model.dynamics,
            "measurement": model.measurement,
            "initial": model.initial,
            "parameters": [P("gain", 0.1, "N/%", (0.0, 0.2)), *model.parameters[1:]],
        }
    )
    fit = quasi_ml(tight, series, free=free)
    assert tight.at_bounds(fit.theta, free) == ("gain",)
    assert off_tied_edges(fit, series, tight.theta()) is fit
