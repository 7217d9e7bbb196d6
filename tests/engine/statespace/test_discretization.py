"""Discretisation against closed forms and against numerical integration."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm

from engine.errors import OptionError
from engine.statespace.discretization import discretize


@pytest.mark.parametrize("dt", [1e-3, 0.1, 5.0, 300.0])
def test_double_integrator(dt):
    A, B, Q = discretize([[0, 1], [0, 0]], [[0], [1]], np.diag([0.0, 2.0]), dt=dt)
    np.testing.assert_allclose(A, [[1, dt], [0, 1]], rtol=1e-12)
    np.testing.assert_allclose(B, [[dt**2 / 2], [dt]], rtol=1e-12)
    expected = 2.0 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    np.testing.assert_allclose(Q, expected, rtol=1e-11)


@pytest.mark.parametrize("dt", [1e-4, 0.3, 40.0, 1e4])
def test_ornstein_uhlenbeck_also_where_it_is_fast_beside_the_step(dt):
    rate, q = 2.5, 0.7
    A, B, Q = discretize([[-rate]], [[3.0]], [[q]], dt=dt)
    np.testing.assert_allclose(A, [[np.exp(-rate * dt)]], rtol=1e-9, atol=1e-300)
    np.testing.assert_allclose(B, [[-3.0 * np.expm1(-rate * dt) / rate]], rtol=1e-11)
    np.testing.assert_allclose(Q, [[-q * np.expm1(-2 * rate * dt) / (2 * rate)]], rtol=1e-11)


def test_undamped_oscillator():
    w, q, dt = 3.0, 0.4, 0.9
    A, B, Q = discretize([[0, 1], [-(w**2), 0]], [[0], [w**2]], np.diag([0.0, q]), dt=dt)
    c, s = np.cos(w * dt), np.sin(w * dt)
    np.testing.assert_allclose(A, [[c, s / w], [-w * s, c]], rtol=1e-12)
    np.testing.assert_allclose(B, [[1 - c], [w * s]], rtol=1e-12)
    sine2 = np.sin(2 * w * dt)
    expected = q * np.array(
        [
            [(dt / 2 - sine2 / (4 * w)) / w**2, s**2 / (2 * w**2)],
            [s**2 / (2 * w**2), dt / 2 + sine2 / (4 * w)],
        ]
    )
    np.testing.assert_allclose(Q, expected, rtol=1e-11)


@pytest.mark.parametrize("seed", range(5))
def test_random_systems_against_numerical_integration(seed):
    rng = np.random.default_rng(seed)
    F, G = rng.standard_normal((4, 4)), rng.standard_normal((4, 2))
    root = rng.standard_normal((4, 2))
    Qc, dt = root @ root.T, rng.uniform(0.1, 3.0)
    A, B, Q = discretize(F, G, Qc, dt=dt)
    np.testing.assert_allclose(A, expm(F * dt), rtol=1e-9, atol=1e-9)
    integral = quad_vec(lambda s: expm(F * s) @ G, 0.0, dt, epsabs=1e-12)[0]
    np.testing.assert_allclose(B, integral, rtol=1e-8, atol=1e-8 * np.abs(B).max())
    integral = quad_vec(lambda s: expm(F * s) @ Qc @ expm(F * s).T, 0.0, dt, epsabs=1e-12)[0]
    np.testing.assert_allclose(Q, integral, rtol=1e-8, atol=1e-8 * np.abs(Q).max())
    np.testing.assert_array_equal(Q, Q.T)


def test_several_systems_and_steps_at_once():
    F = np.array([[[0.0, 1.0], [0.0, -k]] for k in (0.1, 1.0, 10.0)])
    dt, Qc = np.array([0.1, 0.2, 0.3]), np.diag([0.0, 1.0])
    together = discretize(F, [[0], [1]], Qc, dt=dt)
    for i in range(3):
        alone = discretize(F[i], [[0], [1]], Qc, dt=dt[i])
        for one, other in zip(together, alone, strict=True):
            np.testing.assert_allclose(one[i], other, rtol=1e-10, atol=1e-14)


def test_without_input_and_noise():
    A, B, Q = discretize(np.zeros((2, 2)), dt=1.0)
    np.testing.assert_array_equal(A, np.eye(2))
    assert B.shape == (2, 0)
    np.testing.assert_array_equal(Q, np.zeros((2, 2)))


@pytest.mark.parametrize(
    ("arguments", "dt", "message"),
    [
        ([[[1.0, 2.0]]], 1.0, r"F has shape \(1, 2\); a square matrix"),
        ([[1.0, 2.0]], 1.0, r"F has shape \(2,\); a matrix"),
        ([[[np.nan]]], 1.0, r"F is not finite"),
        ([np.eye(2), np.ones((3, 1))], 1.0, r"G has shape \(3, 1\); 2 rows"),
        ([np.eye(2), None, np.eye(3)], 1.0, r"Qc has shape \(3, 3\); \(2, 2\)"),
        ([np.eye(2)], 0.0, r"dt = 0.0 s; positive"),
        ([np.eye(2)], np.inf, r"dt = inf s; positive"),
    ],
)
def test_errors(arguments, dt, message):
    with pytest.raises(OptionError, match=message):
        discretize(*arguments, dt=dt)
