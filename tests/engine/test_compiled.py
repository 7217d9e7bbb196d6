"""The hand-written version of eq. (35) that the benchmark compares with does the same thing."""

from __future__ import annotations

import numpy as np
import pytest

from engine import condition_on_trajectories, get_model, rb_ffbsi, rbpf, simulate
from tests.benchmarks import compiled_mixed4


@pytest.mark.slow
@pytest.mark.parametrize("proposal", ["adapted", "bootstrap"])
def test_engine_and_compiled_version_agree_from_the_same_random_numbers(proposal):
    model = get_model("mixed-4")
    theta = np.asarray(model.theta())
    series = simulate(model, theta, 30, np.random.default_rng(1)).series
    rng = np.random.default_rng(2)
    f = rbpf(model, theta, series, 25, rng, proposal)
    s = condition_on_trajectories(rb_ffbsi(f, 20, rng, joint=True))
    a, z, P, M, log_likelihood = compiled_mixed4.e_step(
        series.y, theta, 25, 20, np.random.default_rng(2), proposal == "adapted", 0.5
    )
    assert log_likelihood == pytest.approx(f.log_likelihood, abs=1e-6)
    np.testing.assert_allclose(a, s.a[..., 0], atol=1e-6)
    np.testing.assert_allclose(z, s.z, atol=1e-6)
    np.testing.assert_allclose(P, s.cov[:, 0], atol=1e-10)
    np.testing.assert_allclose(M, s.cross[:, 0], atol=1e-10)
