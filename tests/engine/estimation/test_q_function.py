"""The Q-function against numerical integration, its gradient against finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.stats import multivariate_normal

from engine import Series, condition_on_trajectories, rb_ffbsi, rbpf
from engine.estimation.e_steps import rbps_step
from engine.estimation.expectation import expectation
from engine.estimation.maximization import maximize
from engine.smoothers.moments import Moments
from engine.statespace.points import Points
from tests.engine.models_for_tests import draw, partly_noise_free, theta_everywhere

T, N = 3, 4
MODELS = {"per particle": theta_everywhere(), "common": theta_everywhere(particle_shaped=False)}


def small_problem(model, theta=None):
    t = np.arange(T) * 0.5
    y = draw(model, np.zeros((T, 0)), t, np.random.default_rng(0))
    y[1, 0] = np.nan
    series = Series(y, t=t)
    theta = model.theta(theta)
    rng = np.random.default_rng(1)
    s = rb_ffbsi(rbpf(model, theta, series, 20, rng), N, rng, joint=True)
    points = Points(model, series, s.a)
    s = condition_on_trajectories(s, points)
    q = expectation(model, theta, [(Moments(s.a, s.z, s.cov, s.cross), points)])
    return q, s, series


def log_joint(model, theta, series, a, z):
    """Log p(a, z, y; theta) for one path a (T, na) and K paths z (K, T, nz), with scipy's densities."""
    record = model.record(theta)
    start = model.start(record)
    z1, P1 = start.linear(a[:1])
    total = multivariate_normal(start.density.mean, start.density.cov).logpdf(a[0])
    total = total + multivariate_normal(np.zeros(model.nz), P1).logpdf(z[:, 0] - z1)
    for t in range(len(a)):
        h, C, R = (np.squeeze(m) for m in model.observation(a[t : t + 1], None, 0.0, record))
        there = series.observed[t]
        r = series.y[t] - h - z[:, t] @ C.T
        total = total + np.atleast_1d(
            multivariate_normal(np.zeros(there.sum()), R[np.ix_(there, there)]).logpdf(r[:, there])
        )
        if t + 1 < len(a):
            f, A, Q = (
                np.squeeze(m) for m in model.transition(a[t : t + 1], None, 0.0, 1.0, record)
            )
            x = np.concatenate([np.tile(a[t + 1], (len(z), 1)), z[:, t + 1]], axis=1)
            total = total + multivariate_normal(np.zeros(model.nx), Q).logpdf(x - f - z[:, t] @ A.T)
    return total


def integrate_over_z(model, theta_k, series, a, theta):
    """E log p(a, z, y; theta) over p(z | a, y; theta_k): Gauss-Hermite, exact for quadratics."""
    n = T * model.nz

    def at(values, parameters=theta_k):
        return log_joint(model, parameters, series, a, values.reshape(len(values), T, model.nz))

    # log p is quadratic in z: its Hessian and maximum from differences with unit steps are exact
    e = np.eye(n)
    both = (e[:, None] + e[None]).reshape(-1, n)
    zero, single = at(np.zeros((1, n)))[0], at(e)
    hessian = (at(both).reshape(n, n) - single[:, None] - single[None]) + zero
    gradient = single - zero - 0.5 * np.diag(hessian)
    cov = np.linalg.inv(-hessian)
    mean = cov @ gradient
    nodes, weights = np.polynomial.hermite_e.hermegauss(3)
    grid = np.stack(np.meshgrid(*[nodes] * n, indexing="ij"), axis=-1).reshape(-1, n)
    share = np.prod(
        np.stack(np.meshgrid(*[weights / weights.sum()] * n, indexing="ij"), axis=-1), axis=-1
    ).ravel()
    return float(share @ at(mean + grid @ np.linalg.cholesky(cov).T, theta))


@pytest.mark.parametrize("case", MODELS)
def test_value_agrees_with_numerical_integration(case):
    model = MODELS[case]
    q, s, series = small_problem(model)
    theta_k = np.asarray(model.theta())
    rng = np.random.default_rng(5)
    for theta in (theta_k, theta_k * 1.1, theta_k + 0.05 * rng.standard_normal(len(theta_k))):
        direct = np.mean(
            [integrate_over_z(model, theta_k, series, s.a[:, j], theta) for j in range(N)]
        )
        assert q.value(theta) == pytest.approx(direct, rel=1e-7, abs=1e-7)


@pytest.mark.parametrize("case", MODELS)
def test_gradient_agrees_with_finite_differences_for_theta_everywhere(case):
    model = MODELS[case]
    q, _, _ = small_problem(model)
    free = np.arange(len(model.parameters))
    for scale in (1.0, 1.2):
        theta = scale * np.asarray(model.theta())
        value, gradient, H = q.derivatives(theta, free)
        assert value == pytest.approx(q.value(theta), rel=1e-12)
        assert np.all(np.abs(gradient) > 1e-6)  # every parameter enters
        np.testing.assert_allclose(
            gradient, approx_fprime(theta, q.value, 1e-6), rtol=2e-3, atol=2e-4
        )
        assert np.linalg.eigvalsh(H).min() > 0.0


def test_noise_free_rows_and_a_known_z_1_leave_the_q_function():
    """Singular Q, P_1 = 0: the term of v alone remains, with its least-squares solution in k."""
    model = partly_noise_free()
    rng = np.random.default_rng(2)
    series = Series(draw(model, np.zeros((60, 0)), np.arange(60.0), rng))
    step = rbps_step(model, [series], 60, 30)(model.theta(), rng)
    q = step.q
    assert np.isfinite(q.value(np.array([0.8])))
    theta = maximize(q, np.array([0.3]), np.arange(1))
    grid = np.linspace(theta[0] - 0.05, theta[0] + 0.05, 11)
    values = [q.value(np.array([k])) for k in grid]
    assert np.all(np.isfinite(values))
    assert np.argmax(values) == 5
    second = np.diff(values, 2)
    np.testing.assert_allclose(second, second[0], rtol=1e-6)  # quadratic: Q does not depend on k


def test_a_covariance_that_loses_its_rank_is_refused():
    """Q -> 0 would make the likelihood of the M step infinite; the rank at theta_k is kept."""
    model = MODELS["common"]
    q, _, _ = small_problem(model)
    theta = np.array(model.theta())
    theta[model.index("v1")] = 0.0
    assert q.value(theta) == -np.inf


@pytest.mark.parametrize("case", MODELS)
def test_scoring_and_bfgs_find_the_same_maximum(case):
    model = MODELS[case]
    t = np.arange(40.0)
    series = Series(draw(model, np.zeros((40, 0)), t, np.random.default_rng(0)))
    rng = np.random.default_rng(3)
    q = rbps_step(model, [series], 30, 20)(model.theta(), rng).q
    free = model.free_indices(["f", "A", "Q", "h", "C", "R"])
    start = np.array(model.theta())
    scoring = maximize(q, start, free, "scoring")
    bfgs = maximize(q, start, free, "bfgs")
    assert q.value(scoring) > q.value(start) + 0.01
    assert q.value(scoring) == pytest.approx(q.value(bfgs), abs=1e-4)
    np.testing.assert_allclose(scoring, bfgs, atol=5e-3)
    held = np.setdiff1d(np.arange(len(start)), free)
    np.testing.assert_array_equal(scoring[held], start[held])
    np.testing.assert_array_equal(bfgs[held], start[held])


@pytest.mark.parametrize("method", ["scoring", "bfgs"])
def test_bounds_are_respected(method):
    """The unbounded maximum for f is outside a bound put between it and the start."""
    from dataclasses import replace

    model = MODELS["common"]
    series = Series(draw(model, np.zeros((40, 0)), np.arange(40.0), np.random.default_rng(0)))
    q = rbps_step(model, [series], 30, 20)(model.theta(), np.random.default_rng(3)).q
    free = model.free_indices(["f", "A", "h"])
    start = np.array(model.theta())
    k = model.index("f")
    best = maximize(q, start, free, method)[k]
    bound = 0.5 * (best + start[k])
    ends = (-5.0, bound) if best > start[k] else (bound, 5.0)
    parameters = [replace(p, bounds=ends) if p.name == "f" else p for p in model.parameters]
    bounded = replace(model, parameters=parameters)
    found = maximize(replace(q, model=bounded), start, free, method)
    assert found[k] == pytest.approx(bound, abs=1e-9)
    assert bounded.lower[k] <= found[k] <= bounded.upper[k]
    assert q.value(found) > q.value(start)
