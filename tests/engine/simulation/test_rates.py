"""Equations that are rates, written where a model wants its next state."""

from __future__ import annotations

import numpy as np
import pytest

import engine
from engine.errors import ModelError
from engine.simulation.rates import by_rates, check_no_rates


def bath(step, linear=False):
    """A stirred bath, as ``step`` makes it of its temperature, its rate and dt; maybe a linear state."""
    none = np.zeros((1, 0))

    def dynamics(a, u, t, dt, theta):
        if linear:
            f, A = step(0.0, theta.g * u[0] + theta.k * 20.0, dt), step(1.0, -theta.k, dt)
            return [f], [[A]], [[1e-5]]
        return [step(a[:, 0], theta.g * u[0] - theta.k * (a[:, 0] - 20.0), dt)], none, [[1e-5]]

    def measurement(a, u, t, theta):
        return ([0.0], [[1.0]], [[0.01]]) if linear else ([a[:, 0]], none, [[0.01]])

    def initial(theta):
        if linear:
            return None, [20.0], [[0.1]]
        return engine.Gaussian([20.0], [[0.1]]), np.zeros(0), np.zeros((0, 0))

    return engine.MixedModel(
        "bath",
        dynamics,
        measurement,
        initial,
        {"y": "degC"},
        [
            engine.Parameter("g", 0.002, "K/s/W", (0.0, 1.0)),
            engine.Parameter("k", 0.01, "1/s", (0.0, 1.0)),
        ],
        **{"linear" if linear else "nonlinear": {"T": "degC"}},
        inputs={"heater": "W"},
    )


def right(T, rate, dt):
    return T + dt * rate


def rates(T, rate, dt):
    return rate


def recorded(model=None, n=200, dt=5.0):
    u = np.repeat(np.random.default_rng(8).uniform(0.0, 300.0, n // 20), 20)
    model = bath(right) if model is None else model
    return engine.simulate(model, None, n, np.random.default_rng(9), u=u, dt=dt).series


@pytest.mark.long
@pytest.mark.parametrize("linear", [False, True])
def test_rates_are_told_from_steps_by_the_record(linear):
    model, series = bath(rates, linear), recorded()
    with pytest.raises(
        ModelError, match=r"rate of change it explains these data.*engine\.continuous"
    ):
        check_no_rates(model, series, model.theta())
    for fine in (bath(right, linear), by_rates(model)):
        check_no_rates(fine, series, fine.theta())


@pytest.mark.long
def test_a_diagnosis_does_not_begin_with_them():
    with pytest.raises(ModelError, match="rate of change"):
        engine.diagnose(bath(rates), recorded())


@pytest.mark.long
@pytest.mark.parametrize("share", [0.0, 0.9])
def test_a_step_that_is_given_stays_one(share):
    model = bath(lambda T, rate, dt: share * T + rate)  # of one sample
    check_no_rates(model, recorded(model, dt=1.0), model.theta())


@pytest.mark.long
def test_a_map_whose_free_run_tells_nothing_stays_one():
    """Of a chaotic population each generation follows from the last one, and a run is off by its spread."""

    def dynamics(a, u, t, dt, theta):
        return [theta.growth * a[:, 0] * (1.0 - a[:, 0])], np.zeros((1, 0)), [[1e-6]]

    model = engine.MixedModel(
        "generations",
        dynamics,
        lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[1e-4]]),
        lambda theta: (engine.Gaussian([0.3], [[1e-3]]), np.zeros(0), np.zeros((0, 0))),
        {"y": ""},
        [engine.Parameter("growth", 3.7, "", (0.0, 4.0))],
        nonlinear={"n": ""},
    )
    y, n = [], 0.3
    for _ in range(200):
        y.append(n)
        n = 3.8 * n * (1.0 - n)
    check_no_rates(model, engine.Series(y, dt=1.0), model.theta())


def test_by_rates_the_state_goes_on_by_them():
    model, theta = by_rates(bath(rates, linear=True)), bath(rates).theta()
    a, u, record = np.zeros((2, 0)), np.array([100.0]), bath(rates).record(theta)
    f, A, Q = model.transition(a, u, 0.0, 5.0, record)
    assert np.allclose(f, 5.0 * (0.002 * 100.0 + 0.01 * 20.0))
    assert np.allclose(A, 1.0 - 5.0 * 0.01)
    assert np.allclose(Q, 5e-5)
