"""Sizes of two columns at once, however large what they do."""

from __future__ import annotations

import numpy as np
import pytest

from engine.diagnose.free_run_fits.linear import _two_sizes


@pytest.mark.parametrize("scale", [1.0, 1e-90, 1e90])
def test_columns_of_what_runs_away_have_two_sizes_too(scale):
    G = np.random.default_rng(1).standard_normal((40, 2))
    E = G @ [[2.0], [-3.0]]
    first, second = _two_sizes(E, scale * G, np.array([0]), np.array([1]))
    np.testing.assert_allclose([first * scale, second * scale], [[2.0], [-3.0]], rtol=1e-9)
