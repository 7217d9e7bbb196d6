"""Parameters of what has no noise, where the moment filter does not see the outliers."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.optimize import minimize

import engine
from engine.estimation.likelihood_step import LikelihoodStep
from engine.estimation.particle_likelihood import (
    ParticleLikelihood,
    in_noise_only,
    likelihood_of,
)
from engine.filters.heavy_tails import with_mixture, with_student_t

P = engine.Parameter
RATES = {"gain": 2.0, "rate": 0.12}


def decay(nonlinear: bool) -> engine.MixedModel:
    """x' = -rate x + gain u, without process noise."""

    def dynamics(a, u, t, dt, theta):
        keep, push = np.exp(-theta.rate * dt), theta.gain * u[0] * dt
        if nonlinear:
            return [keep * a[:, 0] + push], np.zeros((1, 0)), [[0.0]]
        return [push], [[keep]], [[0.0]]

    def measurement(a, u, t, theta):
        if nonlinear:
            return [a[:, 0]], np.zeros((1, 0)), [[theta.r]]
        return [0.0], [[1.0]], [[theta.r]]

    def initial(theta):
        if nonlinear:
            return engine.Gaussian([0.0], [[0.0]]), [], np.zeros((0, 0))
        return engine.Gaussian([], np.zeros((0, 0))), [0.0], [[0.0]]

    state = {"x": "mg"}
    return engine.MixedModel(
        name="decay",
        nonlinear=state if nonlinear else {},
        linear={} if nonlinear else state,
        inputs={"dose": "mg/h"},
        outputs={"y": "mg"},
        parameters=[
            P("gain", 1.5, "1", (0.1, 10.0)),
            P("rate", 0.2, "1/h", (0.01, 2.0)),
            P("r", 0.3, "mg^2", (1e-4, 100.0)),
        ],
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
    )


def run_of(gain: float, rate: float, u: np.ndarray) -> np.ndarray:
    x = np.zeros(len(u))
    for t in range(1, len(u)):
        x[t] = np.exp(-rate) * x[t - 1] + gain * u[t - 1]
    return x


def record(seed: int) -> engine.Series:
    rng = np.random.default_rng(seed)
    u = np.repeat([4.0, 0.0, 2.0, 0.0, 6.0, 0.0], 10)
    y = run_of(**RATES, u=u) + 0.3 * rng.standard_normal(60)
    y[rng.choice(60, 7, replace=False)] += rng.choice([-4.0, 4.0], 7)
    return engine.Series(y[:, None], u[:, None], dt=1.0, time_unit="h")


def mixture(values: np.ndarray, series: engine.Series) -> float:
    """The exact log-likelihood of gain, rate, r, share, ratio."""
    gain, rate, r, share, ratio = values
    e = series.y[:, 0] - run_of(gain, rate, series.u[:, 0])

    def normal(v: float) -> np.ndarray:
        return np.exp(-0.5 * e**2 / v) / np.sqrt(2.0 * np.pi * v)

    return float(np.log((1.0 - share) * normal(r) + share * normal(r * ratio**2)).sum())


def most_likely(series: engine.Series) -> float:
    def loss(x: np.ndarray) -> float:
        gain, rate, r, share, ratio = x
        values = np.exp([gain, rate, r, 0.0, ratio])
        values[3] = 0.5 / (1.0 + np.exp(-share))
        return -mixture(values, series)

    start = [np.log(2.0), np.log(0.12), np.log(0.1), -1.0, np.log(10.0)]
    found = minimize(loss, start, method="Nelder-Mead", options={"maxiter": 4000, "maxfev": 4000})
    return -float(found.fun)


@pytest.mark.slow
@pytest.mark.parametrize("nonlinear", [False, True])
def test_outliers_are_no_weight_on_parameters_of_what_has_no_noise(nonlinear):
    """The maximum is that of the exact mixture, not that of one Gaussian noise for all readings."""
    series, model = record(2), with_mixture(decay(nonlinear), share_default=0.1)
    found = engine.rbps_em(model, series, seed=0)
    assert mixture(np.asarray(found.theta), series) > most_likely(series) - 0.3
    plain = engine.fit_simulation(decay(nonlinear), series).theta
    wrong = [*np.asarray(plain)[:2], *np.asarray(found.theta)[2:]]
    assert mixture(wrong, series) < most_likely(series) - 2.0
    assert "the particle filter's likelihood" in found.message


@pytest.mark.slow
def test_standard_errors_are_those_of_the_mixture():
    series, model = record(2), with_mixture(decay(False), share_default=0.1)
    found = engine.rbps_em(model, series, seed=0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", engine.NotSettledWarning)
        errors = engine.standard_errors(model, found, series)
    x, n, steps = np.asarray(found.theta), 5, 0.2 * errors.values
    H = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            ends = []
            for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                moved = x.copy()
                moved[i] += a * steps[i]
                moved[j] += b * steps[j]
                ends.append(a * b * mixture(moved, series))
            H[i, j] = -sum(ends) / (4.0 * steps[i] * steps[j])
    exact = np.sqrt(np.diag(np.linalg.inv(H)))
    assert np.allclose(errors.values[:2], exact[:2], rtol=0.25)
    assert np.allclose(errors.values, exact, rtol=0.6)


@pytest.mark.parametrize("nonlinear", [False, True])
def test_states_that_enter_noise_alone_are_known(nonlinear):
    series = record(3)
    for extend in (with_mixture, with_student_t):
        model = extend(decay(nonlinear))
        rare = {"outlier_share": 1e-6} if extend is with_mixture else {}
        for values in (
            {},
            rare,
        ):  # next to no outliers are no reason not to see that there may be some
            seen = in_noise_only(model, model.theta(values), series)
            assert seen.tolist() == [False, True][not nonlinear :]
        likelihood = likelihood_of(model, [series], model.theta(), 20, model.free_indices(None))
        assert isinstance(likelihood, ParticleLikelihood)
    model = decay(nonlinear)
    likelihood = likelihood_of(model, [series], model.theta(), 20, model.free_indices(None))
    assert type(likelihood) is LikelihoodStep


@pytest.mark.long
def test_slopes_are_those_of_the_exact_likelihood():
    series, model = record(4), with_mixture(decay(False))
    theta = model.theta({"gain": 2.1, "rate": 0.13, "r": 0.1, "outlier_share": 0.1})
    likelihood = ParticleLikelihood(model, [series], n_particles=50)
    gradient, information = likelihood.score(theta, np.arange(5))
    x = np.asarray(theta)
    steps = likelihood._steps(x, np.arange(5))
    for k in range(5):
        ends = [x + sign * steps[k] * np.eye(5)[k] for sign in (-1.0, 1.0)]
        low, high = (mixture(end, series) for end in ends)
        error = 0.3 * np.sqrt(information[k, k])
        assert gradient[k] == pytest.approx((high - low) / (2.0 * steps[k]), abs=error)


def test_a_model_that_raises_where_it_is_never_is_no_reason_to_stop(recwarn):
    """A level that is asserted to be positive, far from zero, and the square root of one."""

    def dynamics(a, u, t, dt, theta):
        assert (a > 0.0).all(), "a tank has no negative level"
        return [a[:, 0] + dt * (u[0] - theta.out * np.sqrt(a[:, 0]))], np.zeros((1, 0)), [[1e-4]]

    model = engine.MixedModel(
        name="tank",
        nonlinear={"level": "m"},
        linear={},
        inputs={"pump": "m/s"},
        outputs={"y": "m"},
        parameters=[P("out", 0.3, "m^0.5/s", (0.01, 3.0))],
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[0.01]]),
        initial=lambda theta: (engine.Gaussian([4.0], [[0.25]]), [], np.zeros((0, 0))),
    )
    u = np.repeat([0.8, 0.5, 0.9], 20)[:, None]
    series = engine.Series(4.0 + 0.1 * np.random.default_rng(0).standard_normal(60), u, dt=0.1)
    assert not in_noise_only(model, model.theta(), series).any()
    found = engine.rbps_em(model, series, n_particles=20, n_iterations=3, seed=0)
    assert np.isfinite(found.theta["out"])
    assert not [w for w in recwarn if issubclass(w.category, RuntimeWarning)]


@pytest.mark.parametrize("rows", [2, 3, 40])
def test_the_last_row_may_have_the_largest_input(rows):
    """It begins no step."""
    model = engine.get_model("servo")
    u = np.zeros((rows, 1))
    u[-1] = 3.0
    series = engine.Series(np.linspace(0.0, 0.1, rows), u, dt=0.1)
    assert not in_noise_only(model, model.theta(), series).any()
