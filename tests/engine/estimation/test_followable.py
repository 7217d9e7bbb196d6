"""A sensor with next to no noise, whose reading depends on the state nonlinearly."""

import numpy as np

import engine
from engine import Parameter
from engine.estimation.e_steps import rbps_step
from engine.estimation.followable import GIVEN_AWAY, followable
from engine.estimation.likelihood_step import LikelihoodStep
from engine.estimation.quasi_ml import quasi_ml
from engine.statespace.model import Theta

DAYS, DT = 150, 0.05
TRUTH = {"k": 0.02, "q": 0.5, "r": 1e-6}
RESERVOIR = engine.continuous(
    name="reservoir",
    drift=lambda a, u, t, theta: ([u[0] - outflow(a, theta)], None),
    diffusion=lambda a, u, t, theta: [[theta.q]],
    measurement=lambda a, u, t, theta: ([outflow(a, theta)], None, [[theta.r]]),
    initial=lambda theta: (engine.Gaussian([30.0], [[25.0]]), [], np.zeros((0, 0))),
    nonlinear={"store": "mm"},
    inputs={"rain": "mm/d"},
    outputs={"flow": "mm/d"},
    parameters=[
        Parameter("k", 0.03, "1", (1e-4, 1.0)),
        Parameter("q", 1.0, "mm^2/d", (1e-6, 100.0)),
        Parameter("r", 0.1, "(mm/d)^2", (1e-10, 100.0)),
    ],
)


def outflow(a, theta):
    return theta.k * np.maximum(a[:, 0], 0.0) ** 1.5


def record(seed):
    rng = np.random.default_rng(seed)
    rain = np.where(rng.random(DAYS) < 0.3, rng.gamma(0.8, 12.0, DAYS), 0.0)
    store, flow = 30.0, np.empty(DAYS)
    for day in range(DAYS):
        flow[day] = TRUTH["k"] * max(store, 0.0) ** 1.5
        for _ in range(round(1.0 / DT)):
            store += DT * (rain[day] - TRUTH["k"] * max(store, 0.0) ** 1.5)
            store += np.sqrt(TRUTH["q"] * DT) * rng.standard_normal()
    y = flow + np.sqrt(TRUTH["r"]) * rng.standard_normal(DAYS)
    return engine.Series(y, u=rain, t=np.arange(DAYS, dtype=float), time_unit="d")


def asked(theta, start):
    series = record(2)
    moment = LikelihoodStep(RESERVOIR, [series]).of
    particles = rbps_step(RESERVOIR, [series], 50, 50, moment=moment)
    beside = followable(RESERVOIR, theta, start, np.arange(3), particles, seed=1)
    return beside, moment, particles


def test_a_maximum_that_particles_cannot_follow_is_left_for_a_point_as_likely():
    start = RESERVOIR.theta()
    peak = quasi_ml(RESERVOIR, [record(2)], start).theta
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


def test_em_ends_at_the_maximum_where_the_sensor_has_next_to_no_noise():
    """It ended 6 nats below, as particles lost the series at the start that was found."""
    series = record(2)
    found = engine.rbps_em(RESERVOIR, series, seed=1, n_iterations=40)
    filters = [
        engine.rbpf(RESERVOIR, found.theta, series, 400, np.random.default_rng(i)) for i in range(4)
    ]
    highest = quasi_ml(RESERVOIR, [series]).log_likelihood
    assert np.mean([one.log_likelihood for one in filters]) > highest - 2.0
