"""Weak directions of a free run's derivatives: what wider differences do not confirm is noise."""

from __future__ import annotations

import numpy as np
import pytest

from engine.simulation.covariance import run_covariance


@pytest.mark.parametrize(("noise", "tied"), [(5e-4, True), (1e-6, False)])
def test_a_weak_direction_counts_where_it_exceeds_its_noise(noise, tied):
    rng = np.random.default_rng(0)
    a = rng.normal(size=(200, 1))
    apart = 0.0 if tied else 5e-4  # columns that are one but for noise, or that differ by as much
    exact = np.hstack([a, a + apart * rng.normal(size=a.shape)])
    J, again = (exact + noise * rng.normal(size=exact.shape) for _ in range(2))
    e, rows, record = rng.normal(size=200), np.arange(200), np.zeros(200, dtype=np.intp)
    found = run_covariance(e, J, record, rows, lambda: again)
    assert found.tied.tolist() == [tied, tied]
    assert not run_covariance(e, J, record, rows).tied.any()
