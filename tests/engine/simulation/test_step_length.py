"""Models that make too long a step say so where they are run or fitted, and the advice they give holds."""

from __future__ import annotations

import re
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import engine
from engine.models.oscillator import MODEL as OSCILLATOR
from engine.simulation.step_length import (
    about_free_runs,
    change_of_run,
    run_at_samples,
    too_long,
)

TOO_LONG = "The model's steps are too long for these data: with 2 steps a sample "


def pendulum(**changes):
    """Swings widely with a period of a second; d and w2 are unknown."""
    fields = {
        "name": "pendulum", "kinematic": ["angle"],
        "nonlinear": {"angle": "rad"}, "linear": {"rate": "rad/s"}, "outputs": {"y": "rad"},
        "drift": lambda a, u, t, th: ([0.0, -th.w2 * np.sin(a[:, 0])], [[1.0], [-th.d]]),
        "diffusion": lambda a, u, t, th: np.diag([0.0, th.q]),
        "measurement": lambda a, u, t, th: ([a[:, 0]], [[0.0]], [[th.r]]),
        "initial": lambda th: (engine.Gaussian([1.5], [[0.01]]), [0.0], [[0.01]]),
        "parameters": [
            engine.Parameter("w2", 38.0, "1/s^2", (0.0, 1e3)), engine.Parameter("d", 0.1, "1/s", (0.0, 5.0)),
            engine.Parameter("q", 1e-3, "", (1e-12, 10.0)), engine.Parameter("r", 1e-3, "", (1e-8, 1.0)),
        ],
    }  # fmt: skip
    return engine.continuous(**{**fields, **changes})


@cache
def swings(dt=0.1):
    """By SciPy, with w2 = 40, d = 0.2 and readings to 0.02 rad."""
    t = np.arange(0.0, 6.0, dt)
    y = solve_ivp(
        lambda t, x: [x[1], -40.0 * np.sin(x[0]) - 0.2 * x[1]],
        (0.0, t[-1]), [1.5, 0.0], t_eval=t, rtol=1e-9, atol=1e-10,
    ).y[0]  # fmt: skip
    return engine.Series(y + 0.02 * np.random.default_rng(0).standard_normal(len(t)), dt=dt)


def advised(message):
    assert TOO_LONG in message
    return int(re.search(r"Use series\.refined\((\d+)\)", message).group(1))


def test_a_fit_says_so_and_is_right_with_the_steps_that_it_advises():
    model, series = pendulum(), swings()
    coarse = engine.fit_simulation(model, series, n_starts=0)
    assert coarse.theta["d"] - 0.2 > 10.0 * coarse.standard_errors["d"]
    assert "the free run changes by " in coarse.message
    fine = engine.fit_simulation(model, series.refined(advised(coarse.message)), n_starts=0)
    assert "steps" not in fine.message
    for name, value in (("w2", 40.0), ("d", 0.2)):
        assert abs(fine.theta[name] - value) < 4.0 * fine.standard_errors[name]


def test_several_records_are_told_by_the_worst():
    model, both = pendulum(), [swings(0.01), swings(0.1)]
    x1 = np.tile([1.5, 0.0], (2, 1))
    theta = model.theta({"w2": 40.0, "d": 0.2})
    assert about_free_runs(model, theta, both[:1], x1) == ""
    assert TOO_LONG in about_free_runs(model, theta, both, x1)


def test_a_free_run_says_so_with_readings_and_without():
    model, truth = pendulum(), {"w2": 40.0, "d": 0.2}
    run = engine.free_run(model, truth, swings())
    assert advised(run.note) > 1
    assert "of its error" in run.note
    assert "too long" in str(run)
    blind = engine.Series(np.full(60, np.nan), dt=0.1)
    assert "of its spread" in engine.free_run(model, truth, blind).note
    assert engine.free_run(model, truth, blind.refined(16)).note == ""
    wild = engine.Series(np.full(60, np.nan), dt=0.3)
    told = engine.free_run(model, truth, wild).note
    assert "Even series.refined(16) does not do" in told or advised(told) == 16


def levitated(n=150, dt=0.01, k=200.0):
    """A ball below a magnet, x'' = k (x / 2 + sin(50 x) / 100 + 2 u): it falls but for its controller."""
    rng, x, ys, us = np.random.default_rng(0), np.array([0.02, 0.0]), [], []
    before, h = 0.0, dt / 10.0
    for _ in range(n):
        y = x[0] + 1e-3 * rng.standard_normal()
        u = -2.0 * before - 0.15 * x[1]
        for _ in range(10):
            x = x + h * np.array([x[1], k * (0.5 * x[0] + 0.01 * np.sin(50.0 * x[0]) + 2.0 * u)])
            x[1] += np.sqrt(h) * 0.05 * rng.standard_normal()
        before = y
        ys.append(y)
        us.append(u)
    return engine.Series(np.array(ys), np.array(us), dt=dt)


def test_runs_of_an_unstable_plant_are_compared_before_they_run_away():
    def drift(a, u, t, th):
        x = a[:, 0]
        return [0.0, 200.0 * (0.5 * x + 0.01 * np.sin(50.0 * x) + 2.0 * u[0])], [[1.0], [-th.d]]

    def initial(th):
        return engine.Gaussian([0.02], [[1e-6]]), [0.0], [[1e-6]]

    model = pendulum(name="levitated", drift=drift, initial=initial, inputs={"current": "1"})
    series = levitated()
    theta, x1 = model.theta({"d": 0.0}), np.array([0.02, 0.0])
    runs = [run_at_samples(model, theta, series.refined(k), x1) for k in (1, 2)]
    assert max(np.abs(run[:, 0]).max() for run in runs) > 1e3 * np.abs(series.y).max()
    assert 0.0 < change_of_run(series, *runs) < 0.1
    assert "steps" not in engine.free_run(model, theta, series).note


def test_of_rows_where_both_runs_are_away_nothing_is_compared():
    y = np.array([[0.0], [1.0], [0.0], [np.nan], [1.0], [0.0]])
    one, grows = y.copy(), np.array([[0.0], [0.0], [3.0], [9.0], [50.0], [1e9]])
    one[3] = 1.0
    series = engine.Series(y)
    off = one + 0.1
    assert change_of_run(series, off + grows, off - grows) == pytest.approx(0.0)
    # one of them alone, or both for a while, says that they differ
    assert change_of_run(series, off + grows, off) > 0.5
    grows[-1] = 0.0
    assert change_of_run(series, off + grows, off - grows) > 0.5
    # one that leaves much earlier differs, too
    late = np.where(np.arange(6)[:, None] < 4, 0.0, 1e9)
    assert change_of_run(series, off + np.where(grows > 2.0, 1e9, 0.0), off + late) > 0.5
    # where none is near, all is compared
    assert change_of_run(series, off + 10.0, off + 20.0) == pytest.approx(10.0 / 10.1, rel=0.01)
    # no number is no nearer than what is far
    grows[-1] = np.inf
    assert change_of_run(series, off + grows, off - grows) == pytest.approx(0.0)


def test_how_far_a_run_is_that_leaves_a_row_before_another_says_nothing():
    y = np.sin(0.1 * np.arange(60))[:, None]
    one = y + 0.1 + 4.0 * (np.arange(60) >= 50)[:, None]
    other = y + 0.1 + 1e6 * (np.arange(60) >= 51)[:, None]
    assert change_of_run(engine.Series(y), one, other) == pytest.approx(0.0)
    assert change_of_run(engine.Series(y), other, one) == pytest.approx(0.0)


def test_what_has_no_shorter_steps_or_needs_none_says_nothing():
    series = engine.simulate(
        OSCILLATOR, None, 100, np.random.default_rng(0), u=np.ones(100), dt=0.3
    ).series
    assert engine.free_run(OSCILLATOR, None, series).note == ""
    assert "steps" not in engine.fit_simulation(OSCILLATOR, series, n_starts=0).message
    mixed = engine.get_model("mixed-4")
    assert not mixed.continuous
    series = engine.simulate(mixed, None, 50, np.random.default_rng(0)).series
    assert engine.free_run(mixed, None, series).note == ""


def test_how_many_steps_are_enough():
    def falling(k):
        return 4.0 * 0.25 ** np.log2(k)

    assert too_long(falling, 1, 5.0) is None
    assert too_long(falling, 1, 2.0) == (4.0, 4)  # of a change that is small enough, a part
    assert too_long(falling, 4, 0.2) == (0.25, 16)
    assert too_long(lambda k: 1.0, 1, 0.1) == (1.0, 0)
    # as many as there may be, where they will just do: the warning asks for no more
    assert too_long(falling, 8, 0.05) == (0.0625, 16)
    assert too_long(lambda k: np.nan, 1, 0.1) is None


def test_a_change_is_a_share_of_the_residual_of_its_output():
    y = np.array([[1.0, np.nan, 3.0], [-1.0, np.nan, 3.0], [1.0, np.nan, 3.0]])
    one = np.array([[0.0, 0.0, 3.0], [0.0, 1.0, 3.0], [0.0, 2.0, 3.0]])
    series = engine.Series(y)
    assert change_of_run(series, one, one + np.array([0.5, 0.0, 0.0])) == pytest.approx(0.5)
    assert change_of_run(series, one, one + np.array([0.0, 0.1, 0.0])) == pytest.approx(
        1.0 / one[:, 1].std()
    )
    assert change_of_run(series, one, one + np.array([0.0, 1e-10, 0.0])) == 0.0
    assert np.isnan(change_of_run(series, one, np.full_like(one, np.nan)))


def test_an_output_at_rest_and_data_without_noise_change_nothing():
    k = np.arange(200)
    one = np.column_stack([np.sin(0.1 * k), np.full(200, 293.15)])
    other = one + np.column_stack([1e-7 * np.cos(0.1 * k), 1e-13 * k])
    exact = engine.Series(one, dt=1.0)
    assert change_of_run(exact, one, other) < 0.01
    assert change_of_run(exact, one, one + 0.01 * np.sin(0.3 * k)[:, None] * [1.0, 0.0]) > 10.0
