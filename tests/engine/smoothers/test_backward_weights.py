"""Backward simulation on a problem so small that all its paths can be listed: T = 3, M = 4."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from engine import Series, rb_ffbsi, rbpf
from tests.engine.models_for_tests import awkward_series, linear_mixed, partly_noise_free

T, M = 3, 4


def path_probabilities(f, theta):
    """P(index_1, index_2, index_3) of a backward draw without linear states, by enumeration."""
    model, series = f.model, f.series
    record = model.record(theta)
    p = np.zeros((M,) * T)
    for path in product(range(M), repeat=T):
        p[path] = f.weights[T - 1, path[-1]]
    for t in range(T - 2, -1, -1):
        fx, _, Q = model.transition(
            f.a[t], series.u[t], series.t[t], float(series.steps[t]), record
        )
        density = np.array([multivariate_normal(mean, Q).pdf(f.a[t + 1]) for mean in fx])
        weights = f.weights[t][:, None] * density  # of particle i at t, given particle n at t + 1
        weights /= weights.sum(axis=0)
        for path in product(range(M), repeat=T):
            p[path] *= weights[path[t], path[t + 1]]
    return p


def test_paths_are_drawn_with_their_probabilities():
    """Counts of 20,000 paths against all 64 probabilities; chi-square, error rate 1e-4."""
    model = linear_mixed(nz=0)
    series = awkward_series(model, T=9).part(0, T)
    f = rbpf(model, None, series, M, np.random.default_rng(2), ess_threshold=0.0)
    p = path_probabilities(f, model.theta())
    assert p.sum() == pytest.approx(1.0)
    n = 20_000
    s = rb_ffbsi(f, n, np.random.default_rng(3))
    counts = np.zeros_like(p)
    np.add.at(counts, tuple(s.index), 1)
    likely = p * n > 5
    chi2 = np.sum((counts[likely] - n * p[likely]) ** 2 / (n * p[likely]))
    freedom = np.count_nonzero(likely)
    assert chi2 < freedom + 4.0 * np.sqrt(2.0 * freedom)
    np.testing.assert_allclose(counts[~likely].sum() / n, p[~likely].sum(), atol=0.01)


def test_marginal_backward_weights_with_linear_states():
    """P(index_T-1 | index_T, z~_T) against N(x_T; f + A z, Q + A P A') for mixed states."""
    model = linear_mixed()
    series = awkward_series(model, T=9).part(0, T)
    f = rbpf(model, None, series, M, np.random.default_rng(2), ess_threshold=0.0)
    record, t, n = model.record(model.theta()), T - 2, 4000
    s = rb_ffbsi(f, n, np.random.default_rng(3), joint=True)
    fx, A, Q = model.transition(f.a[t], series.u[t], series.t[t], float(series.steps[t]), record)
    x = s.trajectories[t + 1]
    p = np.array(
        [
            f.weights[t, i]
            * multivariate_normal(fx[i] + A @ f.z[t, i], Q + A @ f.P[t, i] @ A.T).pdf(x)
            for i in range(M)
        ]
    )
    p /= p.sum(axis=0)
    expected = p.mean(axis=1)  # given the drawn x_T the index is a draw from p[:, j]
    got = np.bincount(s.index[t], minlength=M) / n
    sd = np.sqrt((p * (1 - p)).mean(axis=1) / n)
    assert np.all(np.abs(got - expected) < 4.5 * sd + 1e-12)


def test_each_next_particle_of_a_noise_free_state_keeps_its_own_ancestor():
    """s moves without noise: no other particle than the ancestor can lead to a successor."""
    model = partly_noise_free()
    y = np.cumsum(np.random.default_rng(0).standard_normal(30) * 0.3)[:, None]
    f = rbpf(model, None, Series(y), 50, np.random.default_rng(1))
    assert np.isfinite(f.log_likelihood)
    for joint in (False, True):
        s = rb_ffbsi(f, 40, np.random.default_rng(2), joint=joint)
        for t in range(len(y) - 1):
            v, position = s.a[t, :, 0], s.a[t, :, 1]
            np.testing.assert_allclose(s.a[t + 1, :, 1], position + 0.5 * v, atol=1e-9)
            own = f.ancestors[t + 1][s.index[t + 1]]
            np.testing.assert_array_equal(f.a[t][own], s.a[t])
