"""Particles that have lost a series say so, by the moment filter; others say nothing."""

import numpy as np
import pytest

import engine

MODEL = engine.get_model("oscillator")  # linear, so that its moment filter is exact
QUIET = {"sigma_v": 1e-6, "sigma_y": 1e-3}


@pytest.mark.parametrize(("particles", "lost"), [(4, True), (60, False)])
def test_what_print_says_of_a_filter(particles, lost):
    """Next to no process noise, an unknown first velocity: one particle of t = 1 is followed to the end."""
    u = np.sin(0.7 * np.arange(60))
    series = engine.simulate(MODEL, QUIET, 60, np.random.default_rng(0), u, dt=0.05).series
    filtered = engine.rbpf(MODEL, QUIET, series, particles, 4)
    smoothed = engine.rb_ffbsi(filtered, 20, 4)
    assert ("seem to have lost the series" in str(filtered)) == lost
    assert ("seem to have lost the series" in str(smoothed)) == lost
    assert f"Log-likelihood {filtered.log_likelihood:.2f}" in str(filtered)
