"""Differential equations that are linear are told from those that nearly are, in any step and unit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

import engine
from engine.errors import ModelError
from engine.filters.kalman import kalman_smoother
from engine.filters.linearity import why_not_linear

STEPS = (0.02, 0.2, 0.3, 0.576, 1.0)  # of a period of 1.15 s; half of it, too


def oscillator(stiffens=0.0, drags=0.0, unit=1.0, P1=0.1, damping=1.0):
    """One state in a, one in z, in 1 / ``unit`` m; bent by such shares at 1 m."""

    def drift(a, u, t, theta):
        share = (a[:, 0] / unit) ** 2
        rate = -theta.k * a[:, 0] * (1.0 + stiffens * share) + 9.81 * unit
        own = np.stack([np.ones(len(a)), -damping * (1.0 + drags * share)], axis=1)
        return [0.0 * a[:, 0], rate], own[:, :, None]

    return engine.continuous(
        name="oscillator", drift=drift, nonlinear={"x": "m"}, linear={"v": "m/s"}, outputs={"y": "m"},
        diffusion=lambda a, u, t, theta: np.diag([0.0, theta.q * unit**2]),
        measurement=lambda a, u, t, theta: ([a[:, 0]], [[0.0]], [[1e-2 * unit**2]]),
        initial=lambda theta: (
            engine.Gaussian([0.0], [[P1 * unit**2]]), [0.0], [[P1 * unit**2]]
        ),
        parameters=[engine.Parameter("k", 30.0), engine.Parameter("q", 2.0)],
    )  # fmt: skip


def readings(dt, unit=1.0):
    return engine.Series(unit * 0.3 * np.random.default_rng(0).normal(size=40), dt=dt)


def by_hand(y, dt):
    """The log-likelihood of the oscillator's readings y (T,), by its matrix exponential."""
    F, rest = np.array([[0.0, 1.0], [-30.0, -1.0]]), np.array([9.81 / 30.0, 0.0])
    block = expm(np.block([[-F, np.diag([0.0, 2.0])], [np.zeros((2, 2)), F.T]]) * dt)
    A = block[2:, 2:].T
    Q, x, P, total = A @ block[:2, 2:], np.zeros(2), 0.1 * np.eye(2), 0.0
    for value in y:
        S, e = P[0, 0] + 1e-2, value - x[0]
        total -= 0.5 * (e * e / S + np.log(2.0 * np.pi * S))
        K = P[:, 0] / S
        x, P = x + K * e, P - np.outer(K, P[0])
        x, P = rest + A @ (x - rest), A @ P @ A.T + Q
    return total


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e7])
@pytest.mark.parametrize("dt", STEPS)
def test_a_linear_one_is_smoothed_exactly(dt, unit):
    series = readings(dt, unit)
    found = kalman_smoother(oscillator(unit=unit), None, series).log_likelihood
    exact = by_hand(series.y[:, 0] / unit, dt) - len(series) * np.log(unit)
    assert found == pytest.approx(exact, abs=1e-5)
    assert why_not_linear(oscillator(unit=unit), None, series) == ""


@pytest.mark.parametrize("dt", STEPS)
def test_a_known_start_is_no_obstacle(dt):
    assert np.isfinite(kalman_smoother(oscillator(P1=0.0), None, readings(dt)).log_likelihood)


@pytest.mark.parametrize("off", [0.0, 1e-4, 0.5])
def test_nor_is_a_whole_period_in_a_step(off):
    dt = 2.0 * np.pi / np.sqrt(30.0) * (1.0 + off)
    model = oscillator(damping=0.0)
    assert np.isfinite(kalman_smoother(model, {"q": 1e-6}, readings(dt)).log_likelihood)


def test_its_check_and_its_em_agree():
    assert any("rts-em is exact" in one for one in engine.model_check(oscillator()))
    found = engine.rts_em(oscillator(), readings(0.3), {"k": 25.0}, ["k"], n_iterations=2)
    assert np.isfinite(found.log_likelihood).all()


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e7])
@pytest.mark.parametrize("bend", [{"stiffens": 1e-5}, {"drags": 1e-5}], ids=lambda b: next(iter(b)))
@pytest.mark.parametrize("dt", STEPS)
def test_one_that_bends_by_a_hundred_thousandth_is_refused(dt, bend, unit):
    with pytest.raises(ModelError, match="not linear Gaussian"):
        kalman_smoother(oscillator(unit=unit, **bend), None, readings(dt, unit))


def valve(switched=False):
    """A level behind a valve, or one whose leak opens late."""

    def dynamics(a, u, t, dt, theta):
        moved = 0.1 * u[0] * np.sqrt(np.abs(3.0 - a)) - (t > 20.0) * switched * a**3
        return 0.9 * a + moved, np.zeros((1, 0)), [[0.1]]

    return engine.MixedModel(
        name="valve",
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: (a, np.zeros((1, 0)), [[0.01]]),
        initial=lambda theta: (engine.Gaussian([0.0], [[1.0]]), [], np.zeros((0, 0))),
        nonlinear={"level": "m"},
        inputs={"valve": "1"},
        outputs={"gauge": "m"},
        parameters=[],
    )


def test_a_model_that_bends_only_with_its_input_is_not_linear():
    assert "f is not affine in a" in why_not_linear(valve())


@pytest.mark.parametrize(("switched", "linear"), [(False, True), (True, False)])
def test_all_of_a_record_is_asked(switched, linear):
    series = engine.Series(np.zeros(100), np.zeros(100), dt=0.5)
    assert (not why_not_linear(valve(switched), None, series)) is linear


def test_a_step_in_which_an_unstable_plant_runs_away_excuses_nothing():
    magnet = engine.continuous(  # what falls away within milliseconds: a step of 1 s is beyond numbers
        name="magnet", nonlinear={"gap": "m", "current": "A"}, linear={"speed": "m/s"},
        inputs={"voltage": "V"}, outputs={"y": "m"},
        drift=lambda a, u, t, theta: (
            [0.0, 4.0 * (u[0] - 11.0 * a[:, 1]), 9.81 - 9e-4 * (a[:, 1] / np.maximum(a[:, 0], 1e-3)) ** 2],
            [[1.0], [0.0], [0.0]],
        ),
        diffusion=lambda a, u, t, theta: np.diag([0.0, 4e-4, 1.6e-5]),
        measurement=lambda a, u, t, theta: ([a[:, 0]], [[0.0]], [[1e-8]]),
        initial=lambda theta: (engine.Gaussian([0.013, 1.3], np.diag([2.5e-7, 2.5e-3])), [0.0], [[1e-4]]),
        parameters=[],
    )  # fmt: skip
    assert "is not linear Gaussian" in why_not_linear(magnet)
