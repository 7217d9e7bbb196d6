"""Estimates of a model written by Euler's rule are told to be those of its steps, by all that estimates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.estimation.outcome import Outcome
from engine.estimation.own_steps import about_own_steps
from tests.engine.diagnose.test_own_steps import EULER, EXACT, record

HALVES = "two steps of half the length"
QUICK = {"n_particles": 10, "n_iterations": 2, "warm_start": False}
AT_LONG = {
    "K": 676.3,
    "T": 0.3325,
    "r": 61.4,
}  # the maximum by Euler's rule; K = 900, T = 0.25 s are right
AT_EXACT = {"K": 899.3, "T": 0.25007, "r": 61.4}


def about(model, theta, series, free=("K", "T", "r")):
    return about_own_steps(model, model.theta(theta), free, series)


@pytest.mark.long
def test_a_lag_by_eulers_rule_is_told_of_one_record_and_of_several():
    series = record()
    for listed in ([series], [series, record(noise=8.01)]):
        assert "T would be 0.289 s instead of 0.333 s" in about(EULER, AT_LONG, listed)


@pytest.mark.long
def test_it_is_told_where_the_first_of_several_records_is_at_rest():
    """That one alone was asked, and whether a word was said depended on the order of the list."""
    idle = record().part(0, 30)
    idle = idle.replace(y=0.0 * idle.y, u=0.0 * idle.u)
    for listed in ([record(), idle], [idle, record()]):
        assert HALVES in about(EULER, AT_LONG, listed)


def test_nothing_is_said_of_exact_steps_nor_of_what_is_held_nor_of_other_estimates():
    series = record()
    assert about(EXACT, AT_EXACT, [series]) == ""
    assert about(EULER, AT_LONG, [series], free=["r"]) == ""
    assert about(EULER, {**AT_LONG, "T": 0.25}, [series]) == ""  # far from what is compared


@pytest.mark.long
def test_estimations_say_so():
    """T was 0.333 +- 0.0003 s where 0.25 s is right, without a word."""
    series = record()
    assert HALVES in engine.rbps_em(EULER, series, AT_LONG, **QUICK).message
    assert HALVES in engine.rts_em(EULER, series, AT_LONG, n_iterations=2).message
    assert HALVES not in engine.rts_em(EXACT, series, AT_EXACT, n_iterations=2).message


@pytest.mark.long
def test_standard_errors_say_so():
    errors = engine.standard_errors(EULER, AT_LONG, record())
    assert HALVES in errors.note
    assert HALVES in str(errors)


@pytest.mark.long
def test_fits_of_the_simulation_say_so():
    series = record()
    said = engine.fit_simulation(EULER, series, n_starts=0).message
    assert "T would be 0.289 s instead of 0.333 s" in said
    assert HALVES not in engine.fit_simulation(EXACT, series, n_starts=0).message


@pytest.mark.long
def test_what_the_message_of_an_estimation_said_is_not_said_twice():
    series = record()
    found = engine.rts_em(EULER, series, AT_LONG, n_iterations=2)
    unsure = replace(found, outcome=Outcome.UNDECIDED)
    errors = engine.standard_errors(EULER, unsure, series)
    assert "It said: " in errors.warning
    assert str(errors).count(HALVES) == 1


@pytest.mark.long
@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_units_change_nothing(unit):
    series = record()
    own = engine.MixedModel(
        name="motor",
        dynamics=lambda a, u, t, dt, th: (
            [unit * dt * th.K * u[0]],
            [[1.0 - dt / th.T]],
            [[unit**2]],
        ),
        measurement=lambda a, u, t, th: ([0.0], [[1.0]], [[unit**2 * th.r]]),
        initial=lambda th: (None, [0.0], [[unit**2]]),
        linear={"speed": ""},
        inputs={"voltage": "V"},
        outputs={"tacho": ""},
        parameters=EULER.parameters,
    )
    moved = engine.Series(unit * series.y, u=series.u, t=series.t)
    assert about(own, AT_LONG, [moved])[:200] == about(EULER, AT_LONG, [series])[:200]
    assert np.isfinite(moved.y).all()
