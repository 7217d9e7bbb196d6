"""Tails of the one-step errors, against SciPy's test of the kurtosis and by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kurtosistest, norm

import engine
from engine import simulate
from engine.diagnose import make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.screening import screening
from engine.diagnose.screening.tails import (
    fit_tails,
    standardised_errors,
    tail_test,
    tails_information,
)
from engine.diagnose.search.search import without_outliers
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.filters.sigma_point import moment_path
from tests.engine.hidden_effects import DRIVE, DT, levels

READING, SPEED = (make_effect(f"heavy-tails:{at}", Setting(DRIVE)) for at in ("reading", "speed"))


@pytest.fixture(scope="module")
def drive():
    rng = np.random.default_rng(1)
    series = simulate(DRIVE, None, 300, rng, u=levels(rng, 300), dt=DT).series
    y = series.y.copy()
    y[50:60] = np.nan
    y[::30] += 0.3
    series = series.replace(y=y)
    return series, moment_path(DRIVE, np.asarray(DRIVE.theta()), series)


def known(effect, path, errors):
    return tail_test(effect, DRIVE, path, errors).known


def test_errors_are_innovations_in_their_predicted_scatter(drive):
    series, path = drive
    errors = standardised_errors(path, series.observed, None)
    seen = series.observed[:, 0]
    assert np.isnan(errors[~seen]).all()
    expected = path.innovations[seen, 0] / np.sqrt(path.S[seen, 0, 0])
    np.testing.assert_allclose(errors[seen, 0], expected)
    # where a particle filter says how probable smaller readings were, by that
    pit = np.full((300, 1), norm.cdf(1.5))
    np.testing.assert_allclose(standardised_errors(path, series.observed, pit), 1.5)


def test_heavy_tails_of_a_reading_are_judged_by_the_kurtosis(drive):
    series, path = drive
    errors = standardised_errors(path, series.observed, None)
    found = kurtosistest(errors[series.observed])
    statistic, p = known(READING, path, errors)
    assert found.statistic > 3.0
    assert statistic == pytest.approx(found.statistic**2)
    assert p == pytest.approx(norm.sf(found.statistic))


def test_light_tails_are_no_evidence(drive):
    _, path = drive
    statistic, p = known(READING, path, np.linspace(-1.0, 1.0, 300)[:, None])
    assert statistic == 0.0
    assert p > 0.99


def test_those_of_a_state_are_judged_by_its_share_in_the_errors(drive):
    """One reading moves one state by its error, so both say the same where all was read."""
    series, path = drive
    errors = standardised_errors(path, series.observed, None)
    of_state = known(SPEED, path, errors)
    assert of_state == pytest.approx(known(READING, path, errors))


def test_particles_are_drawn_where_outliers_are_looked_for_alone(monkeypatch, drive):
    """They take longer than the rest of a screen, and nothing else asks for what they say."""
    asked, series = [], drive[0]
    fit = QuasiFit(DRIVE, DRIVE.theta(), 0.0, (), np.empty((0, 0)), 1, True)
    monkeypatch.setattr(screening, "pit_of", lambda *a: asked.append(1))
    for kinds, times in ((["force"], 0), (["force", "heavy-tails:reading"], 1)):
        screening.screen_effects(fit, series, Setting(DRIVE), kinds, 0.05, 0, lambda *a: None)
        assert len(asked) == times


def test_too_few_errors_or_none_that_scatter_are_not_judged(drive):
    _, path = drive
    errors = np.full((300, 1), np.nan)
    errors[:19, 0] = np.arange(19.0)
    assert tail_test(READING, DRIVE, path, errors) is None
    errors[19] = 3.0
    assert tail_test(READING, DRIVE, path, errors) is not None
    assert tail_test(READING, DRIVE, path, np.ones((300, 1))) is None


def test_the_kurtosis_tells_the_share_of_outliers(drive):
    """One in a thousand has ten times the standard deviation; outliers with a normal's moments."""
    _, path = drive
    usual = norm.ppf((np.arange(11988) + 0.5) / 11988)
    outliers = 10.0 * np.sqrt(3.0) * np.repeat([1.0, -1.0, 0.0], [2, 2, 8])
    test = tail_test(READING, DRIVE, path, np.concatenate([usual, outliers])[:, None])
    assert float(test.s.sum()) == pytest.approx(1e-3, rel=0.25)
    assert test.at == ((10.0,),)


def test_two_outliers_in_a_row_are_taken_out_and_the_good_reading_after_them_is_not():
    """The first moves the level, so that the second looks usual and the third does not."""
    model = engine.get_model("local-level")
    rng = np.random.default_rng(4)
    y = 10.0 + np.cumsum(rng.standard_normal(80)) + rng.standard_normal(80)
    y[[20, 21, 50]] += [9.0, 9.0, -9.0]
    series = engine.Series(y, dt=1.0, y_names=["flow"])
    theta = model.theta({"q": 1.0, "r": 1.0, "level": 10.0})
    fit = replace(quasi_ml(model, series, theta, ["q"], max_iterations=1), theta=theta)
    left = without_outliers(fit, series, "flow", 0)
    assert np.flatnonzero(np.isnan(left.y[:, 0])).tolist() == [20, 21, 50]
    # a level that has moved for good is not taken for outliers
    moved = series.replace(y=np.where(np.arange(80)[:, None] >= 60, series.y + 9.0, series.y))
    assert np.isnan(without_outliers(fit, moved, "flow", 0).y[60:]).sum() <= 3


@pytest.mark.long
def test_a_date_on_a_row_does_not_keep_outliers_from_being_fitted(drive):
    """To one side of it the likelihood jumps; what outliers gain is that beside a date between two rows."""
    series = drive[0]
    shifted = make_effect("step:reading", Setting(DRIVE)).apply(DRIVE)
    heavy = make_effect("heavy-tails:reading", Setting(shifted))
    gains = []
    for date in (150.0, 149.6):
        start = shifted.theta({"step_reading": 0.05, "step_reading_time": series.t[0] + date * DT})
        fit = quasi_ml(shifted, series, start)
        at = shifted.theta(fit.theta.asdict() | {"step_reading_time": start["step_reading_time"]})
        gain, theta = fit_tails(replace(fit, theta=at), heavy, series)
        information = tails_information(fit, heavy, series, theta)
        gains.append(gain)
        assert information[fit.free.index("step_reading_time"), :].max() == 0.0
    assert gains[0] > 50.0
    assert gains[0] == pytest.approx(gains[1], abs=0.01)
