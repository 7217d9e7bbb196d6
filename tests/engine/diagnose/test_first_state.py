"""A record that does not begin where the model says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.diagnose import diagnose, extend
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.free_run.windows import rows_searched, stretch
from engine.diagnose.gain.narrowing import narrowed
from engine.diagnose.screening.score_columns import effect_columns, innovation_columns
from engine.filters.filter_steps import first_moments
from engine.filters.sigma_point import moment_filter, moment_path
from tests.engine.hidden_effects import DRIVE, hidden


class Uniform:
    """A density that is no Gaussian."""

    def sample(self, rng, n):
        return rng.uniform(-1.0, 1.0, (n, 1))

    def log_density(self, a):
        return np.where(np.abs(a[:, 0]) <= 1.0, np.log(0.5), -np.inf)


def starting(initial):
    return replace(DRIVE, initial=initial)


@pytest.mark.parametrize("state", ["speed", "load"])
def test_only_the_mean_of_that_state_moves(state):
    """Also where z_1 depends on a_1: it depends on how far a_1 is from its own mean."""
    model = starting(
        lambda th: (
            engine.Gaussian([0.3], [[0.04]]),
            lambda a: [0.5 * a[:, 0]],
            lambda a: 0.01 + 0.0 * a[:, :, None],
        )
    )
    before, P = first_moments(model, np.asarray(model.theta()))
    name = f"start_{state}"
    extended = extend(model, [f"start:{state}"])
    after, P_after = first_moments(extended, np.asarray(extended.theta({name: 0.7})))
    moved = after - before
    assert moved[["speed", "load"].index(state)] == pytest.approx(0.7)
    assert np.count_nonzero(np.abs(moved) > 1e-12) == 1
    np.testing.assert_allclose(P_after, P, atol=1e-12)


def test_any_density_moves_with_it():
    model = starting(lambda th: (Uniform(), [0.0], [[0.01]]))
    extended = extend(model, ["start:speed"])
    density = extended.start(extended.record(extended.theta({"start_speed": 5.0}))).density
    draws = density.sample(np.random.default_rng(0), 100)
    assert ((draws > 4.0) & (draws < 6.0)).all()
    assert np.isfinite(density.log_density(draws)).all()
    assert not np.isfinite(density.log_density(draws - 5.0)).any()


@pytest.mark.parametrize("name", ["start:speed", "start:load", "held:load"])
def test_the_column_is_the_difference_of_two_filters(name):
    """``held:load`` in a model whose start depends on it: what begins elsewhere belongs to it, too."""
    model = starting(
        lambda th: (engine.Gaussian([0.2 * th.load], [[0.01]]), [0.0], [[0.05 * th.load]])
    )
    series = hidden([], {}, 3, 80)
    theta = np.asarray(model.theta())
    setting = replace(setting_for(model, series, theta), held=("load",))
    effect = make_effect(name, setting)
    ((_, column),) = effect_columns(effect, model, theta, series, moment_path(model, theta, series))
    extended, h = effect.apply(model), 1e-4
    thetas = np.array([[*theta, 0.0], [*theta, -h], [*theta, h]])
    filtered = moment_filter(extended, thetas, series)
    (expected,) = innovation_columns(filtered, series.observed, [(1, 2, 2 * h)])
    np.testing.assert_allclose(column.s, expected.s, atol=1e-4 * np.abs(expected.s).max())
    np.testing.assert_allclose(column.v, expected.v, atol=1e-4 * np.abs(expected.v).max())


def cell(T, rng):
    """A battery, its charge counted from what the model takes for granted: full."""

    def dynamics(a, u, t, dt, theta):
        return [0.0, 0.0], np.diag([1.0, 0.8]), np.diag([1e-10, theta.q**2])

    def measurement(a, u, t, theta):
        return [3.0 - theta.R * u[0]], [[0.8, 1.0]], [[1e-4]]

    model = engine.MixedModel(
        name="cell",
        dynamics=lambda a, u, t, dt, th: (
            [-u[0] / 500.0, 0.02 * u[0]],
            *dynamics(a, u, t, dt, th)[1:],
        ),
        measurement=measurement,
        initial=lambda theta: (
            engine.Gaussian([], np.zeros((0, 0))),
            [1.0, 0.0],
            np.diag([1e-4, 1e-4]),
        ),
        nonlinear={},
        linear={"charge": "", "relaxation": "V"},
        inputs={"current": "A"},
        outputs={"voltage": "V"},
        parameters=[
            engine.Parameter("R", 0.05, "Ohm", (0.0, 1.0)),
            engine.Parameter("q", 1e-3, "V", (1e-6, 1.0)),
        ],
    )
    u = np.repeat(rng.uniform(0.0, 1.0, T // 10), 10)
    return model, engine.simulate(model, None, T, rng, u=u, dt=1.0).series


@pytest.mark.slow
def test_a_record_cut_from_a_longer_one_is_found_out():
    model, series = cell(500, np.random.default_rng(2))
    found = diagnose(model, series.part(200, 500), seed=1)
    assert found.causes
    assert "start:charge" in found.causes[0].equivalent
    start = next(r for r in found.search.rounds[0].refits if r.effect.name == "start:charge")
    left = -float(np.sum(series.u[:200])) / 500.0
    assert start.size == pytest.approx(left, abs=4.0 * start.standard_error + 0.01)


@pytest.mark.long
def test_a_whole_record_begins_where_it_should():
    model, series = cell(300, np.random.default_rng(3))
    found = diagnose(model, series, seed=1, effects=["start", "bias", "force"])
    assert found.verdict.value == "nothing"


@pytest.mark.long
def test_a_long_record_is_not_searched_where_the_model_knows_nothing_of_its_start():
    """What looks best is in its middle, where the charge is not what the model says of the first row."""
    model, series = cell(12_000, np.random.default_rng(4))
    u = series.u.copy()
    u[:4000] *= 0.1
    series = series.replace(u=u)
    begin, end = stretch(series)
    assert begin > 0
    assert rows_searched(model, None, None, series) == (0, end - begin)
    unknown = replace(
        model,
        initial=lambda th: (engine.Gaussian([], np.zeros((0, 0))), [0.0, 0.0], 1e4 * np.eye(2)),
    )
    assert rows_searched(unknown, None, None, series) == (begin, end)


@pytest.mark.long
def test_how_a_record_begins_says_nothing_of_another_one():
    """It is judged on rows of its own record; a test record later on begins as the model says."""
    model, series = cell(500, np.random.default_rng(2))
    part, later = series.part(200, 500), cell(100, np.random.default_rng(5))[1]
    later = later.replace(t=later.t + series.t[-1] + 10.0)
    found = diagnose(model, part, test=later, seed=1, effects=["start"])
    assert "start:charge" in found.causes[0].equivalent
    assert found.gain is not None
    assert found.gain.adopt
    assert found.gain.samples == len(part)


@pytest.mark.long
def test_held_out_data_decide_where_the_record_cannot():
    """An offset of the sensor and another first charge are the same here, and not in a later record."""
    model, series = cell(500, np.random.default_rng(2))
    part, later = series.part(200, 500), cell(100, np.random.default_rng(5))[1]
    later = later.replace(t=later.t + series.t[-1] + 10.0)
    found = diagnose(model, part, test=later, seed=1, effects=["start", "bias"])
    assert found.verdict.value == "named"
    assert [cause.effect for cause in found.causes] == ["start:charge"]
    assert found.causes[0].equivalent == ("start:charge",)
    assert any("the held-out data do" in note and "bias:voltage" in note for note in found.notes)
    assert found.gain is not None
    assert found.gain.adopt


def _never(found, refits):
    raise AssertionError("no set is to be made anew")


@pytest.mark.slow
def test_a_set_whose_members_are_all_contradicted_stays():
    model, series = cell(500, np.random.default_rng(2))
    found = diagnose(model, series.part(200, 500), seed=1, effects=["start", "bias"]).search
    names = [r.effect.name for r in found.rounds[0].equivalent]
    assert sorted(names) == ["bias:voltage", "start:charge"]
    asked = []

    def ask(order):
        asked.append(order.rounds[0].refits[0].effect.name)
        return None, f"not {asked[-1]}"

    left = narrowed(found, ask, _never)
    assert asked == names
    assert left.search is found
    assert left.objection == f"not {names[0]}"
    kept = narrowed(found, lambda order: (None, "" if order is found else "never asked"), _never)
    assert kept.search is found
    assert (kept.objection, kept.note) == ("", "")
