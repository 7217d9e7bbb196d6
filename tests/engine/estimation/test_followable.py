"""A sensor with next to no noise, whose reading depends on the state nonlinearly."""

import numpy as np
import pytest

import engine
from engine.estimation.e_steps import rbps_step
from engine.estimation.followable import GIVEN_AWAY, followable
from engine.estimation.likelihood_step import LikelihoodStep
from engine.estimation.quasi_ml import quasi_ml
from engine.statespace.model import Theta
from tests.engine.reservoir import RESERVOIR, record

SERIES = record(2, 150, 1e-6)


def asked(theta, start):
    moment = LikelihoodStep(RESERVOIR, [SERIES]).of
    particles = rbps_step(RESERVOIR, [SERIES], 50, 50, moment=moment)
    beside = followable(RESERVOIR, theta, start, np.arange(3), particles, seed=1)
    return beside, moment, particles


@pytest.mark.long
def test_a_maximum_that_particles_cannot_follow_is_left_for_a_point_as_likely():
    start = RESERVOIR.theta()
    peak = quasi_ml(RESERVOIR, [SERIES], start).theta
    beside, moment, particles = asked(peak, start)
    assert peak["r"] == 1e-10
    assert not particles.follow(peak, np.random.default_rng(5))
    assert particles.follow(beside, np.random.default_rng(5))
    assert beside["r"] > 1e-6
    assert (beside["k"], beside["q"]) == (peak["k"], peak["q"])
    assert moment(beside) >= moment(peak) - GIVEN_AWAY


def test_a_point_that_particles_follow_is_kept():
    start = RESERVOIR.theta()
    theta = Theta(np.array([0.02, 0.5, 1e-3]), start.names)
    assert asked(theta, start)[0] is theta
    at_bound = Theta(np.array([0.02, 100.0, 1e-3]), start.names)
    assert asked(at_bound, start)[0] is at_bound


@pytest.mark.slow
def test_em_ends_at_the_maximum_where_the_sensor_has_next_to_no_noise():
    """It ended 6 nats below, as particles lost the series at the start that was found."""
    found = engine.rbps_em(RESERVOIR, SERIES, seed=1, n_iterations=40)
    filters = [
        engine.rbpf(RESERVOIR, found.theta, SERIES, 400, np.random.default_rng(i)) for i in range(4)
    ]
    highest = quasi_ml(RESERVOIR, [SERIES]).log_likelihood
    assert np.mean([one.log_likelihood for one in filters]) > highest - 2.0
