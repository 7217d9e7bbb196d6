"""Where the moment filter is proved wrong, EM's steps are followed as far as particles find it likelier."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine import Gaussian, MixedModel, Outcome, Parameter
from engine.estimation.leaps import ahead, leap, looked_far, surely
from tests.engine.models_for_tests import random_walk

MODEL = random_walk().with_parameters(
    [Parameter("c", 0.1, "", (-1.0, 0.4)), Parameter("r", 0.1, "", (0.0, 10.0))]
)


def sway():
    """A phase that wanders by a damped rate, of which the sine is read: it wraps around far from the truth."""
    return MixedModel(
        name="sway",
        dynamics=lambda a, u, t, dt, th: (
            [a[:, 0], 0.0],
            [[1.0], [0.98]],
            [[1e-5, 0.0], [0.0, th.q]],
        ),
        measurement=lambda a, u, t, th: ([np.sin(a[:, 0])], [[0.0]], [[th.r]]),
        initial=lambda th: (Gaussian([0.0], [[0.1]]), [0.4], [[0.01]]),
        nonlinear={"phi": ""},
        linear={"rate": ""},
        outputs={"y": ""},
        parameters=[Parameter("q", 1e-3, "", (0.0, 1.0)), Parameter("r", 0.1, "", (1e-6, 10.0))],
    )


@pytest.mark.slow
def test_a_slope_that_the_moment_filter_does_not_see_is_climbed():
    """It "converged" ten nats short: its metric was a million times what all states known would give."""
    truth, start = {"q": 3e-4, "r": 0.1}, {"q": 0.03, "r": 0.1}
    series = engine.simulate(sway(), truth, 120, np.random.default_rng(2)).series
    found = engine.rbps_em(sway(), series, start, n_particles=30, warm_start=False)

    def height(theta):
        runs = [engine.rbpf(sway(), theta, series, 500, seed) for seed in range(3)]
        return np.mean([run.log_likelihood for run in runs])

    assert found.outcome in (Outcome.CONVERGED, Outcome.UNDECIDED, Outcome.ITERATIONS_USED_UP)
    assert height(found.theta) > height(truth) - 2.5


class Filters:
    """Particle filters of which the log-likelihood is known, but for noise."""

    n_particles = 10

    def __init__(self, of, noise=0.0):
        self.of, self.noise = of, noise

    def log_likelihood(self, theta, times, rng):
        return self.of(theta) + self.noise * rng.standard_normal() / np.sqrt(times)


def walked(steps=9):
    """Points of c and r by as many equal steps to 0.2 and 0.5, c by 0.01 and r by 5 % a step."""
    return [MODEL.theta({"c": 0.2 + 0.01 * i, "r": 0.5 * 0.95**i}) for i in range(-steps, 1)]


def test_positive_parameters_are_carried_on_by_factors_and_bounds_are_kept():
    points = walked()
    found = dict(ahead(MODEL, points, np.arange(2)))
    assert list(found) == [30.0, 10.0, 3.0]
    assert found[3.0]["r"] == pytest.approx(0.5 * 0.95**3)
    assert found[30.0]["r"] == pytest.approx(0.5 * 0.95**30)
    assert found[3.0]["c"] == pytest.approx(0.23)
    assert found[30.0]["c"] == pytest.approx(0.3)  # half of the way to its bound
    still = [points[0]] * 5
    assert not list(ahead(MODEL, still, np.arange(2)))


def test_the_longest_leap_that_is_surely_likelier_is_taken():
    points = walked()
    indices = np.arange(2)
    far = Filters(lambda theta: -200.0 * np.log(theta["r"] / 0.1) ** 2, 0.5)
    there = leap(MODEL, points, indices, far, 0)
    assert surely(there)
    assert there[0]["r"] == pytest.approx(0.5 * 0.95**30)
    near = Filters(lambda theta: -200.0 * np.log(theta["r"] / 0.44) ** 2)
    assert leap(MODEL, points, indices, near, 0)[0]["r"] == pytest.approx(0.5 * 0.95**3)
    at = Filters(lambda theta: -200.0 * np.log(theta["r"] / 0.5) ** 2, 0.1)
    assert leap(MODEL, points, indices, at, 0) is None
    doubtful = leap(MODEL, points, indices, Filters(lambda theta: -4.0 * theta["r"], 3.0), 3, ())
    assert not surely(doubtful)


def test_a_point_at_which_the_model_fails_is_no_leap():
    points = walked()

    def fails(theta):
        if theta["r"] < 0.3:
            raise engine.ModelError("too little")
        return -10.0 * theta["r"]

    there = leap(MODEL, points, np.arange(2), Filters(fails), 0)
    assert there is None or there[0]["r"] > 0.3


def test_an_estimate_from_which_steps_lead_on_is_not_said_to_have_converged():
    points = np.array([np.asarray(one) for one in walked()])
    series = engine.simulate(MODEL, None, 30, np.random.default_rng(0)).series
    run = engine.rts_em(MODEL, series, n_iterations=1)
    outcome = Outcome.CONVERGED
    here = MODEL.theta(points[-1])
    settled = replace(run, theta=here, trace=points, outcome=outcome, message=outcome.value)
    rises = Filters(lambda theta: -200.0 * np.log(theta["r"] / 0.1) ** 2, 0.5)
    found = looked_far(settled, rises, np.arange(2), 0, 10)
    assert found.outcome is Outcome.UNDECIDED
    assert found.theta["r"] == pytest.approx(0.5 * 0.95**30)
    assert "Steps of EM went on in one direction" in found.message
    flat = Filters(lambda theta: -200.0 * np.log(theta["r"] / 0.5) ** 2, 0.1)
    assert looked_far(settled, flat, np.arange(2), 0, 10) is settled
