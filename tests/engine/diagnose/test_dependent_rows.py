"""Errors that depend on earlier rows are no noise, however well outliers or a variance explain them."""

import numpy as np
import pytest

import engine
from engine.diagnose import Verdict, diagnose, hide, make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.judging import dependent_rows
from engine.diagnose.refits.refit import with_tails
from engine.errors import EngineError
from engine.estimation.quasi_ml import quasi_ml

LEVEL = engine.get_model("local-level")
NAME = "heavy-tails:flow"
VALUES = {"heavy_tails_flow_share": 0.1, "heavy_tails_flow_ratio": 8.0}


def weekly():
    """Counts that wander, one day of seven hardly counted."""
    series = engine.simulate(LEVEL, None, 280, np.random.default_rng(4), dt=1.0).series
    y = series.y.copy()
    y[::7] -= 8.0 * np.std(np.diff(y[:, 0]))
    return series.replace(y=y)


def outliers(seed):
    return hide(LEVEL, [NAME], VALUES, 280, np.random.default_rng(seed), dt=1.0).series


def growing():
    """A rhythm of a week that grows with time."""
    series = engine.simulate(LEVEL, None, 280, np.random.default_rng(1), dt=1.0).series
    t, size = np.arange(280), 1.5 * np.std(np.diff(series.y[:, 0]))
    return series.replace(y=series.y + (size * t / 280 * np.sin(2 * np.pi * t / 7))[:, None])


def told(series):
    """The sentence, at the model with outliers fitted to a series."""
    effect = make_effect(NAME, Setting(LEVEL))
    fit = quasi_ml(LEVEL, series)
    found = with_tails(fit, effect.apply(LEVEL), effect, series)
    assert found.log_likelihood > fit.log_likelihood + 20.0  # it explains them well
    return dependent_rows.dependent_rows(found, series, [NAME], 0)


@pytest.mark.long
def test_a_day_of_the_week_is_no_outlier(monkeypatch):
    sentence = told(weekly())
    assert "of the extended model depend on those of earlier rows (p < 0.0001)" in sentence

    def lost(*_):
        raise EngineError("it runs away")

    # what is beyond doubt is said where nothing can be simulated, as of an epidemic that noise starts anew
    monkeypatch.setattr(dependent_rows, "drawn_from", lost)
    assert told(weekly()) == sentence


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_outliers_that_come_at_random_are_not_doubted(seed):
    assert told(outliers(seed)) == ""


@pytest.mark.long
def test_a_filter_that_makes_errors_depend_on_each_other_is_no_evidence(monkeypatch):
    drawn = weekly()
    monkeypatch.setattr(dependent_rows, "drawn_from", lambda *_: drawn)
    assert told(drawn) == ""


@pytest.mark.long
@pytest.mark.parametrize(("series", "kind"), [(weekly(), "heavy-tails"), (growing(), "variance")])
def test_no_name_of_noise_is_said_where_rows_depend_on_each_other(series, kind, tmp_path):
    found = diagnose(LEVEL, series, effects=["variance", "heavy-tails", "level"], held_out=0.0)
    assert found.verdict is Verdict.UNKNOWN
    assert [cause.effect.split(":")[0] for cause in found.causes] == [kind]
    assert any("depend on those of earlier rows" in note for note in found.notes)
    head = str(found).partition("1. What is wrong")[0]
    assert "depend on those of earlier rows" in " ".join(head.split())  # why it is unknown
    page = found.report(tmp_path / "page.html").read_text()
    assert page.count("depend on those of earlier rows") == 2
