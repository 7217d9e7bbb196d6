"""What is said of errors and of data, checked where the answer is known."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from engine.data import nile
from engine.diagnose.data_checks import check_data
from engine.diagnose.regions import Errors, by_frequency, by_signal, most_telling, newey_west
from engine.diagnose.residuals import auxiliary, standardised, whiteness
from engine.diagnose.runs import covariance_of, smoothed, start_state
from engine.diagnose.symptoms import find_symptoms
from engine.kalman import kalman_smoother
from engine.models.linear_2 import MODEL as LINEAR
from engine.models.local_level import MODEL as LEVEL
from engine.models.mixed_4 import MODEL as MIXED
from engine.models.tanks import MODEL as TANKS
from engine.moment_filter import moment_path
from engine.quasi_ml import quasi_ml
from engine.series import Series
from engine.simulate import simulate
from engine.words import number, percent, tidy, with_unit

QUIET = {"sigma_level": 0.001, "sigma_inflow": 0.0}


def pumped(n, seed):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.5, 5.0, n // 15 + 1), 15)[:n]
    return simulate(TANKS, QUIET, n, rng, u=u, dt=4.0).series


def test_numbers_and_units_as_people_write_them():
    assert with_unit(256.0, "1e8 m^3") == "256 x 1e8 m^3"
    assert with_unit(0.25, "1") == "0.25"
    assert with_unit(0.25, "1/s/(1^2)") == "0.25 1/s"
    assert tidy("N s/m") == "N s/m"
    assert (number(float("nan")), percent(0.034), percent(0.41)) == ("?", "3.4 %", "41 %")


def test_the_first_state_is_the_smoothers():
    series = nile()
    theta = np.asarray(LEVEL.theta())
    exact = kalman_smoother(LEVEL, theta, series)
    means, covariances = smoothed(moment_path(LEVEL, theta, series))
    np.testing.assert_allclose(means, exact.z, rtol=1e-8)
    np.testing.assert_allclose(covariances[:, 0, 0], exact.P[:, 0, 0], rtol=1e-8)
    mean, _ = start_state(LEVEL, theta, series, first=40)
    part = kalman_smoother(LEVEL, theta, series.part(0, 60))
    np.testing.assert_allclose(mean, part.z[40], rtol=1e-8)


def test_covariance_of_a_fit_matches_its_standard_errors():
    fit = quasi_ml(LINEAR, simulate(LINEAR, None, 300, np.random.default_rng(1)).series)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance_of(fit))), fit.standard_errors, rtol=1e-4)


def test_an_error_at_high_values_is_found_there():
    rng = np.random.default_rng(3)
    x = rng.uniform(0.0, 10.0, 600)
    e = 0.1 * rng.standard_normal(600) + 0.3 * (x > 8.0)
    regions = by_signal(Errors("y", "V", e, np.ones(600)), "state", "level", "V", x, 8)
    (found,) = most_telling(regions, 4)
    assert found.highest
    assert not found.lowest
    assert 7.0 < found.low < 8.8
    assert 0.2 < found.mean < 0.32
    assert found.share_error > 2.0 * found.share_samples


def test_white_errors_are_nowhere_notable():
    rng = np.random.default_rng(4)
    hits = 0
    for _ in range(40):
        e, x = rng.standard_normal((2, 300))
        errors = Errors("y", "V", e, np.ones(300))
        regions = [*by_signal(errors, "state", "x", "1", x, 8), *by_frequency(errors, 1.0, 8)]
        hits += bool(most_telling(regions, 1))
    assert hits <= 3


def test_a_hidden_tone_shows_at_its_frequency():
    rng = np.random.default_rng(5)
    t = np.arange(500) * 0.1
    e = rng.standard_normal(500) + 1.0 * np.sin(2 * np.pi * 1.3 * t)
    regions = by_frequency(Errors("y", "V", e, np.ones(500)), 0.1, 8)
    (found,) = most_telling(regions, 4)
    assert found.low < 1.3 < found.high


def test_newey_west_of_white_and_of_correlated_errors():
    rng = np.random.default_rng(6)
    white = rng.standard_normal(4000)
    assert newey_west(white, 4000) == pytest.approx(1.0 / np.sqrt(4000), rel=0.1)
    moving = np.convolve(white, [1.0, 1.0], mode="valid")  # long-run variance (1 + 1)^2
    assert newey_west(moving, len(moving), 50) == pytest.approx(2.0 / np.sqrt(4000), rel=0.25)


def test_clean_linear_series_mostly_show_nothing():
    odd = 0
    for seed in range(7, 15):
        series = simulate(LINEAR, None, 300, np.random.default_rng(seed)).series
        found = find_symptoms(LINEAR, None, series)
        odd += len(found.sentences) > 2  # one on the free run, one on the predictions
    assert odd <= 2
    assert found.free_run is not None
    assert found.free_run.fits[0].inside > 0.9
    assert found.one_step.fits[0].inside == pytest.approx(0.95, abs=0.04)
    assert found.whiteness[0].p_value > 0.01
    assert abs(np.nanmean(found.pit) - 0.5) < 0.06


def test_auxiliary_residuals_point_at_a_jump():
    series = simulate(LEVEL, {"q": 100.0, "r": 400.0}, 120, np.random.default_rng(8)).series
    y = series.y.copy()
    y[60:] += 200.0
    jumped = Series(y)
    path = moment_path(LEVEL, np.asarray(LEVEL.theta({"q": 100.0, "r": 400.0})), jumped)
    of_y, of_x = auxiliary(path, jumped)
    assert (
        int(np.argmax(np.abs(of_x[:, 0]))) == 59
    )  # the disturbance that moves x from row 59 to 60
    assert np.abs(of_x[:, 0]).max() > 2.0 * np.abs(of_y).max()
    clean = moment_path(LEVEL, np.asarray(LEVEL.theta({"q": 100.0, "r": 400.0})), series)
    assert np.std(auxiliary(clean, series)[0]) == pytest.approx(1.0, abs=0.25)


def test_whiteness_sees_correlation_and_leaves_gaps_out():
    rng = np.random.default_rng(9)
    white = rng.standard_normal((400, 1))
    moving = white[1:] + 0.6 * white[:-1]
    assert whiteness(white, ("y",))[0].p_value > 0.01
    moving[50:80] = np.nan
    assert whiteness(moving, ("y",))[0].p_value < 1e-6


def test_a_sensor_that_reads_high_at_high_levels_is_said_in_words():
    series = pumped(400, 1)
    y = series.y + 0.5 * (series.y > 5.5)
    wrong = Series(y, series.u, dt=4.0)
    found = find_symptoms(TANKS, QUIET, wrong)
    spoken = [s for s in found.sentences if s.startswith("The simulation of level reads 0.")]
    high = [s for s in spoken if " low whenever " in s and " is above 5." in s]
    assert high, found.sentences
    assert "of the squared error comes from" in high[0]
    json.dumps(found.to_dict(), allow_nan=False)


def test_missing_values_and_two_outputs_pass_through():
    series = simulate(MIXED, None, 300, np.random.default_rng(10)).series
    y = series.y.copy()
    y[100:130] = np.nan
    y[::7, 0] = np.nan
    found = find_symptoms(MIXED, None, Series(y))
    assert found.free_run is not None
    assert {f.output for f in found.free_run.fits} == {"y1", "y2"}
    assert np.isnan(found.z[100:130]).all()
    assert np.isfinite(standardised(moment_path(MIXED, MIXED.theta(), series), series)).all()


def test_a_run_that_runs_away_is_said():
    unstable = replace(
        LEVEL,
        dynamics=lambda a, u, t, dt, theta: ([0.0], np.array([[20.0]]), [[theta.q]]),
    )
    series = Series(np.random.default_rng(13).standard_normal(300))
    found = find_symptoms(unstable, {"q": 1.0, "r": 1.0, "level": 0.0}, series)
    assert found.free_run is None
    assert "runs away" in found.sentences[0]


# ---- data ------------------------------------------------------------------------------------


def note(model, y, u=None, t=None):
    return " ".join(check_data(model, Series(y, u, t=t)))


def test_clean_data_have_no_notes():
    for seed in range(5):
        for model in (LINEAR, MIXED):
            series = simulate(model, None, 300, np.random.default_rng(seed)).series
            assert check_data(model, series) == ()


def test_data_checks_name_what_is_odd():
    rng = np.random.default_rng(11)
    y = 3.0 * np.sin(np.arange(400) / 9.0) + 0.05 * rng.standard_normal(400)
    assert "clipped" in note(LINEAR, np.clip(y, None, 2.0))
    assert "clipped" not in note(LINEAR, y)
    assert "steps of 0.5" in note(LINEAR, np.round(2.0 * y) / 2.0)
    assert "dead" in note(LINEAR, np.ones(200))
    stuck = y.copy()
    stuck[100:140] = 1.234
    assert "stuck" in note(LINEAR, stuck)
    spiked = y.copy()
    spiked[[50, 200]] += 5.0
    assert "2 readings" in note(LINEAR, spiked)
    gap = y.copy()
    gap[20:60] = np.nan
    assert "40 samples" in note(LINEAR, gap)
    assert "Only 60 samples" in note(LINEAR, y[:60])
    t = np.arange(400.0)
    t[200:] += 50.0
    assert "irregular" in note(LINEAR, y, t=t)


def test_a_channel_without_readings_and_a_constant_input_are_notes():
    y = np.full((150, 2), np.nan)
    y[:, 1] = np.random.default_rng(12).standard_normal(150)
    assert "y1 has 0 readings" in note(MIXED, y)
    u = np.full(150, 2.5)
    assert "Input pump is 2.5 V throughout" in note(TANKS, y[:, 1], u)
