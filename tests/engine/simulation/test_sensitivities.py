"""Derivatives of free runs against central differences of the loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.simulation import whole_record
from engine.simulation.free_run import first_state, run_rows
from engine.simulation.sensitivities import Along
from engine.statespace.promotion import promote
from tests.engine.simulation.free_run_models import pendulum, van_der_pol
from tests.engine.simulation.test_whole_record import in_other_units, record_of


def both(model, series, theta=None, states=None):
    """dy and dx by the recursion, and by differences of the loop."""
    vector = np.asarray(model.theta(theta))
    x1, spread = first_state(model, model.theta(theta))
    x1 = x1 + 0.1 * spread
    states = np.arange(model.nx) if states is None else states
    free = np.arange(len(vector))
    h = 1e-5 * np.where(vector != 0.0, np.abs(vector), 1.0)
    g = np.where(spread > 0.0, 1e-5 * spread, 1e-7)
    thetas = np.tile(vector, (2 * (len(h) + len(states)) + 1, 1))
    x = np.tile(x1, (len(thetas), 1))
    for i in free:
        thetas[1 + 2 * i, i] = min(vector[i] + h[i], model.upper[i])
        thetas[2 + 2 * i, i] = max(vector[i] - h[i], model.lower[i])
    reach = [thetas[1 + 2 * i, i] - thetas[2 + 2 * i, i] for i in free]
    for j, i in enumerate(states):
        x[1 + 2 * (len(h) + j), i] += g[i]
        x[2 + 2 * (len(h) + j), i] -= g[i]
        reach.append(2.0 * g[i])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(whole_record, "SHORTEST", np.inf)
        y_all, x_all = run_rows(model, thetas, series, x)
    found = Along(model, vector, series, x_all[:, 0]).by(free, states, h)
    slopes = [
        np.swapaxes((v[:, 1::2] - v[:, 2::2]) / np.array(reach)[:, None], 1, 2)
        for v in (y_all, x_all)
    ]
    return found, slopes


def assert_close(found, slopes, tolerance=1e-5):
    for one, other in zip(found, slopes, strict=True):
        size = np.abs(other).max(axis=0)
        assert (np.abs(one - other) <= tolerance * size + 1e-9 * size.max(axis=0)).all()


@pytest.mark.parametrize(
    ("name", "dt"), [("oscillator", 0.1), ("mixed-4", 1.0), ("tanks", 4.0), ("structure", 0.05)]
)
def test_registered_models(name, dt):
    model = engine.get_model(name)
    (dy, dx), slopes = both(model, record_of(model, 400, dt))
    n = len(model.parameters) + model.nx
    assert dy.shape == (400, model.ny, n)
    assert dx.shape == (400, model.nx, n)
    assert_close((dy, dx), slopes)


def test_coulomb_friction():
    model = engine.get_model("servo")
    u = 6.0 * np.sin(0.05 * np.arange(800.0))
    assert_close(*both(model, record_of(model, 800, 0.02).replace(u=u)), tolerance=1e-3)


@pytest.mark.parametrize("model", [pendulum(), van_der_pol(1.0)])
def test_models_of_ones_own(model):
    assert_close(*both(model, record_of(model, 300, 0.05)), tolerance=1e-4)


def test_at_a_bound_and_several_steps_a_sample():
    model = engine.get_model("oscillator")
    series = record_of(model, 100).refined(3)
    assert_close(*both(model, series, {"zeta": 0.0}), tolerance=1e-3)  # one-sided


def test_a_parameter_of_the_measurement_only():
    model = pendulum()

    def measurement(a, u, t, theta):
        return [theta.k * a[:, 0]], np.zeros((1, 0)), [[0.01]]

    assert_close(*both(replace(model, measurement=measurement), record_of(model, 300, 0.05)))


def test_a_model_that_takes_one_time_in_a_call():
    model = engine.get_model("tanks")

    def dynamics(a, u, t, dt, theta):
        return model.dynamics(a, u if t < 1e9 else 2.0 * u, t, dt, theta)

    series = record_of(model, 60, 4.0)
    user = replace(model, dynamics=dynamics)
    for form in (user, promote(user, list(model.linear))):
        assert_close(*both(form, series))


@pytest.mark.parametrize("k", [-6, 6])
def test_in_other_units(k):
    model, size = pendulum(), 10.0**k
    series = record_of(model, 600, 0.05)
    there = series.replace(u=series.u / size, t=series.t / size)
    scaled = in_other_units(model, [size, 1 / size], [0.0, 0.0], 1 / size, size, 1 / size)
    states = np.arange(2)
    found = []
    for m, s in ((model, series), (scaled, there)):
        x1, _ = first_state(m, m.theta())
        x = whole_record.whole_record(m, m.record(m.theta()), s, x1)
        found.append(Along(m, np.asarray(m.theta()), s, x).by(states, states, np.full(2, 1e-5)))
    per = np.array([1.0, 1.0, 1 / size, size])
    known, other = found[0][0], found[1][0] / size / per
    assert np.abs(other - known).max() <= 1e-6 * np.abs(known).max()
