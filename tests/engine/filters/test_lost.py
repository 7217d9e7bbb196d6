"""Particles that have lost a series say so, by the moment filter; others say nothing."""

import numpy as np
import pytest

import engine

MODEL = engine.get_model("mixed-4")


@pytest.mark.parametrize(("far", "lost"), [(0.0, False), (300.0, True)])
def test_what_print_says_of_a_filter(far, lost):
    """Readings that nothing near the particles explains, once the moment filter is closer to them."""
    series = engine.simulate(MODEL, None, 120, np.random.default_rng(2)).series
    filtered = engine.rbpf(MODEL, None, series, 60, 3)
    if lost:  # as where weights fell onto a wrong particle for good
        terms = filtered.log_likelihood_terms - far / len(series)
        filtered = engine.Filtered(**{**vars(filtered), "log_likelihood_terms": terms})
    smoothed = engine.rb_ffbsi(filtered, 20, 4)
    assert ("have lost the series" in str(filtered)) == lost
    assert ("have lost the series" in str(smoothed)) == lost
    assert f"Log-likelihood {filtered.log_likelihood:.2f}" in str(filtered)
