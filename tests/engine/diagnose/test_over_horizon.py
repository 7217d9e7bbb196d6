"""The candidates beside each other: a cause keeps its lead over the horizon, a patch on the noise does not."""

import importlib
from dataclasses import replace

import numpy as np
import pytest

from engine.diagnose.over_horizon import Candidate, OverHorizon, over_horizon
from engine.diagnose.search.pipeline import find_causes
from engine.diagnose.symptoms.compare import settled_from
from engine.filters.sigma_point import moment_path
from engine.presentation import over_horizon as words
from tests.engine.diagnose import clipped
from tests.engine.hidden_effects import case

module = importlib.import_module("engine.diagnose.over_horizon")
pytestmark = pytest.mark.slow
CAUSE, PATCH = ("saturation-sensor:y",), ("variance:velocity->drive",)


@pytest.fixture(scope="module")
def beside():
    search = clipped.found().search
    return over_horizon(search.base, search.final, CAUSE, search, clipped.series())


def test_a_cause_leads_everywhere(beside):
    assert beside.horizons == (1, 10, 100, 300)
    given, cause, *others = beside.candidates
    assert (given.effects, cause.effects) == ((), CAUSE)
    assert set(given.errors) == {1.0}
    assert set(given.gains) == {0.0}
    assert set(beside.leaders()) == {CAUSE}
    assert beside.sentence.startswith("saturation-sensor:y leads at every horizon")
    patch = next(c for c in others if c.effects == PATCH)
    assert max(cause.errors) < 0.7 < 0.9 < min(patch.errors)
    assert min(cause.gains) > max(0.0, patch.gains[0])


def test_an_error_one_sample_ahead_is_that_of_the_innovations(beside):
    search, series = clipped.found().search, clipped.series()
    before, after = (
        moment_path(fit.model, np.asarray(fit.theta), series).innovations[
            2:
        ]  # two states, of one reading
        for fit in (search.base, search.final)
    )
    share = np.sqrt(np.mean(after**2) / np.mean(before**2))
    assert beside.candidates[1].errors[0] == pytest.approx(share, rel=1e-12)


def test_a_patch_leads_one_sample_ahead_only():
    rows = [
        Candidate((), (1.0, 1.0), (0.0,)),
        Candidate(("drag:v",), (0.9, 0.4), (10.0,)),
        Candidate(("variance:y->u",), (0.6, 1.1), (90.0,)),
        Candidate(("bias:y",), (np.nan, np.inf), (np.nan,)),
    ]
    found = OverHorizon((1, 50), (1.0,), tuple(rows))
    assert found.sentence == (
        "variance:y->u leads one sample ahead and with the process noise of the model as given; drag:v leads "
        "over the whole record."
    )
    table = words.rows({"candidates": [vars(c) for c in rows]})
    assert table[0] == ["as given", "100 %", "100 %", "0"]
    assert table[3] == ["bias:y", "-", "-", "-"]


def test_what_predicts_better_than_the_answer_everywhere_is_said():
    """Noise that grows with a concentration explains each sample from the one before, and no run."""
    given = Candidate((), (1.0, 1.0), (0.0,))
    noise = Candidate(("variance:y->c",), (0.43, 2.7), (np.nan,))
    pole = Candidate(("pole:c",), (0.32, 0.35), (13.9,))

    def instead(*added):
        return OverHorizon((1, 14), (1.0,), (given, *added)).instead

    assert instead(noise, pole) == (
        "pole:c predicts better at every horizon: over the whole record it is wrong by 35 % of what the model "
        "as given is."
    )
    assert instead(pole, noise) == ""  # the answer leads
    assert instead(noise, replace(pole, errors=(0.5, 0.35))) == ""  # not one sample ahead
    assert instead(noise, replace(pole, gains=(-5.0,))) == ""  # the model as given leads there
    assert instead(replace(noise, errors=(1.1, 2.7))) == ""


def test_what_was_not_compared_is_not_led():
    rows = [
        Candidate((), (1.0, 1.0), (0.0, 0.0)),
        Candidate(("lag:y",), (0.9, 0.4), (np.nan, np.nan)),
    ]
    assert OverHorizon((1, 50), (1.0, 0.1), tuple(rows)).sentence == "lag:y leads at every horizon."
    rows[1] = replace(rows[1], gains=(9.0, 9.0))
    assert OverHorizon((1, 50), (1.0, 0.1), tuple(rows)).sentence == (
        "lag:y leads at every horizon and with every budget of process noise."
    )


def test_a_candidate_that_is_worse_than_the_model_as_given_leads_nowhere():
    rows = [
        Candidate((), (1.0, 1.0), (0.0, 0.0)),
        Candidate(("coulomb:v",), (0.9, 1.15), (10.0, -3.0)),
        Candidate(("stribeck:v",), (0.95, 1.13), (9.5, -1.0)),
    ]
    found = OverHorizon((1, 50), (1.0, 0.1), tuple(rows))
    assert found.sentence == (
        "coulomb:v leads one sample ahead and with the process noise of the model as given; the model as given "
        "leads over the whole record and with 0.1 of it."
    )


def test_the_first_rows_of_an_unknown_first_state_are_left_out():
    """Two first states that one reading cannot tell: the second prediction is far off, whatever the cause."""
    search, series = clipped.found().search, clipped.series()
    path = moment_path(search.base.model, np.asarray(search.base.theta), series)
    S = path.S.copy()
    S[:4] = 1e3 * S[10]
    assert settled_from(replace(path, S_predicted=S)) == 4
    S[:4] = S[10]
    S[200] *= 100.0  # later gaps of knowledge are no beginning
    assert settled_from(replace(path, S_predicted=S)) == 0


def test_noise_at_a_bound_is_lent_to_nobody():
    search, series = clipped.found().search, clipped.series()
    base = search.base
    k = base.theta.names.index("sigma_y")
    parameters = list(base.model.parameters)
    value = float(base.theta[k])
    parameters[k] = replace(parameters[k], bounds=(value, 10.0 * value))
    stuck = replace(base, model=base.model.with_parameters(parameters))
    found = over_horizon(stuck, search.final, CAUSE, search, series)
    assert np.isnan(found.candidates[1].gains).all()
    assert np.isfinite(found.candidates[1].errors).all()


def test_noise_of_a_reading_is_not_compared_with_that_of_others():
    """Its level alone was lent to it, and it seemed to lose what it had gained."""
    model, series, name = case("variance", seed=5)
    kinds = [name, "variance:speed->force", "drag:speed"]
    found = find_causes(model, series, effects=kinds, seed=1)
    named = tuple(one.effect.name for one in found.search.named)
    assert named == (name,)
    beside = over_horizon(found.base, found.search.final, named, found.search, series)
    _, answer, *others = beside.candidates
    assert np.isnan(answer.gains).all()
    assert np.isfinite(answer.errors).all()
    assert all(np.isfinite(other.gains).all() for other in others)
    assert others


def test_where_nothing_was_named_nothing_is_compared():
    search = clipped.found().search
    assert over_horizon(search.base, search.final, (), search, clipped.series()) is None


def test_a_candidate_that_is_lost_has_no_errors(monkeypatch):
    search = clipped.found().search
    rest = replace(search, rounds=(replace(search.rounds[0], refits=()),))
    once = module.moment_path

    def lost(model, theta, series):
        if model is not search.base.model:
            raise np.linalg.LinAlgError
        return once(model, theta, series)

    monkeypatch.setattr(module, "moment_path", lost)
    found = over_horizon(search.base, search.final, CAUSE, rest, clipped.series())
    assert np.isnan([*found.candidates[1].errors, *found.candidates[1].gains]).all()
    assert found.sentence == ""


def test_a_run_that_runs_away_and_missing_readings_are_no_warning():
    """Warnings are errors in these tests."""
    search, series = clipped.found().search, clipped.series()
    y = series.y.copy()
    y[5::7] = np.nan
    holes = series.replace(y=y)
    theta = search.final.theta.copy()
    theta[list(theta.names).index("zeta")] = -20.0
    away = replace(search.final, theta=theta)
    rest = replace(search, rounds=(replace(search.rounds[0], refits=()),))
    given, lost = over_horizon(search.base, away, CAUSE, rest, holes).candidates
    assert np.isfinite([*given.errors, *given.gains]).all()
    assert not np.isfinite(lost.errors[-1])


def test_of_a_model_that_is_lost_there_are_no_shares():
    search = clipped.found().search
    theta = search.base.theta.copy()
    theta[list(theta.names).index("zeta")] = -20.0
    lost = replace(search.base, theta=theta)
    rest = replace(search, rounds=(replace(search.rounds[0], refits=()),))
    given, cause = over_horizon(lost, search.final, CAUSE, rest, clipped.series()).candidates
    assert given.errors[0] == 1.0
    assert np.isnan([given.errors[-1], cause.errors[-1]]).all()
