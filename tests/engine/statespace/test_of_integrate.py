"""A model whose step is ``solve_ivp``: the same numbers, on tape, without a call of it for each particle."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.integrate
from scipy.integrate import solve_ivp

import engine.filters.sigma_point
from engine.data.series import Series
from engine.filters.filter_steps import FilterSteps, Thetas
from engine.filters.sigma_point import moment_filter, run_on_tape
from engine.statespace.model import Gaussian, MixedModel, Parameter
from engine.statespace.on_tape import about_calls

T = 60


def swing(t, x, k, u):
    """A van der Pol oscillator with an input."""
    return [x[1], k * (1.0 - x[0] ** 2) * x[1] - x[0] + u]


def plainly(a, u, t, dt, theta):
    return np.array(
        [solve_ivp(lambda t, x: swing(t, x, theta.k, u[0]), (0.0, dt), x).y[:, -1] for x in a]
    )


def in_its_own_way(a, u, t, dt, theta):
    from scipy.integrate import solve_ivp as run

    out = np.empty_like(a)
    for i in range(len(a)):
        sol = run(
            swing, [t, t + dt], a[i], args=(theta.k, u[0]), rtol=1e-6, atol=1e-9, max_step=0.2
        )
        assert sol.success
        out[i] = sol.y.T[-1]
    return out


def at_times(a, u, t, dt, theta):
    out = []
    for x in a:
        sol = scipy.integrate.solve_ivp(
            lambda t, x: np.array(swing(t, x, theta.k, u[0])),
            (0.0, 2.0 * dt),
            x,
            "RK23",
            t_eval=[0.0, dt],
        )
        out.append(sol.y[:, 1])
    return np.array(out)


def one_number(a, u, t, dt, theta):
    """Of one state, whose slope is a number; its rows, ends and times are read in other ways."""
    out = []
    for x, v in a:
        first = solve_ivp(lambda t, x: -theta.k * x[0] ** 3 + u[0], (0.0, dt), [x])
        both = solve_ivp(lambda t, x: (x[1], -theta.k * x[0]), (t, t + dt), (x, v), rtol=1e-5)
        position, speed = both.y
        out.append(
            [
                first.y[0, -1] * first.t[-1] / dt,
                0.3 * np.tanh(position[-1] * speed[0]) + 0.1 * both.y[1][-1],
            ]
        )
    return np.array(out)


def implicitly(a, u, t, dt, theta):
    return np.array(
        [
            solve_ivp(lambda t, x: swing(t, x, theta.k, u[0]), (0.0, dt), x, method="LSODA").y[
                :, -1
            ]
            for x in a
        ]
    )


def model_of(step):
    return MixedModel(
        name=step.__name__,
        dynamics=lambda *given: (step(*given), np.zeros((2, 0)), np.diag([1e-4, 1e-2])),
        measurement=lambda a, u, t, theta: (a[:, :1], np.zeros((1, 0)), [[0.01]]),
        initial=lambda theta: (Gaussian([1.0, 0.0], 0.1 * np.eye(2)), [], np.zeros((0, 0))),
        nonlinear={"x": "m", "v": "m/s"},
        inputs={"u": "m/s^2"},
        outputs={"y": "m"},
        parameters=[Parameter("k", 3.0, bounds=(0.0, 9.0))],
    )


def series():
    rng = np.random.default_rng(4)
    t = np.linspace(0.0, 15.0, T)
    y = 2.0 * np.sign(np.cos(t))[:, None] + 0.3 * rng.standard_normal((T, 1))
    return Series(y, rng.standard_normal((T, 1)), t=t)


@pytest.mark.parametrize("step", [plainly, in_its_own_way, at_times, one_number])
def test_each_row_is_what_it_is_alone(step):
    model, rng = model_of(step), np.random.default_rng(1)
    a = rng.normal(0.0, 2.0, (40, 2))  # some need steps that are taken again
    record = model.record(model.theta())
    for u in (-1.0, 0.0, 2.0):
        got, _, _ = model.transition(a, np.array([u]), 0.5, 0.4, record)
        expected = [step(x[None], np.array([u]), 0.5, 0.4, record)[0] for x in a]
        np.testing.assert_allclose(got, expected, rtol=1e-11, atol=1e-11)


@pytest.mark.long
@pytest.mark.parametrize("step", [plainly, in_its_own_way, one_number])
def test_filters_stay_on_tape(step, monkeypatch):
    model, thetas = model_of(step), np.array([[3.0], [3.3], [2.0]])
    taped = run_on_tape(FilterSteps(model, Thetas(model, thetas), series()))
    monkeypatch.setattr(engine.filters.sigma_point, "filter_by_tape", lambda *_: None)
    called = moment_filter(model, thetas, series())
    np.testing.assert_allclose(taped.log_terms, called.log_terms, rtol=1e-7, atol=1e-7)


def test_methods_that_are_not_recorded_are_called():
    model, a = model_of(implicitly), np.array([[1.0, 0.3], [-2.0, 0.1]])
    record = model.record(model.theta())
    got, _, _ = model.transition(a, np.array([0.5]), 0.0, 0.4, record)
    expected = [implicitly(x[None], np.array([0.5]), 0.0, 0.4, record)[0] for x in a]
    np.testing.assert_array_equal(got, expected)
    assert not model.transitions.recorded


@pytest.mark.long
def test_who_has_to_be_called_is_told_where():
    model = model_of(implicitly)
    moment_filter(model, np.array([[3.0]]), series())
    told = about_calls([model.transitions, model.observations])
    assert "could not be used for dynamics (test_of_integrate.py, line " in told
    assert "in <listcomp>)" in told or "in implicitly)" in told
    model = model_of(plainly)
    moment_filter(model, np.array([[3.0]]), series())
    assert about_calls([model.transitions, model.observations]) == ""
