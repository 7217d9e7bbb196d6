"""Free-run simulation, its first state and its bands."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from engine.data.series import Series
from engine.errors import ModelError, OptionError, SeriesError
from engine.models.linear_2 import MODEL as LINEAR
from engine.models.mixed_4 import MODEL as MIXED
from engine.models.servo import MODEL as SERVO
from engine.models.tanks import MODEL as TANKS
from engine.simulation.free_run import Bands, free_run, root_mean_square, run_rows
from engine.simulation.simulate import simulate
from engine.statespace.model import MixedModel, Parameter


def steps(n, rng, hold=20):
    return np.repeat(rng.uniform(0.5, 5.0, n // hold + 1), hold)[:n]


def tanks(n, seed, **theta):
    rng = np.random.default_rng(seed)
    return simulate(TANKS, theta, n, rng, u=steps(n, rng), dt=4.0)


def test_without_noise_the_run_is_the_simulation():
    n = 100
    u = steps(n, np.random.default_rng(0))
    series = Series(np.zeros(n), u, dt=4.0)
    run = free_run(TANKS, None, series, a1=[3.0, 4.0])
    p, a = TANKS.record(TANKS.theta()), np.array([[3.0, 4.0]])
    for t in range(n):
        np.testing.assert_allclose(run.a[t], a[0], rtol=1e-12)
        a = TANKS.transition(a, u[t : t + 1], 0.0, 4.0, p)[0][:, :2]
    np.testing.assert_array_equal(run.y[:, 0], run.a[:, 1])
    np.testing.assert_array_equal(run.z, 0.0)
    assert run.lower is None


def test_first_state_is_the_initial_mean_or_given():
    series = Series(np.zeros((5, 1)))
    run = free_run(LINEAR, {"theta": 0.5}, series)
    np.testing.assert_allclose(run.y[:, 0], [0, 0.5, 1, 1.5, 2])  # a_1 = 0, z_1 = 1
    run = free_run(LINEAR, {"theta": 0.5}, series, a1=[1.0], z1=[-2.0])
    np.testing.assert_allclose(run.y[:, 0], [1, 0, -1, -2, -3])


def test_an_output_that_was_not_read_has_no_say_in_the_unit():
    """A second sensor in another unit, without a reading, made the error NaN."""
    model = SimpleNamespace(outputs={"height": "m", "load": "N"})
    read = np.array([[3.0, np.nan], [-3.0, np.nan]])
    assert root_mean_square(model, read) == 3.0
    assert np.isnan(root_mean_square(model, np.abs(np.nan_to_num(read))))
    assert np.isnan(root_mean_square(model, np.nan * read))


def test_residuals_and_rmse_leave_missing_values_out():
    y = np.array([[1.0], [np.nan], [3.0], [2.0]])
    run = free_run(LINEAR, {"theta": 0.0}, Series(y))
    np.testing.assert_array_equal(run.residuals, y)
    assert run.rmse == pytest.approx(np.sqrt(14 / 3))
    assert run.rmse_from(3) == pytest.approx(2.0)
    assert run.rmse_by_output == {"y": pytest.approx(np.sqrt(14 / 3))}


def test_first_state_from_the_first_samples():
    drawn = tanks(200, 1, sigma_level=1e-4, sigma_inflow=0.0, sigma_y=0.01)
    theta = {"sigma_y": 0.01}
    run = free_run(TANKS, theta, drawn.series, initial_rows=50)
    np.testing.assert_allclose(run.a[0], drawn.a[0], atol=0.1)
    assert run.rmse < 0.02
    gaps = drawn.series.masked(np.arange(0, 200, 3))
    run = free_run(TANKS, theta, gaps, initial_rows=50)
    np.testing.assert_allclose(run.a[0], drawn.a[0], atol=0.1)


def test_irregular_times_reach_the_run():
    t = np.array([0.0, 0.1, 0.5, 0.6, 2.0])
    series = Series(np.zeros(5), np.full(5, 2.0), t=t)
    theta = {"Fv": 0.0, "Fc": 0.0, "offset": 0.0, "gtau": 95.0}
    run = free_run(SERVO, theta, series)
    np.testing.assert_allclose(run.a[:, 0], 2.0 * t, atol=1e-9)
    np.testing.assert_allclose(run.y[:, 0], t**2, atol=1e-9)


def test_bands_cover_what_they_promise():
    inside, total = 0, 0
    for seed in range(20):
        drawn = tanks(100, seed, sigma_y=0.05)
        x1 = np.concatenate((drawn.a[0], drawn.z[0]))
        run = free_run(
            TANKS,
            {"sigma_y": 0.05},
            drawn.series,
            a1=x1[:2],
            bands=Bands(draws=300, level=0.9, rng=np.random.default_rng(seed)),
        )
        inside += int(((drawn.y >= run.lower) & (drawn.y <= run.upper)).sum())
        total += drawn.y.size
    assert inside / total == pytest.approx(0.9, abs=0.04)


def test_bands_of_measurement_noise_alone():
    series = Series(np.zeros(400))
    bands = Bands(draws=2000, level=0.95, process=False)
    run = free_run(LINEAR, {"theta": 0.0}, series, bands=bands)
    np.testing.assert_allclose((run.upper - run.y).mean(), 1.96 * np.sqrt(0.1), rtol=0.05)
    np.testing.assert_allclose((run.y - run.lower).mean(), 1.96 * np.sqrt(0.1), rtol=0.05)


def scalar_only(model):
    """The same model with functions that take a single number per parameter only."""

    def dynamics(a, u, t, dt, theta):
        return model.dynamics(a, u, t, dt, model.record([float(v) for v in theta]))

    return replace(model, dynamics=dynamics)


@pytest.mark.parametrize("model", [LINEAR, scalar_only(LINEAR)])
def test_bands_of_parameters_and_first_state(model):
    # y_t = a_1 + theta t z_1 with z_1 = 1: sd of y_t is sqrt(0.3^2 + (0.01 t)^2).
    series = Series(np.zeros(60))
    bands = Bands(
        draws=2000,
        covariance=[[0.01**2]],
        start=np.diag([0.3**2, 0.0]),
        process=False,
        measurement=False,
    )
    run = free_run(model, {"theta": 0.5}, series, bands=bands)
    sd = (run.upper - run.lower)[:, 0] / (2 * 1.96)
    np.testing.assert_allclose(sd, np.hypot(0.3, 0.01 * np.arange(60)), rtol=0.08)


def test_a_model_that_takes_single_numbers_only_runs_alike():
    rng = np.random.default_rng(0)
    series = Series(np.zeros(50), steps(50, rng), dt=4.0)
    thetas = np.asarray(TANKS.theta()) * rng.uniform(0.8, 1.2, (4, 6))
    x1 = np.tile([6.0, 5.0, 0.0], (4, 1))
    y, x = run_rows(scalar_only(TANKS), thetas, series, x1)
    y_once, x_once = run_rows(TANKS, thetas, series, x1)
    np.testing.assert_allclose(y, y_once, rtol=1e-12)
    np.testing.assert_allclose(x, x_once, rtol=1e-12)


def test_a_model_that_mixes_up_rows_runs_alike():
    def dynamics(a, u, t, dt, theta):
        return TANKS.dynamics(a, u, t, dt, theta._replace(k1=np.mean(theta.k1)))

    rng = np.random.default_rng(0)
    series = Series(np.zeros(50), steps(50, rng), dt=4.0)
    thetas = np.asarray(TANKS.theta()) * rng.uniform(0.8, 1.2, (4, 6))
    x1 = np.tile([6.0, 5.0, 0.0], (4, 1))
    y, _ = run_rows(replace(TANKS, dynamics=dynamics), thetas, series, x1)
    np.testing.assert_allclose(y, run_rows(TANKS, thetas, series, x1)[0], rtol=1e-12)


def test_errors():
    series = Series(np.zeros(5), np.ones(5), dt=4.0)
    with pytest.raises(OptionError, match=r"a1 = \[1\.\]; 2 finite values are needed"):
        free_run(TANKS, None, series, a1=[1.0])
    with pytest.raises(OptionError, match=r"z1 = \[nan\]; 1 finite values are needed"):
        free_run(TANKS, None, series, z1=[np.nan])
    with pytest.raises(SeriesError, match="u has 0 channels; model 'tanks' needs 1"):
        free_run(TANKS, None, Series(np.zeros(5)))
    with pytest.raises(OptionError, match=r"bands: draws = 1, level = 0\.95; at least 2 draws"):
        free_run(TANKS, None, series, bands=Bands(draws=1))
    with pytest.raises(OptionError, match=r"bands: draws = 9, level = 1\.5"):
        free_run(TANKS, None, series, bands=Bands(draws=9, level=1.5))
    late = Series(np.r_[np.full(9, np.nan), 1.0], np.ones(10), dt=4.0)
    with pytest.raises(SeriesError, match="no measurement in the first 5 rows"):
        free_run(TANKS, None, late, initial_rows=5)


def test_a_run_that_is_not_finite_names_its_time():
    unstable = MixedModel(
        name="unstable",
        dynamics=lambda a, u, t, dt, th: ([th.k * a[:, 0] ** 2], np.zeros((1, 0)), [[0.0]]),
        measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[1.0]]),
        initial=lambda th: (LINEAR.initial(th)[0], np.zeros(0), np.zeros((0, 0))),
        nonlinear={"a": "1"},
        outputs={"y": "1"},
        parameters=[Parameter("k", 2.0)],
    )
    # a = 2^(2^n - 1) at row n: 2^1023 at row 10 is the last double, row 11 is not finite.
    with pytest.raises(ModelError, match=r"'unstable': the simulation runs away; at t = 22 "):
        free_run(unstable, None, Series(np.zeros(40), dt=2.0), a1=[1.0])


def test_a_model_without_linear_or_nonlinear_parts_runs():
    run = free_run(MIXED, None, Series(np.zeros((10, 2))), a1=[0.5], z1=[0.0, 1.0, 0.0])
    assert np.isfinite(run.y).all()
