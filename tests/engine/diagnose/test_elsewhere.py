"""Large effects bend the fit of the model without them: what they are is found from elsewhere."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.diagnose.effects.catalogue import all_effects, make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.judging.verdict import detectable_of
from engine.diagnose.refits import refitting
from engine.diagnose.refits.elsewhere import REFITS, _asked, bent
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.screening.screen import Score, Screen
from tests.engine.hidden_effects import DRIVE, hidden
from tests.engine.plain_models import absorption


@pytest.fixture(scope="module")
def found():
    """A drug that is gone when its sensor is knocked by 0.5 mg/L: rates go to bounds to explain it."""
    truth = {"ka": 0.35, "ke": 1.2, "V": 12.0}
    series = engine.simulate(absorption(), truth, 60, np.random.default_rng(0), dt=0.5).series
    knocked = replace(series, y=series.y + 0.5 * (series.t > 8.0)[:, None])
    kinds = ["step", "pole", "saturation", "mode"]
    return engine.diagnose(absorption(), knocked, seed=1, effects=kinds)


@pytest.mark.slow
def test_the_step_is_named_that_the_bent_fit_does_not_lead_to(found):
    assert bent(found.search.rounds[0].refits, found.series)
    assert found.verdict.value == "named"
    (cause,) = found.causes
    assert cause.effect == "step:concentration"
    assert abs(cause.size - 0.5) < 3.0 * cause.standard_error < 0.3
    assert cause.parameters["step_concentration_time"] == pytest.approx(8.5, abs=0.5)
    best, *others = found.search.rounds[0].refits
    assert best.gain > max(other.gain for other in others) + 10.0


@pytest.mark.long
def test_gains_from_elsewhere_are_those_over_the_same_fit(found):
    base = found.search.base.log_likelihood
    for one in found.search.rounds[0].refits:
        assert one.gain == pytest.approx(2.0 * (one.fit.log_likelihood - base), abs=0.1)


@pytest.mark.long
def test_small_effects_bend_nothing(found):
    refits = found.search.rounds[0].refits
    small = [replace(one, gain=0.5 * found.series.n_measured) for one in refits]
    assert not bent(small, found.series)


@pytest.mark.long
def test_what_the_bent_fit_cannot_test_is_found_from_elsewhere(monkeypatch):
    """A noise that went to 0 has no correlation with another, and a refit of one ended the search."""
    setting = Setting(DRIVE)
    tested, other = (make_effect(name, setting) for name in ("bias:reading", "drag:speed"))
    scores = {e.name: Score(e, 30.0, 0.5, 0.1, 1e-6, 0.5, (), 1.0, 1) for e in (tested, other)}
    seen = Screen((scores[tested.name],), 0.001, 9.0, np.eye(1), np.full(99, 0.5))
    series = hidden(["bias:reading"], {"bias_reading": 0.5}, 1)
    fit = engine.diagnose(DRIVE, series, effects=["bias"], seed=1).search.base
    gains = {tested.name: 2e6, other.name: 3e6}

    def refitted(effect):
        return Refit(effect, fit, gains[effect.name], gains[effect.name])

    monkeypatch.setattr(refitting, "refit", lambda *a: refitted(tested))
    monkeypatch.setattr(refitting, "followed", lambda refits, *a: refits)
    monkeypatch.setattr(refitting, "_beside_look_alikes", lambda refits, *a: refits)
    monkeypatch.setattr(refitting, "without_one_of_many", lambda refits, series: refits)
    found = refitting.refit_best(
        fit,
        series,
        seen,
        setting,
        (),
        lambda *a: None,
        again=lambda refits, kept: ([refitted(other)], [scores[other.name]]),
    )
    sure = refitting.confirmed(found)
    assert sure.refits[0].effect is other
    assert sure.screen.p_value == 0.01  # of 99 draws
    assert [one.testable for one in detectable_of(sure.screen)] == [True, False]


def test_what_looks_like_the_one_that_leads_is_asked_from_elsewhere():
    """The lag of a fridge's sensor was taken for one of its compressor, though likelier by far."""
    setting = Setting(DRIVE)
    names = [
        f"{kind}:speed" for kind in ("drag", "cubic", "coulomb", "linear", "quadratic", "force")
    ]
    names += [
        "bias:reading",
        "gain:reading",
        "saturation:speed",
        "slow-sensor:reading",
        "drift:reading",
    ]
    scores = []
    for k, name in enumerate(names):
        effect = make_effect(name, setting)
        scores.append(Score(effect, 900.0 - 80.0 * k, 0.5, 0.1, 1e-6, 0.5, (), 1.0, 1))
    n = len(scores)
    seen = Screen(tuple(scores), 0.001, 9.0, np.eye(n), np.full(99, 0.5))
    series = hidden([], {}, 1)
    lag = next(effect for effect in all_effects(setting) if effect.kind == "slow-input")
    asked = [score.effect.name for score in _asked(seen, lag, series)]
    assert "slow-sensor:reading" in asked
    assert len(asked) == REFITS + 1
    other = make_effect("drag:speed", setting)
    assert len(_asked(seen, other, series)) == REFITS
