"""Whether fitted noise explains the error of a free run: one too large, one too small, one with a pattern."""

import numpy as np
import pytest

import engine
from engine.diagnose.effects.setting import setting_for
from engine.diagnose.free_run.null import SERIES, Alarm, alarm
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


def test_three_questions_share_the_error():
    assert Alarm(0.5, 0.2, 0.004, 1.0, 2.0, 0.0).p_value == pytest.approx(0.012)
    assert Alarm(0.5, 0.9, 0.8, 1.0, 2.0, 0.0).p_value == 1.0
    assert 3.0 * LEAST <= 0.01  # the level where the likelihood has an answer can be reached
