"""Draws from models: moments against theory, singular noise, errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.errors import ModelError, OptionError, SeriesError
from engine.models.linear_2 import MODEL as LINEAR
from engine.models.local_level import MODEL as LEVEL
from engine.models.mixed_4 import MODEL as MIXED
from engine.models.servo import MODEL as SERVO
from engine.models.tanks import MODEL as TANKS
from engine.simulation.simulate import simulate
from engine.statespace.model import Gaussian, MixedModel, Parameter


def scalar(k):
    """x' = k x + u + w on a nonlinear and a linear state that share one source of noise."""

    def dynamics(a, u, t, dt, theta):
        return [theta.k * a[:, 0] + u[0], u[0]], [[0.0], [theta.k]], np.full((2, 2), 0.09)

    return MixedModel(
        name="scalar",
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([a[:, 0]], [[1.0]], [[0.01]]),
        initial=lambda theta: (Gaussian([0.0], [[0.0]]), [0.0], [[0.0]]),
        nonlinear={"a": "1"},
        linear={"z": "1"},
        inputs={"u": "1"},
        outputs={"y": "1"},
        parameters=[Parameter("k", k)],
    )


@pytest.mark.long
def test_stationary_moments_and_singular_noise():
    n = 20_000
    drawn = simulate(scalar(0.8), None, n, np.random.default_rng(0), u=np.zeros(n))
    np.testing.assert_allclose(drawn.a, drawn.z, atol=1e-12)  # Q has rank one, x_1 = 0
    a = drawn.a[100:, 0]
    variance = 0.09 / (1 - 0.8**2)
    # Standard error of the variance: sqrt(2 (1 + k^2) / (1 - k^2) / n) = 2.1 %; three of them.
    assert a.var() == pytest.approx(variance, rel=0.065)
    assert np.corrcoef(a[1:], a[:-1])[0, 1] == pytest.approx(0.8, abs=0.015)
    e = drawn.y[:, 0] - drawn.a[:, 0] - drawn.z[:, 0]
    assert e.var() == pytest.approx(0.01, rel=0.03)


def test_inputs_arrive_with_their_step():
    quiet = replace(scalar(0.5), dynamics=lambda a, u, t, dt, th: (
        [th.k * a[:, 0] + u[0], u[0]], [[0.0], [th.k]], np.zeros((2, 2))))  # fmt: skip
    drawn = simulate(quiet, None, 5, np.random.default_rng(0), u=[1.0, 0.0, 0.0, 4.0, 9.0])
    np.testing.assert_allclose(drawn.a[:, 0], [0, 1, 0.5, 0.25, 4.125])


@pytest.mark.slow
def test_first_state_has_the_initial_density():
    rng = np.random.default_rng(1)
    drawn = [simulate(LINEAR, None, 2, rng) for _ in range(2000)]
    a1 = np.array([one.a[0, 0] for one in drawn])
    z1 = np.array([one.z[0, 0] for one in drawn])
    assert a1.mean() == pytest.approx(0.0, abs=0.07)
    assert a1.var() == pytest.approx(1.0, abs=0.1)
    assert z1.mean() == pytest.approx(1.0, abs=0.07)
    assert z1.var() == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("model", [LINEAR, MIXED, LEVEL, SERVO, TANKS])
def test_shipped_models_give_a_series_that_fits_them(model):
    u = np.full((30, model.nu), 1.0)
    drawn = simulate(model, None, 30, np.random.default_rng(2), u=u, dt=0.02)
    assert drawn.y.shape == (30, model.ny)
    assert drawn.a.shape == (30, model.na)
    assert drawn.z.shape == (30, model.nz)
    assert drawn.series.check(model).dt == pytest.approx(0.02)
    assert drawn.series.y_names == tuple(model.outputs)
    assert drawn.series.u_names == tuple(model.inputs)
    again = simulate(model, None, 30, np.random.default_rng(2), u=u, dt=0.02)
    np.testing.assert_array_equal(again.y, drawn.y)


@pytest.mark.long
def test_irregular_times_reach_the_model():
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.5, 8.0, 4000))
    theta = {"sigma_v": 1e-9, "sigma_load": 0.5}
    drawn = simulate(SERVO, theta, 4000, rng, u=np.zeros(4000), t=t)
    step, dt = np.diff(drawn.z[:, 1]), np.diff(t)
    assert (step**2 / dt).mean() == pytest.approx(0.25, rel=0.1)
    assert np.corrcoef(step**2, dt)[0, 1] > 0.2


def test_errors():
    rng = np.random.default_rng(0)
    with pytest.raises(OptionError, match="n_samples = 1; at least 2"):
        simulate(LINEAR, None, 1, rng)
    with pytest.raises(OptionError, match=r"model 'tanks' has inputs \(pump\); pass u \(10, 1\)"):
        simulate(TANKS, None, 10, rng)
    with pytest.raises(SeriesError, match="u has 9 rows and y has 10"):
        simulate(TANKS, None, 10, rng, u=np.zeros(9))
    with pytest.raises(SeriesError, match="u has 2 channels; model 'tanks' needs 1"):
        simulate(TANKS, None, 10, rng, u=np.zeros((10, 2)))
    with pytest.raises(SeriesError, match=r"dt = 0.0; a positive time step"):
        simulate(LINEAR, None, 10, rng, dt=0.0)
    with pytest.raises(OptionError, match="parameter 'k1' = 7 is not within"):
        simulate(TANKS, {"k1": 7.0}, 10, rng, u=np.zeros(10))


def test_a_state_that_runs_away_is_named_with_its_time():
    def dynamics(a, u, t, dt, theta):
        return [a[:, 0] + dt * a[:, 0] ** 3 + 1.0, 0.0], [[0.0], [1.0]], np.zeros((2, 2))

    model = replace(scalar(0.5), dynamics=dynamics)
    message = r"model 'scalar': the simulation runs away; at t = 4\.\d \(row \d+\) it is not fi"
    with pytest.raises(ModelError, match=message):
        simulate(model, None, 100, np.random.default_rng(0), u=np.zeros(100), dt=0.5)
