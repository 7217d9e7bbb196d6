"""PS-EM with a divergence check: the compiled E step is PS-EM's, and what is ignored is as if missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.data.series import Series
from engine.errors import OptionError
from engine.estimation.expectation import expectation
from engine.filters.particle import particle_filter
from engine.models.registry import get_model
from engine.simulation.simulate import simulate
from engine.smoothers.ffbsi import ffbsi
from engine.statespace.points import Points
from tests.studies.guarded_em import Squares, e_step, guarded_ps_em, transition, transition_slopes

MODEL = get_model("mixed-4")
THETA = MODEL.theta({"theta_1": 0.9, "theta_4": 0.95})
ALL = np.arange(5)


def data(T, seed):
    return simulate(MODEL, None, T, np.random.default_rng(seed)).series


def statistics(x):
    """Past, cross and ahead of trajectories x (T, N, 4)."""
    phi = np.concatenate([np.arctan(x[:-1, :, :1]), x[:-1, :, 1:]], axis=2)
    n = x.shape[1]
    return (
        np.einsum("tni,tnj->ij", phi, phi) / n,
        np.einsum("tni,tnj->ij", x[1:], phi) / n,
        float((x[1:] ** 2).sum()) / n,
    )


def test_the_q_function_is_that_of_the_general_method():
    series, rng = data(30, 1), np.random.default_rng(2)
    draws = ffbsi(particle_filter(MODEL, THETA, series, 40, rng), 40, rng)
    general = expectation(MODEL, THETA, [(draws.moments, Points(MODEL, series, draws.a))])
    compiled = Squares(MODEL, *statistics(draws.trajectories))
    other = np.asarray(MODEL.theta({"theta_2": 1.2, "theta_3": 0.2, "theta_5": 0.5}))
    here = np.asarray(THETA)
    gain = general.value(other) - general.value(here)
    assert compiled.value(other) - compiled.value(here) == pytest.approx(gain, rel=1e-9)
    _, gradient, H = compiled.derivatives(other, ALL)
    _, expected, scoring = general.derivatives(other, ALL)
    np.testing.assert_allclose(gradient, expected, rtol=1e-5, atol=1e-5 * abs(expected).max())
    np.testing.assert_allclose(H, scoring, rtol=1e-4, atol=1e-5 * abs(scoring).max())


def test_slopes_are_those_of_the_transition():
    at = np.asarray(THETA)
    for k, slope in enumerate(transition_slopes(at)):
        step = 1e-6 * (k == ALL)
        difference = (transition(at + step) - transition(at - step)) / 2e-6
        np.testing.assert_allclose(slope, difference, atol=1e-8)


def passes(series, guard, n, seed, M=50):
    rng, T = np.random.default_rng(seed), len(series)
    return [
        e_step(
            np.asarray(THETA),
            np.array(series.y),
            guard,
            rng.standard_normal((T, 4, M)),
            rng.random((T, M)),
            rng.random((T, M)),
        )
        for _ in range(n)
    ]


def agrees(one, other, sigmas=4.0):
    """Means of two sets of numbers (n,) within their error."""
    one, other = np.array(one), np.array(other)
    error = np.hypot(one.std() / np.sqrt(len(one)), other.std() / np.sqrt(len(other)))
    return abs(one.mean() - other.mean()) < sigmas * error + 1e-12


@pytest.mark.slow
def test_without_a_check_the_draws_are_those_of_the_general_method():
    series, rng = data(20, 3), np.random.default_rng(4)
    compiled = passes(series, 0.0, 200, 5)
    general, log_likelihoods = [], []
    for _ in range(200):
        filtered = particle_filter(MODEL, THETA, series, 50, rng)
        general.append(statistics(ffbsi(filtered, 50, rng).trajectories))
        log_likelihoods.append(filtered.log_likelihood)
    assert agrees([p[1] for p in compiled], log_likelihoods)
    for i, j in ((0, 0), (0, 1), (1, 1), (2, 3)):
        assert agrees([p[0][0][i, j] for p in compiled], [g[0][i, j] for g in general])
        assert agrees([p[0][1][i, j] for p in compiled], [g[1][i, j] for g in general])
    assert agrees([p[0][2] for p in compiled], [g[2] for g in general])


@pytest.mark.long
def test_a_measurement_that_all_particles_contradict_is_as_if_missing():
    series, rng = data(20, 6), np.random.default_rng(7)
    wild, missing = np.array(series.y), np.array(series.y)
    wild[10], missing[10] = 50.0, np.nan
    compiled = passes(replace_y(series, wild), 1e-12, 200, 8)
    assert all(p[2] >= 1 for p in compiled)
    general = [
        statistics(ffbsi(particle_filter(MODEL, THETA, one, 50, rng), 50, rng).trajectories)
        for one in [replace_y(series, missing)] * 200
    ]
    for i, j in ((0, 0), (0, 1), (1, 1)):
        assert agrees([p[0][1][i, j] for p in compiled], [g[1][i, j] for g in general])
    unchecked = passes(replace_y(series, wild), 0.0, 200, 9)
    assert not agrees([p[0][2] for p in unchecked], [g[2] for g in general])


def replace_y(series, y):
    return replace(series, y=y)


@pytest.mark.long
def test_it_estimates_and_refuses_other_models():
    series = data(100, 10)
    result = guarded_ps_em(MODEL, series, {"theta_2": 0.6}, ["theta_2"], n_iterations=60, seed=1)
    again = guarded_ps_em(MODEL, series, {"theta_2": 0.6}, ["theta_2"], n_iterations=60, seed=1)
    assert abs(result.theta["theta_2"] - 1.0) < 0.3
    np.testing.assert_array_equal(result.trace, again.trace)
    assert set(result.trace[:, 0]) == {1.0}
    with pytest.raises(OptionError, match="only mixed-4"):
        guarded_ps_em(get_model("linear-2"), Series(y=np.zeros((5, 1))))
