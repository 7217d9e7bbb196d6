"""Filters of a logger: a recursion at the samples or a moving average, which may smooth the noise as well."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import engine
from engine.diagnose import extend
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.symptoms.runs import noise_free
from engine.filters.sigma_point import moment_filter
from tests.engine.hidden_effects import levels

RIVALS = ["slow-sensor", "path", "lag", "delay", "pole", "slow-input", "colored", "play"]
MANNER = "slow_sensor_tacho", "slow_sensor_tacho_digital", "slow_sensor_tacho_noise"


def motor(q=0.1, known=False):
    """A motor with its friction; ``known`` without noise but that of its readings."""
    return engine.continuous(
        name="motor",
        drift=lambda a, u, t, theta: ([theta.g * u[0]], [[-theta.b]]),
        diffusion=lambda a, u, t, theta: np.diag([0.0 if known else theta.q]),
        measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r]]),
        initial=lambda theta: (None, [0.0], [[0.0 if known else 1e-2]]),
        linear={"w": "rad/s"},
        inputs={"v": "V"},
        outputs={"tacho": "rad/s"},
        parameters=[
            engine.Parameter("g", 9.0, "rad/s^2/V", (0.0, 100.0)),
            engine.Parameter("b", 3.0, "1/s", (0.0, 100.0)),
            engine.Parameter("q", q, "rad^2/s^3", (0.0, 10.0)),
            engine.Parameter("r", 0.1, "rad^2/s^2", (1e-8, 10.0)),
        ],
    )


def filtered(x, keep):
    """The recursion of a digital filter, settled at first; ``keep`` a number or one for each row."""
    y, keep = x.copy(), np.broadcast_to(keep, len(x))
    for k in range(1, len(x)):
        y[k] = y[k - 1] + (1.0 - keep[k]) * (x[k] - y[k - 1])
    return y


def slow(series, model=None):
    """The motor with a slow sensor, as a diagnosis of the series extends it."""
    model = motor(known=True) if model is None else model
    return extend(
        model, ["slow-sensor:tacho"], setting_for(model, series, np.asarray(model.theta()))
    )


@pytest.mark.parametrize("uneven", [False, True])
def test_a_digital_filter_is_its_recursion(uneven):
    rng, tau = np.random.default_rng(1), 0.05
    t = np.cumsum(0.02 * (rng.uniform(0.8, 1.2, 100) if uneven else np.ones(100)))
    series = engine.Series(np.zeros(100), 5.0 * levels(rng, 100), t=t)
    plain, _ = noise_free(motor(), np.asarray(motor().theta()), series, np.array([0.4]))
    dt = np.append(0.0, np.diff(t))
    digital = slow(series)
    theta = np.asarray(digital.theta(dict(zip(MANNER, (tau, 1.0, 0.0), strict=True))))
    y, _ = noise_free(digital, theta, series, np.array([-1.0, 0.4, 0.0]))
    np.testing.assert_allclose(y[:, 0], filtered(plain[:, 0], tau / (tau + dt)), rtol=1e-9)


def test_between_the_samples_a_digital_filter_waits():
    rng = np.random.default_rng(2)
    series = engine.Series(np.zeros(80), 5.0 * levels(rng, 80), dt=0.02)
    rows = 5.0 * rng.standard_normal(80)
    seen, values = [], []
    for steps in (1, 3):
        finer = replace(series, y=rows[:, None]).refined(steps)
        digital = slow(finer)
        for smooths in (0.0, 1.0):
            own = dict(zip(MANNER, (0.05, 1.0, smooths), strict=True))
            theta = np.asarray(digital.theta(own))
            seen.append(noise_free(digital, theta, finer, np.array([-1.0, 0.4, 0.0]))[0][::steps])
            values.append(moment_filter(digital, theta[None], finer).log_likelihood[0])
    np.testing.assert_allclose(seen[2:], seen[:2], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(values[2:], values[:2], rtol=1e-9)


@pytest.mark.parametrize("digital", [0.0, 1.0])
def test_noise_that_is_smoothed_is_of_the_first_order(digital):
    """Where the motor is known, what is left of the readings is noise of one correlation alone."""
    rng, tau, dt, n, r = np.random.default_rng(3), 0.05, 0.02, 60, 0.2
    series = engine.Series(np.zeros(n), 5.0 * levels(rng, n), dt=dt)
    model, noise = slow(series), np.sqrt(r) * rng.standard_normal(n)
    keep = tau / (tau + dt) if digital else np.exp(-dt / tau)
    for smooths in (0.0, 1.0):
        own = dict(zip(MANNER, (tau, digital, smooths), strict=True)) | {"r": r}
        theta = np.asarray(model.theta(own))
        clean, _ = noise_free(model, theta, series, np.array([-1.0, 0.0, 0.0]))
        apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
        covariance = r * (keep**apart if smooths else np.eye(n))
        if smooths:  # what the first reading had is not remembered
            covariance[0, 1:] = covariance[1:, 0] = 0.0
        read = replace(series, y=clean + noise[:, None])
        by_hand = multivariate_normal(np.zeros(n), covariance).logpdf(noise)
        value = moment_filter(model, theta[None], read).log_likelihood[0]
        assert value == pytest.approx(by_hand, abs=1e-3)


def turning(seed, n=500, dt=0.02, fine=10):
    """Speeds of a motor, integrated here, and its voltage."""
    rng = np.random.default_rng(seed)
    v, w, speeds = 5.0 * levels(rng, n), 0.0, np.empty(n)
    for k in range(n):
        speeds[k] = w
        for _ in range(fine):
            w += dt / fine * (10.0 * v[k] - 3.0 * w) + 0.2 * np.sqrt(dt / fine) * rng.normal()
    return v, speeds, 0.3 * rng.standard_normal(n)


@pytest.mark.slow
@pytest.mark.parametrize("smooths", [False, True])
def test_a_digital_filter_in_the_logger_is_named(smooths):
    """Beside a sensor that follows as in one's books a path from the voltage to the reading fitted better."""
    v, speeds, noise = turning(11)
    keep, dt = 0.7, 0.02
    y = filtered(speeds + noise, keep) if smooths else filtered(speeds, keep) + noise
    found = engine.diagnose(motor(), engine.Series(y, v, dt=dt), effects=RIVALS, seed=1)
    assert [cause.effect for cause in found.causes] == ["slow-sensor:tacho"]
    (cause,) = found.causes
    assert abs(cause.size - dt * keep / (1.0 - keep)) < 4.0 * cause.standard_error
    theta = found.theta.asdict()
    assert (theta[MANNER[1]], theta[MANNER[2]]) == (1.0, float(smooths))


EVENLY = "delay_tacho", "delay_tacho_samples", "delay_tacho_evenly", "delay_tacho_noise"


def averaged(x, m):
    """The mean of the last m, settled at first."""
    return np.convolve(np.concatenate([np.full(m - 1, x[0]), x]), np.full(m, 1.0 / m), "valid")


def test_parts_that_come_evenly_late_are_a_moving_average_of_readings_and_their_noise():
    rng, m, n, r = np.random.default_rng(4), 4, 60, 0.2
    series = engine.Series(np.zeros(n), 5.0 * levels(rng, n), dt=0.02)
    base = motor(known=True)
    late = extend(base, ["delay:tacho"], setting_for(base, series, np.asarray(base.theta())))
    plain, _ = noise_free(base, np.asarray(base.theta()), series, np.array([0.0]))
    mixing = np.apply_along_axis(averaged, 0, np.eye(n), m)
    for noise in (0.0, 1.0):
        own = dict(zip(EVENLY, ((m - 1) / 2, m - 1.0, 1.0, noise), strict=True)) | {"r": r}
        theta = np.asarray(late.theta(own))
        y, _ = noise_free(late, theta, series, np.zeros(late.nx))
        np.testing.assert_allclose(y[:, 0], averaged(plain[:, 0], m), atol=1e-9)
        shared = r * (m * mixing @ mixing.T if noise else np.eye(n))
        e = np.random.default_rng(5).multivariate_normal(np.zeros(n), shared)
        value = moment_filter(late, theta[None], replace(series, y=y + e[:, None]))
        exact = multivariate_normal(np.zeros(n), shared).logpdf(e)
        assert value.log_likelihood[0] == pytest.approx(exact, abs=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize(("m", "noise_too"), [(4, True), (4, False), (6, True)])
def test_a_moving_average_of_the_logger_is_named(m, noise_too):
    v, speeds, noise = turning(12)
    y = averaged(speeds + noise, m) if noise_too else averaged(speeds, m) + noise
    found = engine.diagnose(motor(), engine.Series(y, v, dt=0.02), effects=RIVALS, seed=1)
    assert [cause.effect for cause in found.causes] == ["delay:tacho"]
    theta = found.theta.asdict()
    assert (theta[EVENLY[1]], theta[EVENLY[2]], theta[EVENLY[3]]) == (m - 1.0, 1.0, noise_too)
    (cause,) = found.causes
    assert abs(cause.size - (m - 1) / 2) < 4.0 * cause.standard_error
