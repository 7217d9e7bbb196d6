"""A model as a user writes it, with no or several inputs, in other units, integrated by another program."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import engine
from engine.data.series import Series
from engine.diagnose.free_run.answer import search_free_runs
from engine.diagnose.free_run.second_opinion import second_opinion
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.refits.found import Search
from engine.diagnose.search.pipeline import Causes
from engine.estimation.quasi_ml import quasi_ml

T, DT = 300, 0.05
KINDS = ("cubic", "drag", "quadratic", "force", "linear", "bias")


def cart(unit=1.0, zero=0.0, inputs=2):
    """A cart on a spring with a damper; positions in ``unit`` metres, counted from elsewhere."""

    def dynamics(a, u, t, dt, theta):
        push = sum(theta.gain * u[i] for i in range(inputs)) / unit
        x = a[:, 0] - zero
        rate = a[:, 1] + dt * (-theta.k * x - theta.c * a[:, 1] + push)
        return (
            [a[:, 0] + dt * rate, rate],
            np.zeros((2, 0)),
            np.diag([0.0, dt * (theta.q / unit) ** 2]),
        )

    return engine.MixedModel(
        name="cart",
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[(1e-3 / unit) ** 2]]),
        initial=lambda theta: (
            engine.Gaussian([zero, 0.0], np.diag([1.0, 1.0]) / unit**2),
            [],
            np.zeros((0, 0)),
        ),
        nonlinear={"position": "m", "rate": "m/s"},
        kinematic=("position",),
        inputs={f"push{i}": "m/s^2" for i in range(inputs)},
        outputs={"y": "m"},
        reference={"position": zero, "rate": 0.0, "y": zero},
        parameters=[
            engine.Parameter("k", 9.0, "1/s^2", (0.0, 100.0)),
            engine.Parameter("c", 0.5, "1/s", (0.0, 20.0)),
            engine.Parameter("gain", 1.0, "1", (0.0, 10.0)),
            engine.Parameter("q", 1e-2, "m/s^1.5", (1e-8, 10.0)),
        ],
    )


@cache
def _readings(inputs):
    """Metres, with drag that the cart does not know, by a fine Runge-Kutta."""
    rng = np.random.default_rng(inputs)
    u = 4.0 * np.repeat(rng.standard_normal((T // 10, inputs)), 10, axis=0)
    y, x = np.zeros(T), np.array([1.5, 0.0])
    for i in range(T):
        y[i] = x[0]
        force = u[i].sum()
        run = solve_ivp(
            lambda t, s, force=force: [s[1], force - 9.0 * s[0] - 0.3 * s[1] - 0.8 * s[1] * abs(s[1])],
            (0.0, DT), x, rtol=1e-8,
        )  # fmt: skip
        x = run.y[:, -1]
    return y + 1e-3 * rng.standard_normal(T), u


def _series(unit, zero, inputs):
    y, u = _readings(inputs)
    return Series(y / unit + zero, u, dt=DT)


def _base(model, series):
    return quasi_ml(model, series, model.theta(), max_iterations=5)


@pytest.mark.slow
@pytest.mark.parametrize("inputs", [0, 1, 2])
def test_it_is_asked_however_many_inputs_there_are(inputs):
    model, series = cart(inputs=inputs), _series(1.0, 0.0, inputs)
    base = _base(model, series)
    nothing = Causes(base, None, Search(base, base, (), False), Verdict.NOTHING, ())
    said = second_opinion(
        nothing, [series], model.theta(), alpha=0.05, kinds=("force", "bias"), seed=0,
        progress=lambda stage, fraction: None,
    )  # fmt: skip
    assert "not asked" not in said.reason
    assert said.alarm is not None


def _search(unit, zero):
    model, series = cart(unit, zero), _series(unit, zero, 2)
    return search_free_runs(
        _base(model, series), [series], model.theta(), levels=(0.05, 0.05), kinds=KINDS, seed=0,
        progress=lambda stage, fraction: None,
    )  # fmt: skip


@pytest.mark.slow
def test_the_answer_does_not_depend_on_units_nor_on_their_zero():
    usual, other = _search(1.0, 0.0), _search(1e-6, 3e5)
    assert [c.names for c in usual.found] == [c.names for c in other.found]
    assert usual.rounds[0].alarm.p_value == other.rounds[0].alarm.p_value
    first, second = usual.rounds[0], other.rounds[0]
    ratios = [c.held_out / first.held_out for c in first.candidates[:3]]
    assert [c.held_out / second.held_out for c in second.candidates[:3]] == pytest.approx(
        ratios, 0.02
    )
    assert usual.found[0].names == (
        "drag:rate",
    )  # though pairs do better by what Euler's steps leave
