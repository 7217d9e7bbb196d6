"""Where the likelihood is exact an estimation ends at its maximum, from starts with next to no noise, too."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine import Gaussian, MixedModel, Outcome, Parameter
from engine.estimation.likelihood_step import LikelihoodStep
from engine.estimation.quasi_ml import quasi_ml
from engine.estimation.summit import Summit
from tests.engine.models_for_tests import random_walk


def trend(na=0):
    """A level with a damped slope; the level is nonlinear by name where ``na`` is 1."""

    def dynamics(a, u, t, dt, th):
        level = [a[:, 0], 0.0] if na else [0.0, 0.0]
        A = [[0.7], [th.phi]] if na else [[1.0, 0.7], [0.0, th.phi]]
        return level, A, [[th.q, 0.0], [0.0, th.s]]

    def measurement(a, u, t, th):
        return ([a[:, 0]], [[0.0]], [[th.r]]) if na else ([0.0], [[1.0, 0.0]], [[th.r]])

    def initial(th):
        if na:
            return Gaussian([0.0], [[1.0]]), [0.0], [[1.0]]
        return None, [0.0, 0.0], np.eye(2)

    states = {"level": "", "slope": ""}
    return MixedModel(
        name="trend",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        nonlinear={"level": ""} if na else {},
        linear={"slope": ""} if na else states,
        outputs={"y": ""},
        parameters=[
            Parameter("phi", 0.5, "", (-1.0, 1.0)),
            Parameter("q", 0.1, "", (0.0, 100.0)),
            Parameter("s", 0.1, "", (0.0, 100.0)),
            Parameter("r", 0.1, "", (0.0, 100.0)),
        ],
    )


TRUTH = {"phi": 0.8, "q": 0.6, "s": 0.2, "r": 0.3}
START = {"phi": 0.4, "q": 1.0, "s": 1.0, "r": 1.0}


@pytest.fixture(scope="module")
def measured():
    return engine.simulate(trend(), TRUTH, 300, np.random.default_rng(4)).series


@pytest.mark.long
@pytest.mark.parametrize("options", [{"n_iterations": 2}, {"n_iterations": 45, "method": "em"}])
def test_a_run_that_was_left_does_not_say_that_the_data_ask_for_no_noise(measured, options):
    found = engine.rts_em(trend(), measured.part(0, 60), {**START, "q": 1e-9, "s": 1e-9}, **options)
    assert found.theta["q"] < 1e-6
    assert "data ask for no" not in found.message


@pytest.fixture(scope="module")
def highest(measured):
    return quasi_ml(trend(), measured, TRUTH, tolerance=1e-8).log_likelihood


def height(theta, series):
    return LikelihoodStep(trend(), [series]).of(trend().theta(dict(theta.asdict())))


@pytest.mark.long
@pytest.mark.parametrize(
    "little",
    [
        pytest.param({"q": 1e-9, "s": 1e-9}, marks=pytest.mark.slow),
        {"q": 1e-9},
        {"r": 1e-4},
        {"r": 1e-8},
    ],
)
def test_a_start_with_next_to_no_noise_is_left_for_the_maximum(measured, highest, little):
    """They "stood still", tens of nats short, and the data seemed to ask for no noise."""
    found = engine.rts_em(trend(), measured, {**START, **little})
    assert found.outcome is Outcome.CONVERGED
    assert height(found.theta, measured) == pytest.approx(highest, abs=0.02)


def test_what_the_data_ask_none_of_is_still_said_to_be_at_its_bound():
    model = replace(trend(), parameters=[*trend().parameters[:3], Parameter("r", 0.1, "", (0, 9))])
    series = engine.simulate(model, {**TRUTH, "r": 0.0}, 60, np.random.default_rng(1)).series
    found = engine.rts_em(model, series, {**START, "r": 0.0}, ["r"])
    larger = [{**START, "r": r} for r in (1e-6, 1e-3, 0.1)]
    likelihood = LikelihoodStep(model, [series])
    least = max(likelihood.of(model.theta(one)) for one in larger)
    assert likelihood.of(found.theta) >= least - 0.01


@pytest.mark.long
def test_an_estimate_next_to_no_noise_is_moved_where_more_of_it_is_likelier(measured, highest):
    model = trend()
    found = engine.rts_em(model, measured, START, n_iterations=1)
    still = replace(found, theta=model.theta({**START, "q": 0.0, "s": 0.0}))
    summit = Summit(LikelihoodStep(model, [measured], exact=True, worth=1e-8), 0.0, checked=True)
    moved = summit(still)
    assert height(moved.theta, measured) == pytest.approx(highest, abs=0.02)
    assert "maximum of its exact likelihood" in moved.message
    assert summit(moved) is moved


@pytest.mark.slow
def test_particles_of_a_linear_model_end_at_the_exact_maximum(measured, highest):
    """On a flat ridge they settled anywhere within a nat."""
    found = engine.rbps_em(trend(1), measured, n_particles=10)
    assert found.outcome is Outcome.CONVERGED
    assert height(found.theta, measured) > highest - 20.0 * 1e-3 * 4
    again = engine.rbps_em(trend(1), measured, n_particles=10, resume=found)
    np.testing.assert_array_equal(again.theta, found.theta)
    assert again.message == found.message


def test_a_higher_maximum_that_is_known_is_taken(measured, highest):
    model = trend()
    likelihood = LikelihoodStep(model, [measured], exact=True, worth=1e-8)
    found = engine.rts_em(model, measured, START, ["phi", "r"], n_iterations=1)
    there = quasi_ml(model, measured, TRUTH).theta
    moved = Summit(likelihood, 0.1, lambda: [there], checked=True)(found)
    assert height(moved.theta, measured) == pytest.approx(highest, abs=0.05)


def test_a_model_that_is_not_linear_has_no_summit():
    model = engine.get_model("mixed-4")
    series = engine.simulate(model, None, 30, np.random.default_rng(0)).series
    assert not Summit(LikelihoodStep(model, [series]), 0.1).serves(model.theta())
    linear = random_walk()
    series = engine.simulate(linear, None, 30, np.random.default_rng(0)).series
    assert Summit(LikelihoodStep(linear, [series]), 0.1).serves(linear.theta())
