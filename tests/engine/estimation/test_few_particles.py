"""Particles too few to follow a series: more are taken, and iterates that wander off are not an estimate."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import engine
from engine import Outcome, get_model
from engine.estimation import e_steps
from engine.estimation.e_steps import rbps_step
from engine.estimation.likelihood_step import LikelihoodStep
from engine.estimation.quasi_ml import quasi_ml
from engine.estimation.wandering import kept_best, moved_ahead
from engine.filters.lost import FAR_NATS
from engine.words import held_by_bounds

OSCILLATOR = get_model("oscillator")
QUIET = OSCILLATOR.theta({"sigma_v": 1e-6, "sigma_y": 1e-3})
PUSH = np.sin(0.7 * np.arange(60))


def swung(seed):
    """Next to no process noise, an unknown first velocity: one particle of t = 1 is followed to the end."""
    rng = np.random.default_rng(seed)
    return engine.simulate(OSCILLATOR, QUIET, 60, rng, PUSH, dt=0.05).series


def test_a_filter_that_falls_short_is_run_with_more_particles():
    """The model is linear, so that its moment filter is exact; 4 particles are up to 180 nats below it."""
    series = swung(0)
    moment = LikelihoodStep(OSCILLATOR, [series]).of
    step = rbps_step(OSCILLATOR, [series], 4, 4, moment=moment)
    exact, short, kept = moment(QUIET), 0, 0
    for seed in range(8):
        few, more = (
            run(QUIET, np.random.default_rng(seed)) for run in (step.__call__, step.compared)
        )
        short += few.log_likelihood < exact - FAR_NATS
        kept += more.log_likelihood >= exact - FAR_NATS
        assert more.times >= few.times
        if few.log_likelihood >= exact - FAR_NATS:
            assert more.log_likelihood == few.log_likelihood  # the same bits, with the same numbers
        else:
            assert more.times > 1
    assert short >= 3
    assert kept > 8 - short


def test_the_bias_of_a_long_series_is_no_shortfall():
    """Half the variance of the log-likelihood, which grows with the rows: more than 20 nats here."""
    start, rng = OSCILLATOR.theta({"sigma_v": 1.0}), np.random.default_rng(1)
    series = engine.simulate(
        OSCILLATOR, start, 3000, rng, np.sin(0.7 * np.arange(3000)), dt=0.3
    ).series
    moment = LikelihoodStep(OSCILLATOR, [series]).of
    step = rbps_step(OSCILLATOR, [series], 10, 2, moment=moment)
    found = step.compared(start, np.random.default_rng(2))
    assert found.log_likelihood < moment(start) - FAR_NATS
    assert found.times == 1


@pytest.mark.slow
def test_enough_particles_are_left_alone():
    rng, start = np.random.default_rng(1), {"sigma_v": 1.0}
    series = engine.simulate(OSCILLATOR, start, 60, rng, PUSH, dt=0.3).series
    options = {"n_particles": 30, "n_iterations": 4, "seed": 2}
    plain, careful = (
        engine.rbps_em(OSCILLATOR, series, start, recover=recover, **options)
        for recover in (False, True)
    )
    np.testing.assert_array_equal(plain.trace, careful.trace)
    assert plain.message == careful.message


def runs(**more):
    """From the truth with 8 particles on three series: the exact gain of each, nats, and the result."""
    for seed in (1, 4, 5):
        series = swung(seed)
        of = LikelihoodStep(OSCILLATOR, [series]).of
        options = {"n_particles": 8, "n_iterations": 12, "seed": seed} | more
        found = engine.rbps_em(OSCILLATOR, series, QUIET, ("omega", "zeta", "sigma_y"), **options)
        last = OSCILLATOR.theta(found.trace[-1])
        yield of(found.theta) - of(QUIET), of(last) - of(QUIET), found


@pytest.mark.slow
def test_a_start_is_not_left_for_what_is_far_less_likely():
    blind = [gain for gain, _, _ in runs(recover=False)]
    assert min(blind) < -2.0 * FAR_NATS  # iterations as the paper has them
    found = list(runs())
    assert min(gain for gain, _, _ in found) > -FAR_NATS
    assert any("times the particles" in result.message for _, _, result in found)


@pytest.mark.slow
def test_where_more_particles_cannot_be_had_it_says_which_filter_says_what(monkeypatch):
    monkeypatch.setattr(e_steps, "RETRIES", ())
    fell = 0
    for _, last, result in runs():
        assert ("By the moment filter" in result.message) == (last < -FAR_NATS)
        fell += last < -FAR_NATS
    assert fell


@pytest.mark.long
def test_iterates_that_wandered_off_are_not_the_estimate():
    """Of which the last is far less likely than those before it, by both filters."""
    trace = np.array([QUIET, QUIET, QUIET])
    trace[2, OSCILLATOR.index("sigma_y")] = 0.1
    even = np.ones(2)
    before = engine.Checkpoint(trace, 300.0 * even, 20.0 * even, even, 0.0 * even)
    options = {"n_particles": 30, "n_iterations": 2, "free": ("omega", "sigma_y")}
    for method in ("em", "quasi-newton"):
        found = engine.rbps_em(OSCILLATOR, swung(0), resume=before, method=method, **options)
        assert found.outcome is Outcome.WANDERED
        assert found.outcome.success  # what is kept is an estimate
        assert found.message.startswith("Wandered off: ")
        np.testing.assert_array_equal(found.theta, QUIET)
        np.testing.assert_array_equal(found.trace, trace)


def outlying():
    """A model of the outliers that its series has, written so that the moment filter is not told of them."""
    rng = np.random.default_rng(0)
    noise = np.where(rng.random(150) < 0.08, 10.0, 1.0)
    y = np.cumsum(0.3 * rng.standard_normal(150)) + noise * rng.standard_normal(150)
    model = engine.with_student_t(get_model("local-level"))
    return replace(model, random_scales=()), engine.Series(y)


@pytest.mark.long
def test_a_moment_filter_that_is_wrong_has_no_say():
    """It takes outliers for a large variance; the particle filter follows both and knows better."""
    model, series = outlying()
    wide, heavy = model.theta([0.1, 8.0, 0.0, 100.0]), model.theta([0.1, 0.4, 0.0, 1.7])
    of = LikelihoodStep(model, [series]).of
    assert of(wide) > of(heavy) + FAR_NATS
    even = np.ones(2)
    before = engine.Checkpoint(np.array([wide, wide, heavy]), -400.0 * even, even, even, 0.0 * even)
    found = engine.rbps_em(model, series, resume=before, n_particles=30, n_iterations=2)
    assert found.outcome is Outcome.ITERATIONS_USED_UP
    assert "moment filter" not in found.message
    np.testing.assert_array_equal(found.theta, heavy)


@pytest.mark.long
@pytest.mark.parametrize("seed", [3, pytest.param(6, marks=pytest.mark.slow)])
def test_an_estimate_moves_to_what_both_filters_find_likelier(seed):
    """The scores of few particles are far off with next to no process noise; the moment filter is exact."""
    series, free = swung(seed), ("omega", "zeta", "sigma_y")
    of = LikelihoodStep(OSCILLATOR, [series]).of
    most = quasi_ml(OSCILLATOR, series, QUIET, free).log_likelihood
    found = engine.rbps_em(OSCILLATOR, series, QUIET, free, n_particles=20, seed=seed)
    assert of(OSCILLATOR.theta(found.trace[-1])) < most - 1.0
    assert of(found.theta) > most - 0.5
    assert re.search(r"exact likelihood, 1\d nats above", found.message)


@pytest.mark.long
def test_an_estimate_stays_where_only_the_moment_filter_wants_to_go():
    """It takes outliers for a large variance, and would move to it from the particles' estimate."""
    model, series = outlying()
    heavy = model.theta([0.1, 0.4, 0.0, 1.7])
    likelihood = LikelihoodStep(model, [series])
    assert likelihood.ahead(heavy, model.parameter_names)[1] > FAR_NATS
    at = engine.EmResult(
        model, model.parameter_names, heavy, np.array([heavy]), *np.zeros((4, 0)),
        Outcome.CONVERGED, Outcome.CONVERGED.value,
    )  # fmt: skip
    found = moved_ahead(at, likelihood, rbps_step(model, [series], 30, 30), 0)
    assert found is at


@pytest.mark.long
@pytest.mark.parametrize(
    ("bounds", "moved"), [((0.1, 5.0), 0.1), pytest.param((0.0, 0.2), 0.05, marks=pytest.mark.slow)]
)
def test_the_bounds_told_are_those_of_where_an_estimate_has_moved_to(bounds, moved):
    """From zeta = 0.2, at its bound or not, to its lower bound or to the truth, 0.05."""
    parameters = [
        replace(p, bounds=bounds, default=0.2) if p.name == "zeta" else p
        for p in OSCILLATOR.parameters
    ]
    model, rng = replace(OSCILLATOR, parameters=parameters), np.random.default_rng(3)
    truth = {"sigma_v": 0.3, "zeta": 0.05}
    series = engine.simulate(
        OSCILLATOR, truth, 200, rng, np.sin(0.7 * np.arange(200)), dt=0.1
    ).series
    here = model.theta({**truth, "zeta": 0.2})
    told = held_by_bounds(model.at_bounds(here, ("zeta",)))
    assert bool(told) == (bounds[1] == 0.2)
    at = engine.EmResult(
        model, ("zeta",), here, np.array([here]), *np.zeros((4, 0)),
        Outcome.CONVERGED, f"{Outcome.CONVERGED.value} {told}".rstrip(),
    )  # fmt: skip
    particles = rbps_step(model, [series], 200, 2)
    found = moved_ahead(at, LikelihoodStep(model, [series]), particles, 0)
    assert found.theta["zeta"] == pytest.approx(moved, rel=0.3)
    assert ("Stopped by a bound" in found.message) == (moved == 0.1)


@pytest.mark.parametrize(("larger", "kept"), [(1.8, True), (1.02, False)])
def test_an_iterate_that_is_clearly_likelier_than_the_last_is_the_estimate(larger, kept):
    """The last noise is too large, by a few nats or by next to nothing, whatever one filter said of it."""
    series = swung(0)
    last = OSCILLATOR.theta({**QUIET.asdict(), "sigma_y": larger * QUIET["sigma_y"]})
    of = LikelihoodStep(OSCILLATOR, [series]).of
    assert (of(QUIET) - of(last) > 4.0) == kept
    even = np.ones(2)
    at = engine.EmResult(
        OSCILLATOR, ("sigma_y",), last, np.array([QUIET, last, last]), np.array([200.0, 195.0]),
        even, even, 0.0 * even, Outcome.ITERATIONS_USED_UP, Outcome.ITERATIONS_USED_UP.value,
    )  # fmt: skip
    found = kept_best(at, rbps_step(OSCILLATOR, [series], 400, 2), 0)
    np.testing.assert_array_equal(found.theta, QUIET if kept else last)
    assert ("The estimate is iterate 0" in found.message) == kept
    assert ("which did not end at the estimate" in str(found)) == kept


@pytest.mark.parametrize("scatter", [3000.0, 10.0, 0.0])
def test_a_likelier_point_that_particles_cannot_judge_is_told_and_nothing_has_converged(scatter):
    """With filters that scatter by 10 nats or more; by others the estimate stays, and is one."""
    series = swung(0)
    at = OSCILLATOR.theta({**QUIET.asdict(), "sigma_y": 1.5 * QUIET["sigma_y"]})
    settled = engine.EmResult(
        OSCILLATOR, ("sigma_y",), at, np.array([at]), *np.zeros((4, 0)),
        Outcome.CONVERGED, Outcome.CONVERGED.value,
    )  # fmt: skip

    class Scattered:
        n_particles, moment = 50, None

        def log_likelihood(self, theta, times, rng):
            return 100.0 + scatter * rng.standard_normal()

    found = moved_ahead(settled, LikelihoodStep(OSCILLATOR, [series]), Scattered(), 0)
    if not scatter:
        assert found is settled
        return
    assert found.outcome is Outcome.UNDECIDED
    assert found.message.startswith("Settled, but perhaps short of the maximum")
    assert ("lose the series there" in found.message) == (scatter > 100.0)
    assert "sigma_y = " in found.message
    told = float(found.message.split("sigma_y = ")[1].split(". ")[0])
    assert told == pytest.approx(QUIET["sigma_y"], rel=0.2)
    np.testing.assert_array_equal(found.theta, at)
