"""Roots instead of covariances: a tiny noise beside a large one keeps its digits."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import engine
from engine.kernels.gaussian import (
    log_normal_columns,
    log_normal_each,
    log_normalizer,
    lower_root_into,
    lower_roots_into,
    whiten,
)


@given(st.integers(1, 6), st.integers(1, 9), st.integers(0, 10**6))
def test_a_lower_root_is_one_whatever_the_units_and_the_rank(n, m, seed):
    rng = np.random.default_rng(seed)
    X = rng.standard_normal((n, m))
    bound = n > 2 and seed % 2 == 1
    if bound:
        X[n - 1] = 2.0 * X[0] - X[1]  # a direction without noise of its own
    X *= 10.0 ** rng.integers(-9, 9, (n, 1))
    L = np.full((n, n), np.nan)
    lower_root_into(X.copy(), L)
    sd = np.linalg.norm(X, axis=1)
    assert not np.triu(L, 1).any()
    assert (np.diagonal(L) >= 0.0).all()
    np.testing.assert_allclose(L @ L.T / np.outer(sd, sd), X @ X.T / np.outer(sd, sd), atol=1e-13)
    if bound:
        assert L[n - 1, n - 1] == 0.0


@pytest.mark.parametrize(("n", "m"), [(3, 5), (3, 3), (3, 2)])
@pytest.mark.parametrize("lost", [False, True])
def test_roots_side_by_side_are_those_one_by_one(n, m, lost):
    rng = np.random.default_rng(n + m)
    X = rng.standard_normal((n, m, 7))
    if lost:
        X[1, :, 3] = 0.0  # takes no column
        X[:, :, 5] = np.nan
    L = np.full((n, n, 7), np.nan)
    lower_roots_into(X.copy(), L)
    for i in range(7):
        one = np.full((n, n), np.nan)
        lower_root_into(X[:, :, i].copy(), one)
        np.testing.assert_allclose(L[:, :, i], one, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("silent", [False, True])
def test_columns_are_whitened_as_one_by_one(silent):
    rng = np.random.default_rng(1)
    n, M = 3, 6
    L = np.tril(rng.uniform(0.5, 1.0, (n, n)))
    if silent:
        L[1, 1] = 0.0  # half of the columns agree with a direction without noise
    r = rng.standard_normal((n, M))
    if silent:
        r[1, ::2] = L[1, 0] * r[0, ::2] / L[0, 0]
    slack = np.full((n, M), 1e-12)
    expected, whitened = np.empty(M), np.empty((n, M))
    for i in range(M):
        v = np.empty(n)
        possible = whiten(L, r[:, i].copy(), slack[:, i].copy(), v)
        whitened[:, i] = v
        expected[i] = log_normalizer(L, n) - 0.5 * v @ v if possible else -np.inf
    assert np.isinf(expected).any() == silent
    one, each = r.copy(), r.copy()
    log_one, log_each = np.empty(M), np.empty(M)
    log_normal_columns(L, one, slack, log_one)
    log_normal_each(np.repeat(L[:, :, None], M, axis=2), each, slack, log_each)
    for found, log_p in ((one, log_one), (each, log_each)):
        np.testing.assert_allclose(found, whitened, rtol=1e-13, atol=1e-13)
        np.testing.assert_allclose(log_p, expected, rtol=1e-13)


def at_rest(R: float) -> engine.MixedModel:
    """Two states that do not move, one combination of which is read at a time."""
    return engine.MixedModel(
        name="at-rest",
        dynamics=lambda a, u, t, dt, theta: ([0.0, 0.0], np.eye(2), np.zeros((2, 2))),
        measurement=lambda a, u, t, theta: ([0.0], [[1.0, 1.0 + t % 2.0]], [[R]]),
        initial=lambda theta: (
            engine.Gaussian(np.zeros(0), np.zeros((0, 0))),
            [0.0, 0.0],
            np.eye(2),
        ),
        nonlinear={},
        linear={"z1": "m", "z2": "m"},
        outputs={"y": "m"},
        parameters=[engine.Parameter("unused", 1.0, "1", (0.0, 2.0))],
    )


def exact(R: float, y: list[float]) -> tuple[list[list[Fraction]], list[Fraction]]:
    """P_{T|T} and the innovations' variances of ``at_rest`` in rational numbers."""
    P, variances = [[Fraction(1), Fraction(0)], [Fraction(0), Fraction(1)]], []
    for t in range(len(y)):
        c = [Fraction(1), Fraction(1 + t % 2)]
        Pc = [sum(P[i][k] * c[k] for k in range(2)) for i in range(2)]
        S = sum(c[i] * Pc[i] for i in range(2)) + Fraction(R)
        P = [[P[i][j] - Pc[i] * Pc[j] / S for j in range(2)] for i in range(2)]
        variances.append(S)
    return P, variances


@pytest.mark.parametrize("R", [1e-8, 1e-16, 1e-22])
def test_a_tiny_measurement_noise_does_not_cancel(R):
    y = [0.3, 0.4, 0.3, 0.4, 0.3, 0.4]
    model, series = at_rest(R), engine.Series(np.array(y), dt=1.0)
    filtered = engine.rbpf(model, None, series, 1, np.random.default_rng(0))
    P, variances = exact(R, y)
    rounding = 1e-15 / np.sqrt(R)  # of a standard deviation of 1, beside that of the sensor
    exact_P = np.array(P, dtype=float)
    np.testing.assert_allclose(filtered.cov[-1, 0], exact_P, rtol=1e-9 + rounding)
    normalizers = -0.5 * np.log(2.0 * np.pi * np.array(variances, dtype=float))
    assert (filtered.log_likelihood_terms <= normalizers + 1e-6).all()
    # the first two readings fix the states; what repeats them agrees to rounding
    rest = filtered.log_likelihood_terms[2:]
    np.testing.assert_allclose(rest, normalizers[2:], atol=1e-3 if R > 1e-20 else 1e3)


@pytest.mark.parametrize("R", [1e-6, 1e-14, 1e-20])
def test_a_nonlinear_state_is_drawn_where_a_sharp_sensor_saw_it(R):
    """A random walk read by such a sensor: every reading says where it is, to sqrt(R)."""
    model = engine.MixedModel(
        name="walk",
        dynamics=lambda a, u, t, dt, theta: ([a[:, 0]], np.zeros((1, 0)), [[1.0]]),
        measurement=lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[R]]),
        initial=lambda theta: (engine.Gaussian([0.0], [[1.0]]), [], np.zeros((0, 0))),
        nonlinear={"x": "m"},
        outputs={"y": "m"},
        parameters=[engine.Parameter("unused", 1.0, "1", (0.0, 2.0))],
    )
    y = np.cumsum(np.random.default_rng(1).standard_normal(40))
    filtered = engine.rbpf(model, None, engine.Series(y, dt=1.0), 200, np.random.default_rng(2))
    steps = np.diff(y, prepend=0.0)
    wanted = -0.5 * np.sum(
        steps**2 + np.log(2.0 * np.pi)
    )  # R is nothing beside the walk's own noise
    assert filtered.log_likelihood == pytest.approx(wanted, abs=3.0)
    assert filtered.ess.min() > 50
