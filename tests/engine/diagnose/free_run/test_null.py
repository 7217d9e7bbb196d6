"""Whether fitted noise explains the error of a free run: one too large, one too small, one with a pattern."""

import numpy as np
import pytest

import engine
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.free_run import null
from engine.diagnose.free_run.null import SERIES, Alarm, alarm
from engine.diagnose.free_run.refitted import as_near
from engine.diagnose.free_run_fits.candidates import candidates, fit_of
from engine.diagnose.free_run_fits.columns import columns
from engine.diagnose.free_run_fits.folds import folds_of
from engine.diagnose.free_run_fits.linear import Linear
from engine.estimation.quasi_ml import quasi_ml

MODEL = engine.get_model("oscillator")
KINDS = ("force", "bias", "gain", "cubic")
NOISE = {"sigma_v": 0.2, "sigma_y": 2e-3}
LEAST = 1.0 / (SERIES + 1)  # p-value


@pytest.fixture(scope="module")
def clean():
    """The free run of a model that is right, of 300 samples."""
    rng = np.random.default_rng(8)
    theta = MODEL.theta(NOISE)
    u = np.repeat(rng.standard_normal(30), 10)
    series = engine.simulate(MODEL, theta, 300, rng, u=u, dt=0.05).series
    fit = fit_of(quasi_ml(MODEL, series, theta), [series])
    setting = setting_for(MODEL, series, np.asarray(fit.theta))
    return Linear(fit, columns(fit, candidates(fit, setting, KINDS))), folds_of(fit.records)


@pytest.mark.parametrize(
    ("times", "small"), [(1.0, set()), (30.0, {"p_near"}), (1.0 / 30.0, {"p_size"})]
)
def test_noise_that_is_too_large_or_too_small_is_no_explanation(clean, times, small):
    linear, folds = clean
    theta = np.asarray(MODEL.theta(NOISE | {"sigma_v": times * NOISE["sigma_v"]}))
    fitted = np.asarray(linear.fit.theta).copy()
    at = MODEL.parameter_names.index("sigma_v"), MODEL.parameter_names.index("sigma_y")
    fitted[list(at)] = theta[list(at)]
    seen = alarm(linear, fitted, folds, 1, linear.fit.model.theta(fitted))
    assert {name for name in ("p_size", "p_near") if getattr(seen, name) == LEAST} == small
    assert (seen.p_value <= 0.01) == bool(small)


def test_an_error_is_too_small_only_where_the_likelihood_s_own_noise_is_too_large_too(clean):
    linear, folds = clean
    fitted = np.asarray(linear.fit.theta).copy()
    own = linear.fit.model.theta(fitted)
    fitted[MODEL.parameter_names.index("sigma_v")] *= 30.0
    assert alarm(linear, fitted, folds, 1, linear.fit.model.theta(fitted)).p_near == LEAST
    assert alarm(linear, fitted, folds, 1, own).p_near > 0.5
    assert alarm(linear, fitted, folds, 1).p_near == 1.0


def test_runs_that_noise_drives_away_count_as_large_however_far_they_are(clean, monkeypatch):
    """Of an epidemic, say, that grows with what noise adds: some end at 1e160, whose squares are no numbers."""
    linear, folds = clean
    theta = np.asarray(linear.fit.theta)
    drawn = null.noise_runs(linear.fit, theta, SERIES, 1)
    seen = []
    for far in (np.inf, 1e160):
        drawn[-1, :40] = far
        monkeypatch.setattr(null, "noise_runs", lambda *_: drawn.copy())
        seen.append(alarm(linear, theta, folds, 1, linear.fit.model.theta(theta)))
    assert seen[0] == seen[1]


def test_three_questions_share_the_error():
    assert Alarm(0.5, 0.2, 0.004, 1.0, 2.0, 0.0).p_value == pytest.approx(0.012)
    assert Alarm(0.5, 0.9, 0.8, 1.0, 2.0, 0.0).p_value == 1.0
    assert 3.0 * LEAST <= 0.01  # the level where the likelihood has an answer can be reached


@pytest.mark.long
@pytest.mark.parametrize(("times", "small"), [(1.0, False), (5.0, True)])
def test_how_near_free_runs_can_be_bent_is_asked_by_refits(clean, times, small):
    """Noise that is five times too large is refuted by refits of what it makes, and by no projection."""
    linear, folds = clean
    fitted = np.asarray(linear.fit.theta).copy()
    for name in NOISE:
        fitted[MODEL.parameter_names.index(name)] = NOISE[name]
    fitted[MODEL.parameter_names.index("sigma_v")] *= times
    own = linear.fit.model.theta(fitted)
    seen = alarm(linear, fitted, folds, 1, own, level=0.05)
    assert (seen.p_value <= 0.05) == small
    assert (seen.refits > 0) == small == seen.at_floor
    assert alarm(linear, fitted, folds, 1, own, level=0.01).refits == 0  # that would take too many


def test_refits_that_come_as_near_are_counted_until_they_decide(clean):
    linear, _ = clean
    theta = np.asarray(linear.fit.theta).copy()
    for name in NOISE:
        theta[MODEL.parameter_names.index(name)] = 0.1 * NOISE[name]
    own = linear.fit.model.theta(theta)
    assert as_near(linear.fit, own, 20, 0.2, 0) == 4  # of five, 4 + 1 being more than 0.2 of 21
    assert as_near(linear.fit, own, 3, 1.0, 0) == 3
