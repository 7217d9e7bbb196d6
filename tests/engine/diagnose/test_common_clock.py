"""What came at one time of all records' clocks is one event; what came in one of them has a time of its own."""

import numpy as np
import pytest

import engine
from engine.data.joined import in_turn, together
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.records import timed_like
from engine.diagnose.screening.score_columns import Projection, parameter_columns
from engine.diagnose.screening.time_scan import family_test
from engine.diagnose.search.common_clock import came_in_all
from engine.diagnose.search.pipeline import fit_base
from engine.filters.sigma_point import moment_path
from engine.presentation.diagnosis_document import as_dict
from service.validation import load
from tests.engine.diagnose.test_records_in_turn import DT, VESSEL

KINDS = ["step", "episode", "harmonic", "pulse"]
LONG = (120, 110, 140)
WHEN, UNTIL = 45 * DT, 65 * DT


def record(seed, T, heat, begins=0.0):
    """A vessel with a heat (degC/s) that nobody measured, by Euler's method at a tenth of the sampling time."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.0, 3.0, T // 20 + 1), 20)[:T]
    x, y, h = 20.0 + rng.standard_normal(), np.empty(T), DT / 10.0
    for k in range(T):
        y[k] = x + 0.2 * rng.standard_normal()
        for i in range(10):
            noise = 0.01 * np.sqrt(h) * rng.standard_normal()
            x += h * ((20.0 + 15.0 * u[k] - x) / 300.0 + heat(begins + k * DT + i * h)) + noise
    return engine.Series(y, u, t=begins + DT * np.arange(T))


def records(seed, heats, begins=(0.0, 0.0, 0.0)):
    return [
        record(10 * seed + k, *one) for k, one in enumerate(zip(LONG, heats, begins, strict=True))
    ]


def none(t):
    return 0.0


def step(t):
    return -0.006 * (t >= WHEN)


def episode(t):
    return -0.012 * (WHEN <= t < UNTIL)


def wave(t):
    return 0.006 * np.sin(2.0 * np.pi * t / (14.0 * DT))


def at_once(seed, heats, begins=(0.0, 0.0, 0.0)):
    given = records(seed, heats, begins)
    turned, clocks = together(in_turn(given)), together(given)
    fit = fit_base(VESSEL, turned, VESSEL.theta(), None)
    return came_in_all(fit, turned, clocks, KINDS, 0.05, 0)


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("heat", [step, episode, wave])
def test_an_event_of_all_records_is_told_from_one_of_one(heat, seed):
    assert at_once(seed, [heat] * 3)
    assert not at_once(seed, [none, heat, none])


@pytest.mark.long
def test_where_nothing_came_they_stay_in_turn():
    assert not any(at_once(seed, [none] * 3) for seed in (1, 2, 3))


@pytest.mark.long
@pytest.mark.parametrize("effect", KINDS)
def test_the_screen_is_that_of_the_extended_model(effect):
    """Its score is the slope of the log-likelihood, also where clocks overlap."""
    given = together(records(3, [wave] * 3))
    fit = fit_base(VESSEL, given, VESSEL.theta(), None)
    theta = np.asarray(fit.theta)
    path = moment_path(VESSEL, theta, given)
    setting = setting_for(VESSEL, given, theta)
    made = make_effect(f"{effect}:T", setting)
    projection = Projection(parameter_columns(VESSEL, theta, [], given))
    test = family_test(made, VESSEL, theta, given, path, projection)
    best = int(np.argmax(test.statistics(test.s.sum(axis=1))))
    extended, size = made.apply(VESSEL), 1e-6
    rows = np.array([[*theta, sign * size, *test.at[best]] for sign in (-1.0, 1.0)])
    low, high = engine.estimation.quasi_ml.log_likelihoods(extended, [given], rows)
    score = test.s.sum(axis=1)[best * (2 if effect == "harmonic" else 1)]
    assert score == pytest.approx((high - low) / (2.0 * size), rel=1e-3)


@pytest.mark.long
@pytest.mark.parametrize("begins", [(0.0, 0.0, 0.0), (0.0, 30 * DT, 12 * DT)])
def test_a_diagnosis_tells_its_time_by_the_clocks_as_given(begins):
    given = records(1, [step] * 3, begins)
    found = engine.diagnose(VESSEL, given, effects=[*KINDS, "bias"], seed=0)
    (cause,) = found.causes
    assert cause.effect == "step:T"
    assert found.theta["step_T_time"] == pytest.approx(WHEN, abs=6.0 * DT)
    assert cause.size == pytest.approx(-0.006, abs=3.0 * cause.standard_error)
    assert any("at one time in all of them" in note for note in found.notes)
    assert not any("came after the other" in note for note in found.notes)
    assert found.later == ()
    model = as_dict(found)["extension"]["model"] | {"name": "servo", "with": ["step:y"]}
    series = [{"y": one.y.tolist(), "u": one.u.tolist(), "t": one.t.tolist()} for one in given]
    made = load({"kind": "estimate", "model": model, "series": series})  # as a job of the extension
    assert [one.t[0] for one in made.series] == list(begins)


def test_times_that_differ_by_their_rounding_are_the_same():
    """0.3 + 0.1 is not 0.4: a step that comes at a row of the longest record would be a sample late."""
    main = engine.Series(np.zeros(90), dt=0.1)
    other = engine.Series(np.zeros(60), t=0.3 + 0.1 * np.arange(60))
    late = engine.Series(np.zeros(60), t=0.32 + 0.1 * np.arange(120)[::2])
    assert not np.isin(other.t, main.t).all()
    made = timed_like(other, main)
    np.testing.assert_array_equal(made.t, main.t[3:63])
    assert made.dt == pytest.approx(0.1)
    np.testing.assert_array_equal(timed_like(late, main).t, late.t)
