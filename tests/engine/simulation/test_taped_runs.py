"""A free run through a tape is the one by calls, for one and for many; what leaves its tape is called."""

from __future__ import annotations

import numpy as np
import pytest

import engine
import engine.simulation.simulate
from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.of_series import setting_for
from engine.models.registry import get_model
from engine.simulation.simulate import propagate, states_of
from engine.simulation.taped import run_by_tape
from tests.engine.filters.test_taped import level, pendulum, series_for, thetas_of


def by_calls(model, record, series, x1, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(engine.simulation.simulate, "run_by_tape", lambda *_: None)
        _, a, z = propagate(model, record, series, x1[:, : model.na], x1[:, model.na :])
    return np.concatenate([a, z], axis=2)


def assert_same_runs(taped, called):
    scale = np.nanmax(np.abs(called), axis=(0, 1)) + 1e-300
    np.testing.assert_allclose(taped / scale, called / scale, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", ["pendulum", "mixed-4", "oscillator"])
def test_of_many_parameters(name, monkeypatch):
    model = pendulum() if name == "pendulum" else get_model(name)
    series, thetas = series_for(model, 1), thetas_of(model, 2)
    x1 = 0.1 + 0.01 * np.random.default_rng(3).standard_normal((len(thetas), model.nx))
    record = model.records(thetas)
    taped = run_by_tape(model, record, series, x1, series.steps)
    assert_same_runs(taped, by_calls(model, record, series, x1, monkeypatch))


@pytest.mark.long
def test_with_effects(monkeypatch):
    """One of each kind, of a single run."""
    model = pendulum()
    series = series_for(model, 1)
    x1, without = np.full((1, model.nx), 0.1), []
    effects = all_effects(setting_for(model, series, np.asarray(model.theta())))
    for effect in {effect.kind: effect for effect in effects}.values():
        extended = effect.apply(model)
        record = extended.record(thetas_of(extended, 2)[0])
        first = np.concatenate([x1, np.full((1, extended.nx - model.nx), 0.05)], axis=1)
        taped = run_by_tape(extended, record, series, first, series.steps)
        if taped is None:
            without.append(effect.name)
        else:
            assert_same_runs(taped, by_calls(extended, record, series, first, monkeypatch))
    assert len(without) <= 4, without


def test_a_run_that_is_lost_ends_there(monkeypatch):
    def unstable(a, u, t, dt, theta):
        return 1e30 * theta.k * a * a, np.zeros((1, 0)), [[0.01]]

    model = level(unstable)
    series, record = series_for(model, 1), model.record(model.theta())
    taped = states_of(model, record, series, np.array([2.0]))
    called = by_calls(model, record, series, np.array([[2.0]]), monkeypatch)[:, 0]
    np.testing.assert_array_equal(np.isfinite(taped), np.isfinite(called))
    assert not np.isfinite(taped[-1]).any()


def test_another_way_through_the_function_is_taken():
    def switched(a, u, t, dt, theta):
        return (theta.k if a[0, 0] > 0.5 else 0.2 * theta.k) * a, np.zeros((1, 0)), [[0.01]]

    model = level(switched)
    series, record = series_for(model, 1), model.record(model.theta())
    run = states_of(model, record, series, np.array([1.0]))
    taped = run_by_tape(model, record, series, np.array([[1.0]]), series.steps)
    expected = [1.0]
    for _ in range(len(series) - 1):
        expected.append((0.9 if expected[-1] > 0.5 else 0.18) * expected[-1])
    np.testing.assert_allclose(run[:, 0], expected, rtol=1e-12)
    np.testing.assert_allclose(taped[:, 0, 0], expected, rtol=1e-12)


def test_a_record_that_starts_at_rest_stays_on_tape(monkeypatch):
    """Differences beside a state at nothing are rounding in a call, and the tape knows the slopes exactly."""

    def drift(a, u, t, th):
        central, outer = a[:, 0], a[:, 1]
        between = th.exchange * (central - outer)
        return [(u[0] - th.clearance * central - between) / 8.0, between / 25.0], np.zeros((2, 0))

    model = engine.continuous(
        name="patient",
        drift=drift,
        diffusion=lambda a, u, t, th: np.diag([1e-4, 1e-4]),
        measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[0.01]]),
        initial=lambda th: (
            engine.Gaussian([0.0, 0.0], np.diag([1e-6, 1e-6])),
            [],
            np.zeros((0, 0)),
        ),
        nonlinear={"central": "mg/L", "outer": "mg/L"},
        inputs={"infusion": "mg/h"},
        outputs={"plasma": "mg/L"},
        parameters=[
            engine.Parameter("clearance", 4.0, "L/h", (0.1, 50.0)),
            engine.Parameter("exchange", 6.0, "L/h", (0.1, 50.0)),
        ],
    )
    infusion = np.repeat([20.0, 0.0, 80.0, 50.0], 25)
    series = engine.Series(np.zeros(100), infusion, dt=0.25, time_unit="h")
    record, x1 = model.record(model.theta()), np.zeros((1, 2))
    for _ in range(4):
        taped = run_by_tape(model, record, series, x1, series.steps)
        assert_same_runs(taped, by_calls(model, record, series, x1, monkeypatch))
