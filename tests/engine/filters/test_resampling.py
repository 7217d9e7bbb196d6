"""Every scheme is unbiased, and each has the variance it is known for."""

from __future__ import annotations

import numpy as np
import pytest

from engine.filters.rbpf import RESAMPLING
from engine.kernels.resampling import normalize

W = np.array([0.02, 0.31, 0.0, 0.17, 0.08, 0.25, 0.01, 0.16])
N, RUNS = 10, 4000


def counts(scheme, w=W, n=N, runs=RUNS):
    rng = np.random.default_rng(11)
    return np.array(
        [np.bincount(RESAMPLING[scheme](w, rng.random(n)), minlength=len(w)) for _ in range(runs)]
    )


@pytest.mark.parametrize("scheme", RESAMPLING)
def test_expected_counts_are_n_w(scheme):
    """Within 5 standard errors of the mean count of each particle: error rate below 1e-5."""
    c = counts(scheme)
    assert np.all(c.sum(axis=1) == N)
    error = np.abs(c.mean(axis=0) - N * W)
    assert np.all(error <= 5.0 * np.sqrt(N * W * (1 - W) / RUNS) + 1e-12)
    assert not c[:, W == 0.0].any()


def test_variance_of_the_counts():
    """Multinomial N w (1 - w); the others at most that, each with its own bound on the counts."""
    variance = {name: counts(name).var(axis=0) for name in RESAMPLING}
    np.testing.assert_allclose(variance["multinomial"], N * W * (1 - W), rtol=0.15, atol=1e-12)
    fraction = N * W - np.floor(N * W)
    rest = fraction.sum()
    np.testing.assert_allclose(
        variance["residual"], fraction * (1 - fraction / rest), rtol=0.2, atol=1e-12
    )
    slack = 1.15  # five standard errors of a variance from 4000 runs
    assert np.all(variance["residual"] <= slack * variance["multinomial"] + 1e-12)
    assert np.all(variance["stratified"] <= slack * variance["multinomial"] + 1e-12)
    c = counts("systematic")
    assert np.all(np.abs(c - N * W) < 1.0)  # each count is floor(N w) or ceil(N w)
    np.testing.assert_allclose(variance["systematic"], fraction * (1 - fraction), atol=0.03)
    c = counts("stratified")
    assert np.all(np.abs(c - N * W) < 2.0)
    assert np.all(counts("residual") >= np.floor(N * W))


@pytest.mark.parametrize("scheme", RESAMPLING)
def test_one_heavy_particle_and_other_numbers_of_draws(scheme):
    w = np.array([0.0, 1.0, 0.0])
    for n in (1, 3, 20):
        assert np.all(RESAMPLING[scheme](w, np.random.default_rng(0).random(n)) == 1)


def test_weights_far_below_the_smallest_number_are_normalized():
    w = np.empty(3)
    log_sum, ess = normalize(np.array([-1e5, -1e5, -np.inf]), w)
    np.testing.assert_allclose(w, [0.5, 0.5, 0.0])
    assert log_sum == pytest.approx(-1e5 + np.log(2.0))
    assert ess == pytest.approx(2.0)
    log_sum, ess = normalize(np.full(3, -np.inf), w)
    assert (log_sum, ess) == (-np.inf, 0.0)
    np.testing.assert_allclose(w, 1.0 / 3.0)
