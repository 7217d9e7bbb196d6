"""Particles that have lost a series say so, by the moment filter or by their weights; others say nothing."""

import numpy as np
import pytest

import engine
from engine.filters.lost import left_in_words

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


@pytest.mark.long
def test_one_particle_that_was_left_is_told():
    """A squared reading leaves two values: the moment filter is far below what even lost particles find."""

    def dynamics(a, u, t, dt, theta):
        x = a[:, 0]
        return [0.5 * x + 25 * x / (1 + x**2) + 8 * np.cos(1.2 * t)], [[]], [[1.0]]

    model = engine.MixedModel(
        name="growth",
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([a[:, 0] ** 2 / 20], [[]], [[theta.r]]),
        initial=lambda theta: (engine.Gaussian([0.0], [[5.0]]), [], np.zeros((0, 0))),
        nonlinear={"x": "1"},
        outputs={"echo": "1"},
        parameters=[engine.Parameter("r", 1.0, "1", (1e-9, 50.0))],
    )
    series = engine.simulate(model, None, 300, np.random.default_rng(1), dt=1.0).series
    few, many = (engine.rbpf(model, None, series, n, 1) for n in (20, 2000))
    assert few.log_likelihood < many.log_likelihood - 50.0
    assert "One particle was left" in str(few)
    assert not many.note


def test_that_no_particle_was_left_is_told():
    """Also where the moment filter has no likelihood either, as it overflows."""
    assert left_in_words([], []) == ""
    assert left_in_words([2.0, 3.0], [0.0, np.nan]) == "No particle was left from t = 2 on."
    assert left_in_words([1.0, 3.0], [1.2, np.nan]) == "No particle was left from t = 3 on."
    assert "at 1 row, first at t = 4." in left_in_words([4.0], [1.2])
