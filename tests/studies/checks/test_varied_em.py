"""RBPS-EM with parts of the loop changed: unchanged it is the engine's, bit for bit; M steps stopped early."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import OptionError
from engine.estimation.e_steps import rbps_step
from engine.estimation.em import rbps_em
from engine.estimation.maximization import maximize
from engine.models.registry import get_model
from engine.simulation.simulate import simulate
from tests.studies.em_arms import PAPER
from tests.studies.guarded_em import guarded_ps_em
from tests.studies.stopped import Point, stopped_bfgs
from tests.studies.varied_em import varied_em

MODEL = get_model("mixed-4")
START = {"theta_2": 0.6, "theta_4": 0.9, "theta_5": 0.5}
ALL = np.arange(5)
SMALL = {"n_particles": 20, "n_iterations": 3, "seed": 5}


@pytest.fixture(scope="module")
def series():
    return simulate(MODEL, None, 40, np.random.default_rng(1)).series


@pytest.fixture(scope="module")
def q(series):
    expect = rbps_step(MODEL, [series], 20, 20)
    return expect(MODEL.theta(START), np.random.default_rng(2)).q


def test_without_a_change_it_is_em_with_the_papers_settings(series):
    ours = varied_em(MODEL, series, START, n_trajectories=20, **SMALL)
    settings = {**PAPER["rbps"], "m_step": "scoring", "n_trajectories": 20, **SMALL}
    engines = rbps_em(MODEL, series, START, method="em", **settings)
    np.testing.assert_array_equal(ours.trace, engines.trace)


@pytest.mark.parametrize("run", [varied_em, guarded_ps_em])
def test_one_iteration_is_a_step_along_the_gradient(run, series, monkeypatch):
    seen = []

    def noting(q, theta, free, iterations):
        to = stopped_bfgs(q, theta, free, iterations)
        seen.append((q.derivatives(theta, free)[1], to - theta, q.value(to) - q.value(theta)))
        return to

    monkeypatch.setattr("tests.studies.stopped.stopped_bfgs", noting)
    result = run(MODEL, series, START, m_step_iterations=1, **SMALL)
    assert len(seen) == SMALL["n_iterations"]
    for (gradient, step, gain), taken in zip(seen, np.diff(result.trace, axis=0), strict=True):
        cosine = gradient @ step / np.linalg.norm(gradient) / np.linalg.norm(step)
        assert cosine == pytest.approx(1.0, abs=1e-9)
        assert gain > 0.0
        np.testing.assert_allclose(taken, step, atol=1e-8)


def test_many_iterations_reach_the_maximum(q):
    theta = np.asarray(MODEL.theta(START))
    best = q.value(maximize(q, theta, ALL))
    short = best - q.value(stopped_bfgs(q, theta, ALL, 1))
    assert short > 0.01
    assert best - q.value(stopped_bfgs(q, theta, ALL, 200)) == pytest.approx(0.0, abs=1e-4)


def test_parameters_that_are_not_free_stay(q):
    theta = np.asarray(MODEL.theta(START))
    to = stopped_bfgs(q, theta, np.array([1, 4]), 3)
    np.testing.assert_array_equal(to[[0, 2, 3]], theta[[0, 2, 3]])
    assert (to[[1, 4]] != theta[[1, 4]]).all()


def test_a_point_is_where_the_m_step_goes():
    theta = np.asarray(MODEL.theta(START))
    to = theta + np.array([1e-8, 0.2, -0.1, 0.05, 1e-6])
    np.testing.assert_allclose(maximize(Point(MODEL, to), theta, ALL), to, atol=1e-12)


def test_common_numbers_are_those_of_every_iteration(series):
    two = varied_em(MODEL, series, START, n_trajectories=20, common_numbers=True, **SMALL)
    values = {}
    for common in (True, False):
        again = varied_em(
            MODEL, series, two.trace[1], n_trajectories=20, common_numbers=common, **SMALL
        )
        values[common] = again.log_likelihood[0]
    assert values[True] == two.log_likelihood[1]
    assert values[False] != two.log_likelihood[1]


def test_a_negative_number_of_iterations_is_refused(series):
    with pytest.raises(OptionError, match="negative"):
        varied_em(MODEL, series, START, m_step_iterations=-1)
