"""Records that begin elsewhere than the model says."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from engine.data.joined import joined
from engine.data.series import Series
from engine.diagnose.effects.catalogue import extend
from engine.diagnose.first_states import anywhere, begins_as_expected
from engine.diagnose.gain.gain import ELSEWHERE, measure_gain
from engine.diagnose.gain.narrowing import with_noise_of
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.statespace.model import Gaussian
from tests.engine.diagnose.test_laboratory_heater import CUT, HEATER, heater, readings


@dataclass(frozen=True)
class Pair:
    """What of a search counts here."""

    base: QuasiFit
    final: QuasiFit


def parts(seed):
    u, y = readings(seed)
    t = np.arange(len(y))
    return [Series(y=y[i], u=u[i], t=t[i]) for i in (slice(CUT), slice(CUT, None))]


pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def fits():
    train, _ = parts(21)
    slow = extend(HEATER, ["slow-sensor:sensor"])
    near = {"tau": 145.0, "gain": 0.72, "room": 23.5, "q": 0.01, "r": 0.13}
    base = quasi_ml(HEATER, train, near)
    free = [name for name in slow.parameter_names if not name.endswith(("_digital", "_noise"))]
    return base, quasi_ml(slow, train, {**near, "slow_sensor_sensor": 20.0}, free)


def test_a_record_from_the_middle_does_not_begin_as_expected(fits):
    train, test = parts(21)
    theta = np.asarray(fits[0].theta)
    assert begins_as_expected(HEATER, theta, train)
    assert not begins_as_expected(HEATER, theta, test)


def test_both_models_begin_it_anywhere_that_the_record_has_been(fits):
    train, test = parts(21)
    wide = anywhere(*fits, train)
    assert all(begins_as_expected(fit.model, np.asarray(fit.theta), test) for fit in wide)
    start = wide[1].model.start(wide[1].model.record(wide[1].theta))
    assert (
        start.linear(np.zeros((1, start.density.mean.size)))[1].min() > 1.0
    )  # what the sensor is behind


def test_what_a_test_gains_does_not_depend_on_whether_it_is_told_where_it_goes_on(fits):
    """The same rows with their own times, and as a record by itself: alike but for the first few."""
    train, later = parts(21)
    by_itself = Series(y=later.y, u=later.u, dt=1.0)
    going_on = measure_gain(*fits, [later], records=[train])
    apart = measure_gain(*fits, [by_itself], records=[train])
    assert ELSEWHERE not in going_on.notes
    assert ELSEWHERE in apart.notes
    assert abs(apart.log_density - going_on.log_density) < 15.0
    runs = [gain.outputs[0].rmse_after for gain in (going_on, apart)]
    assert abs(runs[0] - runs[1]) < 0.1


def test_noise_of_all_records_leaves_all_else_as_it_was(fits):
    """One that leaves nothing to noise is given as much as the held-out rows show; and no more is fitted."""
    train, later = parts(21)
    final = replace(fits[1], theta=fits[1].model.theta(fits[1].theta.asdict() | {"q": 1e-5}))
    warmer = later.replace(
        y=later.y + np.linspace(0.0, 1.5, len(later))[:, None]
    )  # a room that warms up
    found = with_noise_of([joined(train, warmer)], Pair(fits[0], final), train)
    before, after = final.theta.asdict(), found.final.theta.asdict()
    moved = {name for name in before if before[name] != after[name]}
    assert moved == {"q", "r"}
    assert after["q"] > 1e-3


def test_units_and_their_zero_change_nothing_of_a_gain(fits):
    """The same readings in degF and minutes."""
    train, test = parts(21)
    of_unit = {
        "tau": 1 / 60,
        "gain": 1.8,
        "q": 1.8 * 60**0.5,
        "r": 1.8,
        "slow_sensor_sensor": 1 / 60,
    }
    model, found = heater(0.25 * 1.8**2), []
    for fit, one in zip(fits, (model, extend(model, ["slow-sensor:sensor"])), strict=True):
        values = {name: of_unit.get(name, 1.0) * x for name, x in fit.theta.asdict().items()}
        values["room"] = 1.8 * values["room"] + 32.0
        found.append(replace(fit, model=one, theta=one.theta(values)))
    there = [one.replace(y=1.8 * one.y + 32.0, t=one.t / 60.0) for one in (train, test)]
    for later, other in (
        (Series(y=test.y, u=test.u, dt=1.0), Series(y=there[1].y, u=test.u, dt=1 / 60)),
        (test, there[1]),
    ):
        here = measure_gain(*fits, [later], records=[train])
        elsewhere = measure_gain(*found, [other], records=[there[0]])
        assert elsewhere.log_density == pytest.approx(here.log_density, abs=1e-3)


def test_a_reading_that_can_be_one_value_only_is_no_error():
    """Of a sensor without noise at a first state that is known there is no density."""
    exact = replace(
        HEATER,
        measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[0.0]]),
        initial=lambda th: (Gaussian([th.room], [[0.0]]), np.zeros(0), np.zeros((0, 0))),
    )
    series = Series(y=np.full(5, 40.0), u=np.zeros(5), dt=1.0)
    assert not begins_as_expected(exact, np.asarray(exact.theta()), series)


def test_a_nonlinear_memory_follows_the_state_that_it_remembers(fits):
    """A delayed reading is that of where the record begins, wherever that is."""
    train, _ = parts(21)
    late = extend(HEATER, ["delay:sensor"])
    theta = late.theta({**fits[0].theta.asdict(), "delay_sensor": 3.0})
    _, wide = anywhere(fits[0], replace(fits[1], model=late, theta=theta), train)
    cov = wide.model.start(wide.model.record(theta)).density.cov
    spread = np.sqrt(np.diag(cov))
    assert spread.max() > 10.0
    others = cov[0, 1:] / spread[0] / np.where(spread[1:] > 0.0, spread[1:], 1.0)
    assert others.max(initial=1.0) > 0.9
