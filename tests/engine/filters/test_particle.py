"""Bootstrap PF, FFBSi and PS-EM on the full state, against the exact linear answers."""

from __future__ import annotations

import numpy as np
import pytest

import engine
from engine.errors import OptionError
from engine.estimation.ps_em import ps_em
from engine.filters.kalman import kalman_smoother
from engine.filters.particle import particle_filter
from engine.smoothers.ffbsi import ffbsi
from engine.statespace.promotion import as_nonlinear

LINEAR = engine.get_model("linear-2")
MIXED = engine.get_model("mixed-4")


@pytest.fixture(scope="module")
def series() -> engine.Series:
    return engine.simulate(LINEAR, None, 60, np.random.default_rng(1)).series


@pytest.mark.long
def test_filter_agrees_with_kalman(series: engine.Series) -> None:
    y = series.y.copy()
    y[20:23] = np.nan
    gappy = engine.Series(y)
    exact = kalman_smoother(LINEAR, None, gappy)
    runs = [particle_filter(LINEAR, None, gappy, 2000, np.random.default_rng(k)) for k in range(20)]
    terms = np.array([run.log_likelihood for run in runs])
    likelihood = np.exp(terms - exact.log_likelihood)  # its expectation is 1
    assert abs(likelihood.mean() - 1.0) < 4.0 * likelihood.std() / np.sqrt(len(runs))
    assert likelihood.std() < 0.6
    mean = np.mean([run.mean() for run in runs], axis=0)
    width = np.sqrt(np.diagonal(exact.P_filtered, axis1=1, axis2=2))
    assert np.abs((mean - exact.x_filtered) / width).max() < 0.05
    assert runs[0].x.shape == (60, 2000, 2)
    assert runs[0].a.shape == runs[0].z.shape == (60, 2000, 1)
    np.testing.assert_allclose(runs[0].weights.sum(axis=1), 1.0)


def test_smoother_agrees_with_rts(series: engine.Series) -> None:
    exact = kalman_smoother(LINEAR, None, series)
    mean, second, cross = np.zeros((60, 2)), np.zeros((60, 2, 2)), np.zeros((59, 2, 2))
    runs = 20
    for k in range(runs):
        rng = np.random.default_rng(100 + k)
        draws = ffbsi(particle_filter(LINEAR, None, series, 1000, rng), 500, rng)
        x = draws.trajectories - exact.x[:, None]
        mean += x.mean(axis=1) / runs
        second += np.einsum("tni,tnj->tij", x, x) / 500 / runs
        cross += np.einsum("tni,tnj->tij", x[:-1], x[1:]) / 500 / runs
    width = np.sqrt(np.diagonal(exact.P, axis1=1, axis2=2))
    assert np.abs(mean / width).max() < 0.1
    scale = width[:, :, None] * width[:, None, :]
    assert np.abs((second - exact.P) / scale).max() < 0.15
    assert np.abs((cross - exact.M) / (width[:-1, :, None] * width[1:, None, :])).max() < 0.15
    assert abs(((second - exact.P) / scale).mean()) < 0.01
    assert draws.mean().shape == draws.std().shape == (60, 2)


def test_exactly_known_first_state_stays_exact() -> None:
    rng = np.random.default_rng(2)
    one = engine.simulate(MIXED, None, 30, rng).series
    filtered = particle_filter(MIXED, None, one, 40, rng)
    np.testing.assert_array_equal(filtered.z[0], 0.0)
    draws = ffbsi(filtered, 25, rng)
    np.testing.assert_array_equal(draws.z[0], 0.0)
    assert draws.trajectories.shape == (30, 25, 4)
    moments = draws.moments
    assert moments.cov.shape == (30, 1, 3, 3)
    assert moments.cross.shape == (29, 1, 3, 3)
    assert not moments.cov.any()


def test_joint_start_that_depends_on_a() -> None:
    """p(x_1) = p(a_1) p(z_1 | a_1) with a mean and a covariance that depend on a_1."""
    from dataclasses import replace

    def initial(theta: object) -> tuple[object, object, object]:
        density = engine.Gaussian([1.0], [[0.5]])
        return density, lambda a: 2.0 * a, lambda a: (0.1 + a**2)[:, :, None]

    model = replace(LINEAR, initial=initial)
    start = as_nonlinear(model).start(model.record(model.theta())).density
    x = start.sample(np.random.default_rng(3), 40_000)
    assert abs(x[:, 0].mean() - 1.0) < 0.02
    residual = (x[:, 1] - 2.0 * x[:, 0]) / np.sqrt(0.1 + x[:, 0] ** 2)
    assert abs(residual.mean()) < 0.02
    assert abs(residual.var() - 1.0) < 0.04
    v = 0.1 + x[:5, 0] ** 2
    want = (
        -0.5 * (x[:5, 0] - 1.0) ** 2 / 0.5
        - 0.5 * np.log(2 * np.pi * 0.5)
        - 0.5 * (x[:5, 1] - 2.0 * x[:5, 0]) ** 2 / v
        - 0.5 * np.log(2 * np.pi * v)
    )
    np.testing.assert_allclose(start.log_density(x[:5]), want, rtol=1e-12)


@pytest.mark.long
def test_ps_em_approaches_exact_em(series: engine.Series) -> None:
    """One EM step from the same theta is the exact one within the Monte Carlo error."""
    exact = engine.rts_em(LINEAR, series, {"theta": 0.3}, n_iterations=1, method="em")
    steps = [
        ps_em(
            LINEAR,
            series,
            {"theta": 0.3},
            n_particles=1000,
            n_trajectories=200,
            n_iterations=1,
            seed=k,
        ).theta[0]
        for k in range(12)
    ]
    error = np.std(steps) / np.sqrt(len(steps))
    assert abs(np.mean(steps) - exact.theta[0]) < 4.0 * error + 1e-3
    assert error < 0.005


def test_ps_em_resumes_to_the_same_bits(series: engine.Series) -> None:
    whole = ps_em(LINEAR, [series, series], {"theta": 0.3}, n_particles=20, n_iterations=6)
    part = ps_em(LINEAR, [series, series], {"theta": 0.3}, n_particles=20, n_iterations=3)
    rest = ps_em(LINEAR, [series, series], n_particles=20, n_iterations=6, resume=part)
    np.testing.assert_array_equal(whole.trace, rest.trace)
    assert whole.trace.shape == (7, 1)


def test_ps_em_without_retries_reports_the_collapse() -> None:
    rng = np.random.default_rng(5)
    one = engine.simulate(MIXED, None, 60, rng).series
    start = {"theta_2": 8.0}
    bare = ps_em(MIXED, one, start, n_particles=20, n_iterations=2, recover=False)
    helped = ps_em(MIXED, one, start, n_particles=20, n_iterations=2)
    assert bare.collapsed[0] > helped.collapsed[0]


def test_unknown_options_are_named(series: engine.Series) -> None:
    with pytest.raises(OptionError, match="proposal"):
        ps_em(LINEAR, series, proposal="best")
    with pytest.raises(OptionError, match="n_trajectories"):
        ps_em(LINEAR, series, n_trajectories=0)
