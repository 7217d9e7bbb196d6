"""An estimate that rests on filters which lost the series is not said to have converged."""

import math
from dataclasses import replace

import numpy as np
import pytest

import engine
from engine import Gaussian, MixedModel, Outcome, Parameter
from engine.estimation.scattered import filters_that_fell
from tests.engine.models_for_tests import random_walk
from tests.engine.plain_models import tank


def settled(values, ess=10.0):
    """A settled run whose filters had these log-likelihoods."""
    series = engine.simulate(random_walk(), None, 30, np.random.default_rng(0)).series
    run = engine.rts_em(random_walk(), series, n_iterations=1)
    n, outcome = len(values), Outcome.CONVERGED
    return replace(
        run,
        trace=np.repeat(run.trace[-1:], n + 1, axis=0),
        log_likelihood=np.array(values, dtype=float),
        ess=np.full(n, ess),
        outcome=outcome,
        message=outcome.value,
    )


def test_filters_far_below_others_next_to_the_same_parameters_have_lost_the_series():
    found = filters_that_fell(settled([-900.0] + [-510.0, -512.0, -598.0, -511.0] * 2), 8, 200, 50)
    assert found.outcome is Outcome.UNDECIDED
    assert "2 of the last 8 iterations ended more than 31 nats below" in found.message
    assert "50 particles lose the series" in found.message


@pytest.mark.parametrize(
    ("values", "last"),
    [
        ([-900.0] + [-510.0, -521.0, -515.0, -511.0] * 2, 8),  # the way there does not count
        ([-510.0] * 19 + [-600.0], 20),  # nor does one alone
        ([-510.0] * 6 + [-600.0], 7),
        ([-510.0] * 4, 0),
        ([], 0),
    ],
)
def test_the_scatter_of_filters_that_follow_tells_nothing(values, last):
    run = settled(values)
    assert filters_that_fell(run, last, 200, 50) is run
    lost = replace(settled([-510.0, -598.0] * 4), outcome=Outcome.COLLAPSED)
    assert filters_that_fell(lost, 8, 200, 50) is lost


def two_valued():
    """A state that is read by its square alone, and is driven from one side to the other."""
    return MixedModel(
        name="growth",
        dynamics=lambda a, u, t, dt, th: (
            [0.5 * a[:, 0] + 25.0 * a[:, 0] / (1.0 + a[:, 0] ** 2) + 8.0 * math.cos(1.2 * t)],
            np.zeros((1, 0)),
            [[th.q]],
        ),
        measurement=lambda a, u, t, th: ([a[:, 0] ** 2 / 20.0], np.zeros((1, 0)), [[th.r]]),
        initial=lambda th: (Gaussian([0.0], [[5.0]]), [], np.zeros((0, 0))),
        nonlinear={"x": ""},
        outputs={"y": ""},
        parameters=[Parameter("q", 10.0, "", (1e-3, 50.0)), Parameter("r", 1.0, "", (1e-3, 50.0))],
    )


def test_a_run_that_begins_at_a_far_start_and_settles_at_once_has_converged():
    """Of its first iteration the log-likelihood is that of the start, 50 nats below."""
    u = np.repeat(np.random.default_rng(1).uniform(0.0, 6.0, 10), 10)
    series = engine.simulate(tank(), None, 100, np.random.default_rng(0), u=u, dt=0.2).series
    found = engine.rbps_em(tank(), series, {"pump": 0.8, "outlet": 1.5}, n_particles=30)
    assert np.ptp(found.log_likelihood[1:]) < 20.0 < np.ptp(found.log_likelihood)
    assert found.outcome is Outcome.CONVERGED


@pytest.mark.slow
def test_few_particles_for_a_state_of_two_likely_values_are_told():
    """It "converged" while log-likelihoods of the last filters were between -684 and -510."""
    series = engine.simulate(two_valued(), None, 50, np.random.default_rng(2)).series
    found = engine.rbps_em(two_valued(), series, n_particles=10, warm_start=False)
    assert found.outcome is not Outcome.CONVERGED
