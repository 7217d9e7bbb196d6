"""From where a fit of the simulation begins: starts that run away or slip, and ends that are as good."""

from __future__ import annotations

import numpy as np
import pytest

import engine
from engine.simulation.problem import FreeRunProblem

P = engine.Parameter
NONE = np.zeros((0, 0))
RATES = {"a": 0.8, "b": 0.04, "c": 0.02, "d": 0.6}
SECOND = {"a1": 1.3, "a2": -0.5, "b": 0.4}
DOSE = {"ka": 2.5, "ke": 0.35, "V": 35.0}


def hunted() -> engine.MixedModel:
    """Prey and predator by Lotka and Volterra; first states are uncertain."""

    def drift(a, u, t, theta):
        x, y = a[:, 0], a[:, 1]
        return [theta.a * x - theta.b * x * y, theta.c * x * y - theta.d * y], np.zeros((2, 0))

    return engine.continuous(
        name="hunted",
        nonlinear={"prey": "1", "predator": "1"},
        outputs={"x": "1", "y": "1"},
        parameters=[P(name, value, "", (0.0, 5.0)) for name, value in RATES.items()],
        drift=drift,
        diffusion=lambda a, u, t, theta: np.zeros((2, 2)),
        measurement=lambda a, u, t, theta: ([a[:, 0], a[:, 1]], np.zeros((2, 0)), np.eye(2)),
        initial=lambda theta: (engine.Gaussian([30.0, 5.0], np.diag([100.0, 9.0])), [], NONE),
    )


def second_order() -> engine.MixedModel:
    def dynamics(a, u, t, dt, theta):
        f = [theta.a1 * a[:, 0] + theta.a2 * a[:, 1] + theta.b * u[0], a[:, 0]]
        return f, np.zeros((2, 0)), np.zeros((2, 2))

    return engine.MixedModel(
        name="second-order",
        nonlinear={"x": "1", "before": "1"},
        inputs={"u": "1"},
        outputs={"y": "1"},
        parameters=[
            P("a1", 1.3, "", (-2.0, 2.0)),
            P("a2", -0.5, "", (-1.0, 1.0)),
            P("b", 0.4, "", (-10.0, 10.0)),
        ],
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[0.01]]),
        initial=lambda theta: (engine.Gaussian([0.0, 0.0], np.zeros((2, 2))), [], NONE),
    )


def dosed() -> engine.MixedModel:
    """A dose that is absorbed with the rate ka, and eliminated with the rate ke."""

    def drift(a, u, t, theta):
        f = [u[0] - theta.ka * a[:, 0], theta.ka * a[:, 0] / theta.V - theta.ke * a[:, 1]]
        return f, np.zeros((2, 0))

    return engine.continuous(
        name="dosed",
        nonlinear={"gut": "mg", "blood": "mg/L"},
        inputs={"dose": "mg/h"},
        outputs={"y": "mg/L"},
        parameters=[
            P("ka", 1.0, "1/h", (0.0, 20.0)),
            P("ke", 0.9, "1/h", (0.0, 20.0)),
            P("V", 35.0, "L", (0.1, 1e3)),
        ],
        drift=drift,
        diffusion=lambda a, u, t, theta: np.zeros((2, 2)),
        measurement=lambda a, u, t, theta: ([a[:, 1]], np.zeros((1, 0)), [[0.01]]),
        initial=lambda theta: (engine.Gaussian([0.0, 0.0], np.zeros((2, 2))), [], NONE),
    )


def record(model: engine.MixedModel, values, t, u=None, noise=0.1, first=None) -> engine.Series:
    """The run from the mean of the first state, or from ``first``, with noise."""
    blank = np.zeros((len(t), model.ny))
    empty = engine.Series(
        blank, u, t=t, y_names=list(model.outputs), u_names=list(model.inputs), time_unit="h"
    )
    start = [] if first is None else [np.array(first), np.zeros(0)]
    y = engine.free_run(model, values, empty, *start).y
    return empty.replace(y=y + noise * np.random.default_rng(0).standard_normal(y.shape))


@pytest.mark.long
@pytest.mark.parametrize("times", [0.5, 4.0])
def test_an_oscillation_whose_phase_slips_is_found(times):
    """Both ended at a hundred times the least error, "converged": with half the rates, and with four times."""
    model = hunted()
    series = record(model, RATES, np.arange(0.0, 40.0, 0.5), noise=2.0, first=[25.0, 6.0])
    found = engine.fit_simulation(model, series, {name: times * one for name, one in RATES.items()})
    assert found.success
    assert found.nrmse < 0.2
    assert found.theta.asdict() == pytest.approx(RATES, rel=0.1)


def test_a_parameter_is_not_silent_where_the_run_runs_away():
    """Beside derivatives of 1e27 those of two rates seemed to be none."""
    model = hunted()
    series = record(model, RATES, np.arange(0.0, 40.0, 0.5), noise=2.0)
    far = model.theta({name: 4.0 * value for name, value in RATES.items()})
    problem = FreeRunProblem(model, [series], far, model.free_indices(None))
    problem.look_for_silent()
    assert problem.names(problem.silent) == ()


def test_an_unstable_start_is_one_of_several():
    """It was an error: "the run from these values runs away", whatever the other starts were."""
    model, u = second_order(), np.repeat(np.random.default_rng(3).uniform(-1.5, 1.5, 40), 5)
    series = record(model, SECOND, np.arange(200.0), u[:, None])
    found = engine.fit_simulation(model, series, {"a1": 1.95, "a2": -0.75, "b": 0.6})
    assert found.rmse < 0.11
    assert found.theta.asdict() == pytest.approx(SECOND, rel=0.1)


def test_another_minimum_that_is_as_good_is_told():
    """Absorption and elimination change places: thirty standard errors apart, and told by no word."""
    model, t = dosed(), np.array([0, 0.25, 0.5, 0.75, 1, 1.5, 2, 3, 4, 6, 8, 10, 12.0])
    u = np.zeros((len(t), 1))
    u[0] = 400.0
    found = engine.fit_simulation(
        model, record(model, DOSE, t, u, noise=0.02), {"ka": 0.9, "ke": 0.9, "V": 13.0}
    )
    assert "hardly tell the estimate from another minimum" in found.message
    plain = engine.fit_simulation(
        model, record(model, DOSE, t, u, noise=0.02), DOSE, free=["ke", "V"]
    )
    assert "another minimum" not in plain.message
