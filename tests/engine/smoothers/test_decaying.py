"""Smoothing of states that decay at different rates, with no noise to renew them, against all of x at once."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import engine


def decaying(na: int, q: float, diffuse: float, offset: float = 0.0) -> engine.MixedModel:
    """Two linear states, of which one decays at once, and with ``na`` 1 a noisy one that they drive."""

    def dynamics(a: Any, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        f = [0.9 * a[:, 0]] if na else []
        A = [[1.0, 0.5]] if na else []
        Q = np.diag([0.1] * na + [q, q])
        return (
            [*f, -0.03 * offset, 0.5 * offset],
            [*A, [0.98, 0.05], [0.2, 0.3]],
            Q,
        )

    def measurement(a: Any, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        return ([a[:, 0]], [[0.0, 0.0]], [[0.01]]) if na else ([0.0], [[1.0, 0.5]], [[0.01]])

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        first = engine.Gaussian([0.0], [[1.0]]) if na else None
        return first, [offset, offset], diffuse**2 * np.eye(2)

    return engine.MixedModel(
        name="decaying",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        nonlinear={"a": "1"} if na else {},
        linear={"slow": "1", "fast": "1"},
        outputs={"y": "1"},
        parameters=[],
    )


def at_once(na: int, q: float, diffuse: float, offset: float, y: Any) -> tuple[Any, Any, Any]:
    """Smoothed means, standard deviations and lag-one covariances by one least squares over all noise."""
    T, nx = len(y), na + 2
    F, Q = np.array([[0.98, 0.05], [0.2, 0.3]]), np.diag([q, q])
    H, first, f = np.array([1.0, 0.5]), diffuse * np.eye(2), offset * np.array([-0.03, 0.5])
    start = offset * np.ones(2)
    if na:
        F = np.block([[np.array([[0.9]]), np.array([[1.0, 0.5]])], [np.zeros((2, 1)), F]])
        Q, H, f = np.diag([0.1, q, q]), np.array([1.0, 0.0, 0.0]), np.array([0.0, *f])
        first, start = np.diag([1.0, diffuse, diffuse]), np.array([0.0, *start])
    of_noise, mean = np.zeros((T, nx, T * nx)), np.zeros((T, nx))
    of_noise[0, :, :nx], mean[0] = first, start
    for t in range(1, T):
        of_noise[t], mean[t] = F @ of_noise[t - 1], f + F @ mean[t - 1]
        of_noise[t, :, t * nx : (t + 1) * nx] += np.sqrt(Q)
    G, e = (H @ of_noise) / 0.1, (y - mean @ H) / 0.1
    q_, r_ = np.linalg.qr(np.concatenate([G, np.eye(T * nx)]))
    w = np.linalg.solve(r_, q_[:T].T @ e)
    roots = np.linalg.solve(r_.T, of_noise.reshape(T * nx, -1).T).T.reshape(T, nx, -1)
    sd = np.sqrt((roots**2).sum(axis=2))
    return mean + of_noise @ w, sd, roots[:-1] @ roots[1:].swapaxes(1, 2)


@pytest.mark.parametrize("diffuse", [1.0, 1e6])
@pytest.mark.parametrize("q", [0.0, 1e-20, 1e-12])
@pytest.mark.parametrize("na", [0, 1])
def test_what_decays_without_noise(na: int, q: float, diffuse: float) -> None:
    model = decaying(na, q, diffuse)
    y = np.random.default_rng(3).standard_normal(80).cumsum()
    series = engine.Series(y)
    mean, sd, lag = at_once(na, q, diffuse, 0.0, y)
    exact = engine.kalman_smoother(model, None, series)
    assert np.abs((exact.x - mean) / sd).max() < 1e-5
    assert np.allclose(np.diagonal(exact.P, axis1=1, axis2=2), sd**2, rtol=1e-5, atol=0.0)
    assert np.abs((exact.M - lag) / sd[:-1, :, None] / sd[1:, None]).max() < 1e-5


@pytest.mark.parametrize("q", [0.0, 1e-20])
def test_moments_without_nonlinear_states_are_exact(q: float) -> None:
    model = decaying(0, q, 1.0, offset=300.0)
    y = np.full(200, 450.0)
    mean, sd, lag = at_once(0, q, 1.0, 300.0, y)
    filtered = engine.rbpf(model, None, engine.Series(y), 2, 1)
    draws = engine.rb_ffbsi(filtered, 2, 2, joint=True)
    exact = engine.condition_on_trajectories(draws)
    assert np.abs((exact.mean() - mean) / sd).max() < 1e-5
    assert np.allclose(exact.std(), sd, rtol=1e-5)
    assert np.abs((exact.M[:, 0] - lag) / sd[:-1, :, None] / sd[1:, None]).max() < 1e-5
    # Algorithm 3 divides by what is next to nothing once
    assert np.allclose(draws.std(), sd, rtol=0.05)


def test_the_special_case() -> None:
    linear = decaying(0, 0.0, 1.0)

    def dynamics(a: Any, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        f, A, Q = linear.dynamics(a, u, t, dt, theta)
        return [0.5 * a[:, 0], *f], [[0.0, 0.0], *A], np.diag([1.0, *np.diag(Q)])

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        return engine.Gaussian([0.0], [[1.0]]), *linear.initial(theta)[1:]

    model = replace(linear, dynamics=dynamics, initial=initial, nonlinear={"a": "1"})
    y = np.random.default_rng(3).standard_normal(80).cumsum()
    _, sd, _ = at_once(0, 0.0, 1.0, 0.0, y)
    filtered = engine.rbpf_special(engine.gaussian_case(model), None, engine.Series(y), 20, 1)
    smoothed = engine.rb_ffbsi_special(filtered, 20, 2)
    assert np.allclose(np.sqrt(np.diagonal(smoothed.cov[:, 0], axis1=1, axis2=2)), sd, rtol=0.05)


@pytest.mark.long
def test_moments_given_trajectories() -> None:
    model = decaying(1, 0.0, 1.0)
    y = engine.simulate(model, None, 200, 1).series.y[:, 0]
    _, sd, _ = at_once(1, 0.0, 1.0, 0.0, y)
    filtered = engine.rbpf(model, None, engine.Series(y), 200, 1)
    draws = engine.rb_ffbsi(filtered, 200, 2, joint=True)
    for smoothed in (
        draws,
        engine.rb_ffbsi(filtered, 200, 2),
        engine.condition_on_trajectories(draws),
    ):
        assert np.allclose(smoothed.std()[:, 1:], sd[:, 1:], rtol=0.1)
        assert (np.diagonal(smoothed.cov, axis1=2, axis2=3) >= 0.0).all()
