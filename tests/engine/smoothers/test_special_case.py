"""Report, section 5.4: the RTS form coincides with the general one, and serves any p(a_{t+1} | a_t)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

import engine
from engine.errors import ModelError
from engine.filters.kalman import kalman_smoother
from engine.smoothers.special_case import SpecialCase, gaussian_case, rb_ffbsi_special, rbpf_special

BASE = engine.get_model("linear-2")


def decoupled(per_particle: bool) -> engine.MixedModel:
    """A_a = Q_az = 0, two linear states that show in y together with a."""

    def dynamics(a: Any, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        x = a[:, 0]
        bend = 0.2 * np.tanh(x) if per_particle else 0.2
        f = [0.8 * x + np.sin(x), 0.1 * x, 0.0]
        A = [[0.0, 0.0], [0.9, bend], [0.0, 0.7]]
        Q = np.zeros((len(a), 3, 3)) if per_particle else np.zeros((3, 3))
        Q[..., 0, 0] = 0.2 + (0.1 * x**2 if per_particle else 0.0)
        Q[..., 1, 1] = 0.1
        Q[..., 2, 2] = 0.2
        Q[..., 1, 2] = Q[..., 2, 1] = 0.05
        return f, A, Q

    def measurement(a: Any, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        return [a[:, 0] ** 2 / 5.0], [[1.0, 0.5]], [[0.1]]

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        return engine.Gaussian([0.0], [[1.0]]), np.zeros(2), np.zeros((2, 2))

    return replace(
        BASE,
        linear={"z1": "1", "z2": "1"},
        reference={},
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
    )


@pytest.mark.long
@pytest.mark.parametrize("joint", [False, True])
@pytest.mark.parametrize("per_particle", [False, True])
def test_same_random_numbers_give_the_same_numbers(per_particle: bool, joint: bool) -> None:
    model = decoupled(per_particle)
    series = engine.simulate(model, None, 60, np.random.default_rng(1)).series.masked([7, 8])
    one_rng, other_rng = np.random.default_rng(2), np.random.default_rng(2)
    general = engine.rbpf(model, None, series, 40, one_rng, "bootstrap")
    special = rbpf_special(gaussian_case(model), None, series, 40, other_rng)
    for name in ("a", "z", "P", "weights", "ess", "ancestors", "log_likelihood"):
        np.testing.assert_allclose(
            getattr(special, name), getattr(general, name), rtol=1e-9, atol=1e-11, err_msg=name
        )
    one = engine.rb_ffbsi(general, 30, one_rng, joint)
    other = rb_ffbsi_special(special, 30, other_rng, joint)
    np.testing.assert_array_equal(other.index, one.index)
    for name in ("a", "z", "P", "M", *(["trajectories"] if joint else [])):
        np.testing.assert_allclose(
            getattr(other, name), getattr(one, name), rtol=1e-8, atol=1e-10, err_msg=name
        )
    if joint:  # and so do the exact moments given the trajectories
        one, other = map(engine.condition_on_trajectories, (one, other))
        np.testing.assert_allclose(other.z, one.z, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(other.P, one.P, rtol=1e-8, atol=1e-10)


def test_a_model_that_is_no_special_case_is_refused() -> None:
    series = engine.simulate(BASE, None, 10, np.random.default_rng(1)).series
    with pytest.raises(ModelError, match="A_a and Q_az must be zero"):
        rbpf_special(gaussian_case(BASE), None, series, 10, np.random.default_rng(2))


def switching() -> SpecialCase:
    """a is a Markov chain on {-1, 1}: no Gaussian, no density in the usual sense, but eq. (63a)."""
    stay = 0.9

    def sample(
        a: Any, u: Any, t: float, dt: float, theta: Any, rng: np.random.Generator
    ) -> np.ndarray:
        return np.where(rng.random(a.shape) < stay, a, -a)

    def log_density(a_next: Any, a: Any, u: Any, t: float, dt: float, theta: Any) -> np.ndarray:
        return np.log(np.where(a_next[:, 0] == a[:, 0], stay, 1.0 - stay))

    class Sign:
        def sample(self, rng: np.random.Generator, n: int) -> np.ndarray:
            return np.where(rng.random((n, 1)) < 0.5, -1.0, 1.0)

        def log_density(self, a: np.ndarray) -> np.ndarray:
            return np.full(len(a), np.log(0.5))

    def dynamics(a: Any, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        return [0.0, 0.8 * a[:, 0]], [[0.0], [0.7]], np.diag([1.0, 0.2])

    def measurement(a: Any, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        return [0.0], [[1.0]], [[0.3]]

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        return Sign(), np.zeros(1), np.eye(1)

    model = replace(BASE, dynamics=dynamics, measurement=measurement, initial=initial)
    return SpecialCase(model, sample, log_density)


@pytest.mark.slow
def test_switching_model_against_enumeration() -> None:
    """All 2^8 paths of the chain, a Kalman smoother for each: the exact answer."""
    case, rng, T = switching(), np.random.default_rng(5), 8
    a, z, y = 1.0, 0.0, np.empty((T, 1))
    for t in range(T):
        y[t] = z + np.sqrt(0.3) * rng.standard_normal()
        z = 0.7 * z + 0.8 * a + np.sqrt(0.2) * rng.standard_normal()
        a = a if rng.random() < 0.9 else -a
    series = engine.Series(y)
    weights, signs, z_mean, z_square = [], [], [], []
    for code in range(2**T):
        path = np.where((code >> np.arange(T)) & 1, 1.0, -1.0)
        flips = np.count_nonzero(np.diff(path))
        fixed = replace(
            BASE,
            nonlinear={},
            reference={},
            dynamics=lambda a, u, t, dt, theta, p=path: ([0.8 * p[int(t)]], [[0.7]], [[0.2]]),
            measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[0.3]]),
            initial=lambda theta: (engine.Gaussian([], np.zeros((0, 0))), np.zeros(1), np.eye(1)),
        )
        exact = kalman_smoother(fixed, None, series)
        prior = np.log(0.5) + flips * np.log(0.1) + (T - 1 - flips) * np.log(0.9)
        weights.append(prior + exact.log_likelihood)
        signs.append(path)
        z_mean.append(exact.x[:, 0])
        z_square.append(exact.P[:, 0, 0] + exact.x[:, 0] ** 2)
    log_likelihood = float(np.logaddexp.reduce(weights))
    p = np.exp(np.array(weights) - log_likelihood)
    runs = []
    for k in range(20):
        rng = np.random.default_rng(k)
        filtered = rbpf_special(case, None, series, 400, rng)
        draws = engine.condition_on_trajectories(rb_ffbsi_special(filtered, 200, rng, joint=True))
        second = (draws.z[:, :, 0] ** 2 + draws.P[:, :, 0, 0]).mean(axis=1)
        runs.append((filtered.log_likelihood, draws.mean()[:, 0], draws.mean()[:, 1], second))
    likelihood = np.exp(np.array([run[0] for run in runs]) - log_likelihood)
    assert abs(likelihood.mean() - 1.0) < 0.03
    for got, want in zip(
        (np.mean([run[i] for run in runs], axis=0) for i in (1, 2, 3)),
        (p @ np.array(signs), p @ np.array(z_mean), p @ np.array(z_square)),
        strict=True,
    ):
        np.testing.assert_allclose(got, want, atol=0.03)


def test_heavy_tailed_steps() -> None:
    """A mixture step density: jumps are followed where the Gaussian of equal variance lags."""
    share, small, large = 0.05, 0.05, 3.0

    def sample(
        a: Any, u: Any, t: float, dt: float, theta: Any, rng: np.random.Generator
    ) -> np.ndarray:
        scale = np.where(rng.random(a.shape) < share, large, small)
        return a + scale * rng.standard_normal(a.shape)

    def log_density(a_next: Any, a: Any, u: Any, t: float, dt: float, theta: Any) -> np.ndarray:
        r = (a_next - a)[:, 0]
        return np.log((1 - share) * norm.pdf(r, 0, small) + share * norm.pdf(r, 0, large))

    def dynamics(a: Any, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        q = (1 - share) * small**2 + share * large**2
        return [a[:, 0], 0.0], [[0.0], [0.9]], np.diag([q, 0.01])

    def measurement(a: Any, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        return [a[:, 0]], [[1.0]], [[0.1]]

    model = replace(BASE, dynamics=dynamics, measurement=measurement)
    rng, T = np.random.default_rng(3), 150
    jumps = np.where(rng.random(T) < share, large, small) * rng.standard_normal(T)
    level = np.cumsum(jumps)
    z = 0.0
    y = np.empty(T)
    for t in range(T):
        y[t] = level[t] + z + np.sqrt(0.1) * rng.standard_normal()
        z = 0.9 * z + 0.1 * rng.standard_normal()
    series = engine.Series(y)
    fits = [
        rbpf_special(case, None, series, 1000, np.random.default_rng(7)).log_likelihood
        for case in (SpecialCase(model, sample, log_density), gaussian_case(model))
    ]
    assert fits[0] > fits[1] + 10.0
