"""Backward simulation in O(M): the same trajectories in distribution as with all the weights."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import engine
from engine.errors import OptionError
from engine.filters.kalman import kalman_smoother
from engine.smoothers.linear_cost import backward_draws, rb_ffbsi_linear

LINEAR = engine.get_model("linear-2")


def curved_dynamics(a: Any, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
    """A and Q that differ from particle to particle."""
    A = [[theta.theta + 0.5 * np.tanh(a[:, 0])], [0.9]]
    Q = np.zeros((len(a), 2, 2))
    Q[:, 0, 0] = 0.1 + 0.05 * a[:, 0] ** 2
    Q[:, 1, 1] = 0.1
    Q[:, 0, 1] = Q[:, 1, 0] = 0.03
    return [0.9 * a[:, 0], 0.0], A, Q


CURVED = replace(LINEAR, dynamics=curved_dynamics)


@pytest.mark.long
@pytest.mark.parametrize("model", [LINEAR, CURVED], ids=["common", "per particle"])
@pytest.mark.parametrize("method", ["rejection", "mcmc"])
def test_same_paths_as_the_full_sampler(model: engine.MixedModel, method: str) -> None:
    """Of all index paths through a filter with M = 4, T = 4, each is drawn as often as it should be."""
    series = engine.simulate(model, None, 4, np.random.default_rng(2)).series
    filtered = engine.rbpf(model, None, series, 4, np.random.default_rng(3), "bootstrap")
    N, rng = 60_000, np.random.default_rng(4)
    full = engine.rb_ffbsi(filtered, N, rng, joint=True)
    tries = 2 if method == "rejection" else None  # so that the fallback has its share
    fast, cost = backward_draws(filtered, N, rng, method, 30, tries, condition=False)
    if method == "rejection":
        assert 0.05 < cost.full < 0.95
    code = 4 ** np.arange(4)
    one, other = (np.bincount(code @ run.index, minlength=256) / N for run in (full, fast))
    error = np.sqrt((one + other) / N)
    assert np.abs(one - other).max() < 0.008
    assert (np.abs(one - other)[error > 0] < 4.5 * error[error > 0]).all()
    for run in (full, fast):  # the z that go with them
        assert run.trajectories is not None
    np.testing.assert_allclose(
        fast.trajectories.mean(axis=1), full.trajectories.mean(axis=1), atol=0.03
    )
    covs = [np.cov(run.trajectories.swapaxes(0, 1).reshape(N, 8).T) for run in (fast, full)]
    np.testing.assert_allclose(covs[0], covs[1], atol=0.05)


@pytest.mark.parametrize(("method", "moves"), [("mcmc", 1), ("mcmc", 3), ("rejection", 1)])
def test_agrees_with_rts(method: str, moves: int) -> None:
    series = engine.simulate(LINEAR, {"theta": 0.5}, 60, np.random.default_rng(1)).series
    exact = kalman_smoother(LINEAR, {"theta": 0.5}, series)
    runs, N = 12, 300
    mean, second, cross = np.zeros((60, 2)), np.zeros((60, 2, 2)), np.zeros((59, 2, 2))
    for k in range(runs):
        rng = np.random.default_rng(k)
        filtered = engine.rbpf(LINEAR, {"theta": 0.5}, series, 300, rng)
        draws = rb_ffbsi_linear(filtered, N, rng, method, moves)
        x = draws.trajectories - exact.x[:, None]
        mean += (draws.mean() - exact.x) / runs
        second += np.einsum("tni,tnj->tij", x, x) / N / runs
        cross += np.einsum("tni,tnj->tij", x[:-1], x[1:]) / N / runs
    width = np.sqrt(np.diagonal(exact.P, axis1=1, axis2=2))
    scale = width[:, :, None] * width[:, None, :]
    assert np.abs(mean / width).max() < 0.12
    assert np.abs((second - exact.P) / scale).max() < 0.2
    assert np.abs(((second - exact.P) / scale).mean(axis=0)).max() < 0.03
    next_scale = width[:-1, :, None] * width[1:, None, :]
    assert np.abs(((cross - exact.M) / next_scale).mean(axis=0)).max() < 0.03


def test_conditioned_moments_are_those_of_the_trajectories() -> None:
    series = engine.simulate(CURVED, None, 20, np.random.default_rng(1)).series
    filtered = engine.rbpf(CURVED, None, series, 50, np.random.default_rng(2))
    plain = rb_ffbsi_linear(filtered, 30, np.random.default_rng(3), condition=False)
    moments = rb_ffbsi_linear(filtered, 30, np.random.default_rng(3))
    np.testing.assert_array_equal(plain.a, moments.a)
    np.testing.assert_array_equal(plain.z, plain.trajectories[:, :, 1:])
    assert not plain.cov.any()
    want = engine.condition_on_trajectories(plain)
    np.testing.assert_array_equal(moments.z, want.z)
    np.testing.assert_array_equal(moments.cov, want.cov)


@pytest.mark.parametrize("method", ["mcmc", "rejection"])
def test_noise_free_state_keeps_its_past(method: str) -> None:
    """a' = 0.9 a without noise: only a particle's own past leads to it."""

    def dynamics(a: Any, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        return [0.9 * a[:, 0], 0.0], np.array([[0.0], [1.0]]), np.diag([0.0, 0.1])

    model = replace(LINEAR, dynamics=dynamics)
    rng = np.random.default_rng(1)
    series = engine.simulate(model, None, 15, rng).series
    filtered = engine.rbpf(model, None, series, 40, rng)
    draws = rb_ffbsi_linear(filtered, 25, rng, method)
    np.testing.assert_allclose(draws.a[1:], 0.9 * draws.a[:-1], rtol=1e-12)


def test_plain_ffbsi_on_a_particle_filter() -> None:
    """Without linear states it is the linear-cost FFBSi."""
    rng = np.random.default_rng(1)
    series = engine.simulate(LINEAR, None, 30, rng).series
    filtered = engine.particle_filter(LINEAR, None, series, 100, rng)
    draws = rb_ffbsi_linear(filtered.filtered, 50, rng)
    assert draws.trajectories.shape == (30, 50, 2)
    exact = kalman_smoother(LINEAR, None, series)
    assert np.abs(draws.mean()[:, 0] - exact.x[:, 0]).mean() < 0.15


def test_options_are_checked() -> None:
    rng = np.random.default_rng(1)
    series = engine.simulate(LINEAR, None, 5, rng).series
    filtered = engine.rbpf(LINEAR, None, series, 10, rng)
    with pytest.raises(OptionError, match="method"):
        rb_ffbsi_linear(filtered, 10, rng, "fast")
    with pytest.raises(OptionError, match="moves"):
        rb_ffbsi_linear(filtered, 10, rng, moves=0)


@pytest.mark.long
def test_em_with_linear_cost() -> None:
    """One EM step is that of the full sampler within its Monte Carlo error."""
    series = engine.simulate(LINEAR, None, 60, np.random.default_rng(1)).series
    exact = engine.rts_em(LINEAR, series, {"theta": 0.4}, n_iterations=1, method="em").theta[0]
    steps = [
        engine.rbps_em(
            LINEAR,
            series,
            {"theta": 0.4},
            n_particles=300,
            n_iterations=1,
            seed=k,
            smoother="linear-cost",
            warm_start=False,
            method="em",
        ).theta[0]
        for k in range(12)
    ]
    assert abs(np.mean(steps) - exact) < 4.0 * np.std(steps) / np.sqrt(12) + 5e-4
    assert np.std(steps) < 0.01
