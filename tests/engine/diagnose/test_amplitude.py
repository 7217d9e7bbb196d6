"""A wave is as large as its amplitude, not as the part of its cosine."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import engine
from engine.diagnose.effects.catalogue import extend, make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.refits.amplitude import amplitude_of
from engine.diagnose.refits.refit import refit
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.screening.screen import Score
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.presentation.cause_sentences import headline
from service.diagnoses import in_a_line
from service.key_values import found_by
from tests.engine.hidden_effects import DRIVE, hidden

WAVE = {"harmonic_speed": -0.2, "harmonic_speed_sine": 0.35, "harmonic_speed_frequency": 0.83}
AMPLITUDE = float(np.hypot(0.2, 0.35))


def record(seed):
    return hidden(["harmonic:speed"], WAVE, seed, 240)


@pytest.fixture(scope="module")
def found():
    return engine.diagnose(DRIVE, record(1), effects=["harmonic:speed", "step"], seed=1)


@pytest.mark.long
def test_the_amplitude_is_found_and_said(found, tmp_path):
    (cause,) = found.causes
    assert cause.effect == "harmonic:speed"
    assert abs(cause.amplitude - AMPLITUDE) < 3.0 * cause.amplitude_error < 0.3
    parts = [cause.parameters[name] for name in ("harmonic_speed", "harmonic_speed_sine")]
    assert cause.amplitude == pytest.approx(np.hypot(*parts))
    assert cause.size == parts[0]  # what it was before
    digits = f"{cause.amplitude:.3g} +- {cause.amplitude_error:.2g} m/s^2"
    page = " ".join(str(found).split())
    for said in (headline(cause), page, in_a_line(found)):
        assert f"amplitude {digits}" in said
        assert f"{cause.size:.3g} +-" not in said
    document = json.loads(json.dumps(found.to_dict()))
    one = document["causes"][0]
    assert (one["amplitude"], one["amplitude_error"]) == (cause.amplitude, cause.amplitude_error)
    assert one["size"] == cause.size
    report = found.report(tmp_path / "wave.html").read_text(encoding="utf-8")
    assert f"amplitude {cause.amplitude:.4g} \u00b1 {cause.amplitude_error:.2g}" in report
    values = json.loads(found_by({"diagnosis": document})["found"])["values"]
    assert values[0]["name"] == "amplitude of harmonic:speed"
    assert values[0]["value"] == pytest.approx(cause.amplitude)
    assert f"{cause.amplitude:.3g}"[:5] in found._repr_html_()


def test_a_refit_gains_over_no_wave_at_all_wherever_it_starts():
    series = record(2)
    fit = quasi_ml(DRIVE, series)
    effect = make_effect("harmonic:speed", setting_for(DRIVE, series, np.asarray(fit.theta)))
    since = effect.parameters[3].default
    gains = [
        refit(fit, series, Score(effect, 0.0, -0.2, 1.0, 1.0, 1.0, (sine, 0.83, since))).gain
        for sine in (0.0, 0.35)
    ]
    assert gains[0] == pytest.approx(gains[1], abs=0.1)


@pytest.mark.slow
def test_its_error_is_the_spread_of_estimates(found):
    """Of 30 records with the same wave, the extended model estimated from the truth."""
    series = record(1)
    model = extend(DRIVE, ["harmonic:speed"], setting_for(DRIVE, series, DRIVE.theta()))
    effect = make_effect("harmonic:speed", setting_for(DRIVE, series, DRIVE.theta()))
    free = [name for name in model.parameter_names if not name.endswith("_origin")]
    seen = [
        amplitude_of(effect, quasi_ml(model, record(seed), WAVE, free)) for seed in range(10, 40)
    ]
    values, errors = np.array(seen).T
    assert abs(values.mean() - AMPLITUDE) < 3.0 * values.std() / np.sqrt(30.0)
    assert values.std(ddof=1) == pytest.approx(errors.mean(), rel=0.4)
    assert found.causes[0].amplitude_error == pytest.approx(errors.mean(), rel=0.4)


def fit(names, covariance, cosine=3.0, sine=4.0):
    theta = {"harmonic_speed": cosine, "harmonic_speed_sine": sine}
    at = engine.Theta(list(theta.values()), tuple(theta))
    return QuasiFit(None, at, 0.0, names, np.linalg.inv(covariance), 1, True)


def test_the_error_is_that_of_the_delta_method():
    effect = make_effect("harmonic:speed", Setting(DRIVE))
    names = ("harmonic_speed", "harmonic_speed_sine")
    both = fit(names, np.array([[0.04, 0.01], [0.01, 0.09]]))
    assert amplitude_of(effect, both) == pytest.approx((5.0, np.sqrt(2.04 / 25.0)), rel=1e-6)
    sine = fit(names[1:], np.array([[0.09]]))
    assert amplitude_of(effect, sine) == pytest.approx((5.0, 0.3 * 4.0 / 5.0), rel=1e-6)
    none = fit(names, np.eye(2), 0.0, 0.0)
    assert amplitude_of(effect, none) == pytest.approx((0.0, np.nan), nan_ok=True)
    tied = replace(both, information=np.array([[1.0, 1.0], [1.0, 1.0]]))
    assert amplitude_of(effect, tied) == (5.0, np.inf)


def test_a_wave_is_as_sure_as_its_amplitude_where_one_of_its_parts_is_zero():
    effect = make_effect("harmonic:speed", Setting(DRIVE))
    names = ("harmonic_speed", "harmonic_speed_sine")
    wave = Refit(effect, fit(names, 0.04 * np.eye(2), 0.1, 4.0), 50.0, 40.0)
    assert wave.is_sure
    assert wave.sized == pytest.approx(amplitude_of(effect, wave.fit))
    assert not Refit(effect, fit(names, 0.04 * np.eye(2), 0.1, 0.1), 1.0, 0.0).is_sure


def test_what_is_no_wave_has_no_amplitude():
    step = make_effect("step:speed", Setting(DRIVE))
    assert amplitude_of(step, SimpleNamespace()) == (None, None)
