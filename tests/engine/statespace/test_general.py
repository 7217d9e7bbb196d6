"""General models: filter, smoother, Q-function and PS-EM against the mixed and the exact ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student

import engine
from engine.errors import ModelError, OptionError, SeriesError
from engine.estimation.expectation import expectation
from engine.estimation.general_em import TrajectoryQ
from engine.estimation.ps_em import ps_em
from engine.filters.kalman import kalman_smoother
from engine.filters.particle import particle_filter
from engine.smoothers.ffbsi import ParticleSmoothed
from engine.smoothers.general import filter_general, smooth_general
from engine.statespace.densities import GaussianMixture, StudentT
from engine.statespace.general import as_general
from engine.statespace.points import Points
from tests.studies import growth, scalar_linear


@pytest.fixture(scope="module")
def linear_series() -> engine.Series:
    return engine.simulate(scalar_linear.MODEL, None, 100, np.random.default_rng(1)).series


def test_densities_agree_with_scipy() -> None:
    e = np.random.default_rng(0).standard_normal((7, 2))
    got = StudentT([0.5, 2.0], 3.0).log_density(e)
    want = student.logpdf(e / [0.5, 2.0], 3.0).sum(axis=1) - np.log(0.5 * 2.0)
    np.testing.assert_allclose(got, want, rtol=1e-12)
    for nu in (1e7, 1e9, 1e16):
        gaussian = StudentT([0.5, 2.0], nu).log_density(e)
        np.testing.assert_allclose(gaussian, norm.logpdf(e, 0.0, [0.5, 2.0]).sum(axis=1), atol=1e-5)
    mixture = GaussianMixture([0.9, 0.1], [0.0, 1.0], [1.0, 3.0], n=2)
    want = np.log(0.9 * norm.pdf(e) + 0.1 * norm.pdf(e, 1.0, 3.0)).sum(axis=1)
    np.testing.assert_allclose(mixture.log_density(e), want, rtol=1e-12)
    draws = mixture.sample(np.random.default_rng(1), 50_000)
    assert abs(draws.mean() - 0.1) < 0.02
    assert abs(draws.var() - (0.9 + 0.1 * 10.0 - 0.01)) < 0.05
    draws = StudentT([2.0], 5.0).sample(np.random.default_rng(1), 50_000)
    assert abs(draws.var() / (4.0 * 5.0 / 3.0) - 1.0) < 0.06


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: StudentT([0.5, -2.0], 3.0),
            r"scale = \[0.5, -2.0\]; every one must be finite and",
        ),
        (lambda: StudentT(0.0, 3.0), r"scale = \[0.0\]"),
        (lambda: StudentT([[1.0, 2.0]], 3.0), r"a list of scales; it has the shape \(1, 2\)"),
        (lambda: StudentT(1.0, -1.0), r"nu = \[-1.0\]"),
        (lambda: StudentT(1.0, np.inf), r"nu = \[inf\]"),
        (lambda: GaussianMixture([0.5, 0.5], [0.0], [1.0, 1.0]), "lists of the same length"),
        (
            lambda: GaussianMixture([1.5, -0.5], [0.0, 0.0], [1.0, 1.0]),
            "must be finite and not negative",
        ),
        (lambda: GaussianMixture([0.0, 0.0], [0.0, 0.0], [1.0, 1.0]), "sum of the shares"),
        (
            lambda: GaussianMixture([0.5, 0.5], [0.0, np.nan], [1.0, 1.0]),
            "means = .*must be finite",
        ),
        (lambda: GaussianMixture([0.5, 0.5], [0.0, 0.0], [1.0, 0.0]), r"sds = \[1.0, 0.0\]"),
    ],
)
def test_densities_refuse_numbers_that_they_cannot_have(make, message) -> None:
    with pytest.raises(engine.ModelError, match=message):
        make()
    GaussianMixture([1.0, 0.0], [0.0, 5.0], [1.0, 1.0])  # a share of 0 is one


def test_filter_and_smoother_agree_with_kalman(linear_series: engine.Series) -> None:
    exact = kalman_smoother(scalar_linear.MODEL, None, linear_series)
    likelihood, mean, second, cross = [], 0.0, 0.0, 0.0
    for k in range(10):
        rng = np.random.default_rng(k)
        filtered = filter_general(scalar_linear.GENERAL, None, linear_series, 600, rng)
        likelihood.append(filtered.log_likelihood)
        x = smooth_general(filtered, 100, rng)[:, :, 0] - exact.x
        mean = mean + x.mean(axis=1) / 10
        second = second + (x**2).mean(axis=1) / 10
        cross = cross + (x[:-1] * x[1:]).mean(axis=1) / 10
    assert abs(np.mean(likelihood) - exact.log_likelihood) < 0.5
    width = np.sqrt(exact.P[:, 0, 0])
    assert np.abs(mean / width).max() < 0.2
    assert np.abs(second / width**2 - 1.0).max() < 0.2
    assert abs((second / width**2 - 1.0).mean()) < 0.03
    assert abs((cross / exact.M[:, 0, 0]).mean() - 1.0) < 0.06


@pytest.mark.parametrize("name", ["linear-2", "growth"])
def test_q_function_is_that_of_the_mixed_model(name: str) -> None:
    """Same trajectories, two ways to write Q(theta, theta_k): Gaussian terms, and log densities."""
    model = growth.MODEL if name == "growth" else engine.get_model(name)
    rng = np.random.default_rng(3)
    series = engine.simulate(model, None, 40, rng).series
    x = 0.3 * rng.standard_normal((40, 6, model.nx)) + 1.0
    moments = ParticleSmoothed(
        particle_filter(model, None, series, 10, rng), x, np.zeros(0)
    ).moments
    theta = model.theta()
    mixed = expectation(model, theta, [(moments, Points(model, series, moments.a))])
    general = as_general(model)
    free = np.arange(len(model.parameters))

    def one_time_only(x, u, t, dt, theta):
        return general.dynamics(x, u, float(t), dt, theta)

    for one in (general, replace(general, dynamics=one_time_only)):
        q = TrajectoryQ(one, [(series, x)])
        for shift in (0.0, 0.01):
            at = np.asarray(theta) * (1.0 + shift)
            assert q.value(at) == pytest.approx(mixed.value(at), rel=1e-9)
        value, gradient, H = q.derivatives(np.asarray(theta), free)
        want_value, want, _ = mixed.derivatives(np.asarray(theta), free)
        assert value == pytest.approx(want_value, rel=1e-9)
        np.testing.assert_allclose(gradient, want, rtol=2e-4, atol=1e-5 * np.abs(want).max())
        assert np.linalg.eigvalsh(H).min() >= -1e-9 * np.abs(H).max()


def test_state_dependent_scales_enter_the_density() -> None:
    """g(x) and s(x): the density of a draw is that of the noise over the scale."""

    def dynamics(x: np.ndarray, u: object, t: object, dt: object, theta: object) -> tuple:
        g = np.zeros((len(x), 2, 2))
        g[:, 0, 0] = 1.0 + x[:, 0] ** 2
        g[:, 1, 0] = 0.5
        g[:, 1, 1] = 2.0
        return x, g

    def measurement(x: np.ndarray, u: object, t: object, theta: object) -> tuple:
        return [x[:, 0]], (1.0 + x[:, 1] ** 2)[:, None, None]

    model = replace(
        as_general(engine.get_model("linear-2")),
        dynamics=dynamics,
        measurement=measurement,
        process_noise=lambda theta: StudentT([1.0, 1.0], 4.0),
        measurement_noise=lambda theta: StudentT([1.0], 4.0),
    )
    record = model.record(model.theta())
    x = np.array([[1.0, -0.5], [0.2, 2.0]])
    x_next = np.array([[1.5, 0.0], [0.0, 1.0]])
    f, g = model.transition(x, None, 0.0, 1.0, record)
    got = model.log_transition(x_next, f, g, record)
    v1 = (x_next[:, 0] - x[:, 0]) / (1.0 + x[:, 0] ** 2)
    v2 = (x_next[:, 1] - x[:, 1] - 0.5 * v1) / 2.0
    want = student.logpdf(v1, 4) + student.logpdf(v2, 4) - np.log(2.0 * (1.0 + x[:, 0] ** 2))
    np.testing.assert_allclose(got, want, rtol=1e-12)
    pairs = model.log_transition(x_next[:, None], f, g, record)  # every next state, every particle
    np.testing.assert_allclose(np.diagonal(pairs), want, rtol=1e-12)
    scale = 1.0 + x[:, 1] ** 2
    got = model.log_measurement(np.array([0.3]), x, None, 0.0, record)
    np.testing.assert_allclose(got, student.logpdf((0.3 - x[:, 0]) / scale, 4) - np.log(scale))


@pytest.mark.slow
def test_ps_em_finds_the_exact_estimate(linear_series: engine.Series) -> None:
    exact = engine.rts_em(scalar_linear.MODEL, linear_series, {"a": 0.5}, ["a"], 50)
    found = ps_em(
        scalar_linear.GENERAL,
        linear_series,
        {"a": 0.5},
        ["a"],
        n_particles=200,
        n_trajectories=40,
        n_iterations=25,
        tolerance=None,
    )
    assert abs(found.trace[-10:, 0].mean() - exact.theta["a"]) < 0.01
    again = ps_em(
        scalar_linear.GENERAL,
        linear_series,
        free=["a"],
        n_particles=200,
        n_trajectories=40,
        n_iterations=25,
        tolerance=None,
        resume=engine.Checkpoint(
            found.trace[:11],
            found.log_likelihood[:10],
            found.ess[:10],
            found.seconds[:10],
            found.collapsed[:10],
        ),
    )
    np.testing.assert_array_equal(again.trace, found.trace)


def test_one_em_step_is_the_mixed_models() -> None:
    """The general and the mixed PS-EM step agree within their Monte Carlo error."""
    series = engine.simulate(growth.MODEL, None, 60, np.random.default_rng(7)).series
    start, free = {"b": 22.0, "c": 7.5, "q": 1.0, "r": 0.5}, ["a", "b", "c", "d"]
    steps = {"general": [], "mixed": []}
    for k in range(10):
        for name, model in (("general", growth.GENERAL), ("mixed", growth.MODEL)):
            run = ps_em(model, series, start, free, 300, 50, 1, seed=k + 100 * (name == "mixed"))
            steps[name].append(np.asarray(run.theta)[:4])
    one, other = (np.array(steps[name]) for name in ("general", "mixed"))
    error = np.sqrt((one.var(axis=0) + other.var(axis=0)) / 10)
    assert (np.abs(one.mean(axis=0) - other.mean(axis=0)) < 4.0 * error).all()
    assert (error < 0.02 * np.abs(one.mean(axis=0))).all()


@pytest.mark.slow
def test_heavy_tails_are_estimated() -> None:
    """Student-t measurement noise: nu and r move towards the truth, and the likelihood gains."""
    general, rng = growth.HEAVY, np.random.default_rng(11)
    record, T = general.record(general.theta({"nu": 2.0})), 150
    x = general.initial(record).sample(rng, 1)
    y = np.empty((T, 1))
    for t in range(T):
        y[t] = 0.05 * x[0, 0] ** 2 + general.measurement_noise(record).sample(rng, 1)[0]
        x = general.draw_next(x, None, float(t), 1.0, record, rng)
    series = engine.Series(y)
    run = ps_em(general, series, {"nu": 20.0, "r": 0.3}, ["nu", "r"], 100, 25, 20, tolerance=None)
    assert run.theta["nu"] < 6.0
    assert run.theta["r"] < 0.25
    assert run.log_likelihood[-5:].mean() > run.log_likelihood[0] + 10.0


def test_what_cannot_be_used_is_named() -> None:
    model = engine.get_model("mixed-4")
    series = engine.simulate(model, None, 10, np.random.default_rng(0)).series
    y = series.y.copy()
    y[4, 1] = np.nan
    with pytest.raises(SeriesError, match="row 4"):
        filter_general(as_general(model), None, engine.Series(y), 10, np.random.default_rng(0))
    singular = replace(
        growth.GENERAL, dynamics=lambda x, u, t, dt, theta: ([0.5 * x[:, 0]], [[0.0]])
    )
    rng = np.random.default_rng(0)
    filtered = filter_general(singular, None, engine.Series(np.zeros((5, 1))), 10, rng)
    with pytest.raises(ModelError, match="singular"):
        smooth_general(filtered, 5, rng)


@pytest.mark.parametrize("n_trajectories", [0, -1, 2.5])
def test_draws_are_counted_by_positive_whole_numbers(n_trajectories: float) -> None:
    rng = np.random.default_rng(0)
    series = engine.simulate(scalar_linear.MODEL, None, 20, rng).series
    filtered = filter_general(scalar_linear.GENERAL, None, series, 10, rng)
    with pytest.raises(OptionError, match="a positive whole number is needed"):
        smooth_general(filtered, n_trajectories, rng)


def test_a_mixture_knows_its_moments():
    density = GaussianMixture([0.5, 0.5], [0.0, 2.0], [0.1, 0.3], n=2)
    draws = density.sample(np.random.default_rng(0), 200_000)
    np.testing.assert_allclose(density.mean, draws.mean(axis=0), atol=0.01)
    np.testing.assert_allclose(density.cov, np.cov(draws.T), atol=0.02)
    assert density.mean.tolist() == [1.0, 1.0]
