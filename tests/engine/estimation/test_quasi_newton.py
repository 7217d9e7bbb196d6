"""The quasi-Newton method: its rule on functions that are known, and what it finds against exact answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine import Outcome, get_model, rbps_em, rts_em, simulate
from engine.estimation.quasi_newton import Ascent, Memory, Seen, bounded, width, window
from tests.engine.models_for_tests import random_walk
from tests.studies.scalar_linear import MODEL as SCALAR

LINEAR = get_model("linear-2")
MIXED = get_model("mixed-4")
TOP = np.array([0.3, 0.6])
INFORMATION = np.array([[400.0, 150.0], [150.0, 100.0]])


def climb(start, noise=0.0, metric=INFORMATION, tolerance=0.02, n=200, fall=0.0, rng=None):
    """The rule on -1/2 (x - TOP)' I (x - TOP) with parameters c in [0, 1] and q in [0.01, 1]."""
    model = random_walk()
    rng = rng or np.random.default_rng(0)
    rule = Ascent(model, np.arange(2), lambda theta: metric, 200, tolerance)
    x, before, points = np.array(start), [], []
    for k in range(1, n + 1):
        points.append(x)
        d = TOP - x
        score = INFORMATION @ d + noise * np.linalg.cholesky(INFORMATION) @ rng.standard_normal(2)
        value = -0.5 * d @ INFORMATION @ d - fall * float(len(points) == 2)
        x, memory = rule.next(Seen(x, x, score, 20.0 * INFORMATION, value, 20.0), before, k + 8)
        before.append(memory)
        if memory.settled:
            break
    return np.array(points), x, before


def test_without_noise_a_quadratic_function_takes_few_steps():
    points, x, memory = climb([0.9, 0.1])
    np.testing.assert_allclose(x, TOP, atol=1e-3)
    assert memory[-1].settled
    assert len(points) <= 12


def test_noise_is_averaged_until_it_costs_as_little_as_asked():
    """The cost is chi^2 with 2 degrees of freedom times half of what is asked, in nats."""
    losses, lengths = [], []
    for seed in range(60):
        points, x, memory = climb([0.4, 0.5], 0.8, rng=np.random.default_rng(seed))
        assert memory[-1].settled
        losses.append(0.5 * (x - TOP) @ INFORMATION @ (x - TOP))
        lengths.append(len(points))
    assert np.mean(losses) < 2 * 2 * 0.02
    assert 12 < np.mean(lengths) < 40


@pytest.mark.parametrize("wrong", [0.4, 10.0])
def test_a_wrong_metric_takes_longer_and_ends_in_the_same_place(wrong):
    for seed in range(20):
        _, x, memory = climb([0.5, 0.4], 0.5, wrong * INFORMATION, rng=np.random.default_rng(seed))
        assert memory[-1].settled
        assert 0.5 * (x - TOP) @ INFORMATION @ (x - TOP) < 1.0


def test_a_point_far_below_is_left_for_a_shorter_step():
    points, x, memory = climb([0.9, 0.1], fall=1e4)
    np.testing.assert_array_equal(memory[1].base, points[0])
    first, second = (np.linalg.norm(p - points[0]) for p in points[1:3])
    assert second < 0.5 * first
    assert memory[-1].settled
    assert 0.5 * (x - TOP) @ INFORMATION @ (x - TOP) < 0.1


def test_bounds_are_kept_and_a_maximum_beyond_one_is_approached():
    """c may be 1 at most, and the function is highest at 1.5."""
    model, beyond = random_walk(), np.array([1.5, 0.3])
    rule = Ascent(model, np.arange(2), lambda theta: INFORMATION, 200, 0.02)
    x, before = np.array([0.2, 0.2]), []
    for k in range(40):
        d = beyond - x
        seen = Seen(x, x, INFORMATION @ d, 20.0 * INFORMATION, -0.5 * d @ INFORMATION @ d, 20.0)
        x, memory = rule.next(seen, before, k + 9)
        before.append(memory)
        assert -1.0 <= x[0] <= 1.0
        assert 0.01 <= x[1] <= 5.0
    assert x[0] == pytest.approx(1.0, abs=0.02)
    held = beyond[1] + 1.5 * (beyond[0] - x[0])  # the maximum of the other with c held
    assert x[1] == pytest.approx(held, abs=0.02)


def test_what_is_remembered_is_packed_without_loss():
    _, _, before = climb([0.9, 0.1], 0.5)
    for one in before:
        again = Memory.of(one.row(), 2)
        np.testing.assert_array_equal(again.row(), one.row())
        assert (again.images, again.settled) == (one.images, one.settled)
    assert Memory.of(np.full(width(2), np.nan), 2) is None
    assert Memory.of(np.zeros(3), 2) is None


def test_a_metric_above_the_complete_data_information_is_cut():
    complete = np.diag([4.0, 9.0])
    np.testing.assert_allclose(bounded(0.5 * complete, complete), 0.5 * complete, rtol=1e-6)
    np.testing.assert_allclose(bounded(2.0 * complete, complete), 1.2 * complete, rtol=1e-6)
    assert bounded(50.0 * complete, complete) is None  # it cannot be so, and is no metric
    assert bounded(np.diag([0.0, 1.0]), complete) is None
    idle = bounded(np.diag([2.0, 0.0]), np.diag([4.0, 0.0]))  # nothing depends on the second
    np.testing.assert_allclose(idle, np.diag([2.0, 0.0]), rtol=1e-6)


def test_a_trend_shortens_the_window():
    rng = np.random.default_rng(1)
    still = rng.standard_normal((12, 2))
    assert window(still, np.eye(2), 1.0) == (12, True)
    assert window(still, np.eye(2), 1e-3) == (12, False)
    assert window(0.1 * still + 1.0, np.eye(2), 1.0) == (0, False)
    assert window(0.5 ** np.arange(12.0)[:, None], np.eye(1), 0.02) == (12, True)
    early = np.concatenate([still[:2] + 30.0, 0.1 * still[2:]])
    assert window(early, np.eye(2), 1.0)[0] == 12  # the newer half is what counts
    assert window(np.full((3, 2), 9.0), np.eye(2), 1.0) == (3, False)


def test_a_trend_in_one_direction_is_not_hidden_by_the_noise_of_others():
    """All noise together would cover it; an estimate along that direction goes on moving."""
    noise = np.random.default_rng(0).standard_normal((10, 6)) * [0.1, 1.0, 1.0, 1.0, 1.0, 1.0]
    assert window(noise, np.eye(6), 1.0) == (10, True)
    assert window(noise + 0.5 * np.eye(6)[0], np.eye(6), 1.0) == (10, False)


@pytest.mark.slow
@pytest.mark.parametrize("start", [0.3, 0.02])
def test_the_exact_smoother_reaches_the_maximum_of_the_exact_likelihood(start):
    series = simulate(LINEAR, None, 200, np.random.default_rng(1)).series
    slow = rts_em(LINEAR, series, [start], n_iterations=3000, tolerance=1e-9, method="em")
    fast = rts_em(LINEAR, series, [start], method="quasi-newton")
    assert fast.outcome is Outcome.CONVERGED
    assert len(fast.log_likelihood) <= 15
    assert fast.theta[0] == pytest.approx(slow.theta[0], rel=1e-3)


@pytest.mark.long
@pytest.mark.parametrize("warm_start", [True, False])
def test_particles_reach_it_too(warm_start):
    """Within a third of a standard error in both parameters of the noise, and in a."""
    series = simulate(SCALAR, None, 300, np.random.default_rng(2)).series
    start = {"a": 0.6, "q": 0.2, "r": 0.05}
    best = engine.estimation.quasi_ml.quasi_ml(SCALAR, series, tolerance=1e-8)
    found = rbps_em(SCALAR, series, start, warm_start=warm_start, n_iterations=60)
    assert found.outcome is Outcome.CONVERGED
    assert np.all(np.abs(found.theta - best.theta) < 0.34 * best.standard_errors)


@pytest.mark.slow
def test_eq_35_is_within_a_nat_after_few_iterations():
    """Against many particles; EM needs a hundred iterations from there."""
    series = simulate(MIXED, None, 120, np.random.default_rng(5)).series
    start = {"theta_1": 1.4, "theta_2": 0.6, "theta_3": 0.4, "theta_4": 0.9, "theta_5": 0.4}
    found = rbps_em(MIXED, series, start)
    assert found.outcome is Outcome.CONVERGED
    assert len(found.log_likelihood) <= 25
    best = rbps_em(MIXED, series, found.theta, n_particles=300, n_trajectories=100)
    errors = engine.standard_errors(MIXED, best, series)
    d = np.asarray(best.theta) - np.asarray(found.theta)
    assert 0.5 * d @ np.linalg.solve(errors.covariance, d) < 1.0


@pytest.mark.long
def test_a_model_that_the_moment_filter_cannot_follow_is_estimated_by_em(monkeypatch):
    def lost(*_, **__):
        raise engine.ModelError("cannot be followed")

    monkeypatch.setattr("engine.estimation.likelihood_step.derivatives", lost)
    series = simulate(LINEAR, None, 40, np.random.default_rng(3)).series
    options = {"n_particles": 10, "n_iterations": 45, "warm_start": False}
    one = rbps_em(LINEAR, series, **options)
    other = rbps_em(LINEAR, series, method="em", **options)
    np.testing.assert_array_equal(one.trace, other.trace)
    assert (one.outcome, one.message) == (other.outcome, other.message)
    assert np.isnan(one.memory).all()
    again = rbps_em(LINEAR, series, resume=replace(one.checkpoint), **options)
    np.testing.assert_array_equal(again.trace, one.trace)


@pytest.mark.long
def test_what_em_began_can_be_gone_on_with():
    series = simulate(LINEAR, None, 60, np.random.default_rng(3)).series
    begun = rbps_em(LINEAR, series, [0.3], n_particles=10, n_iterations=5, method="em")
    found = rbps_em(LINEAR, series, n_particles=10, resume=begun)
    np.testing.assert_array_equal(found.trace[:6], begun.trace)
    assert found.outcome is Outcome.CONVERGED
    back = rbps_em(LINEAR, series, n_particles=10, resume=found, n_iterations=40, method="em")
    np.testing.assert_array_equal(back.trace[: len(found.trace)], found.trace)


def test_an_unknown_method_is_refused():
    series = simulate(LINEAR, None, 20, np.random.default_rng(3)).series
    for estimate in (rbps_em, rts_em):
        with pytest.raises(engine.OptionError, match="quasi-newton or em") as caught:
            estimate(LINEAR, series, method="newton")
        assert caught.value.field == "method"
