"""A model that was extended by what a diagnosis found is a model like any other: it is diagnosed again."""

import numpy as np
import pytest

import engine
from engine.diagnose import all_effects, diagnose, extend
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.steps.substeps import choose


@pytest.mark.long
@pytest.mark.parametrize("name", ["oscillator", "local-level"])
def test_no_effect_that_a_model_has_is_offered_again(name: str) -> None:
    model = engine.get_model(name)
    for effect in all_effects(Setting(model))[::6]:
        there = all_effects(Setting(effect.apply(model)))
        assert effect.name not in [other.name for other in there], effect.name
        for other in there[::12]:
            other.apply(effect.apply(model))  # raises where parameters have the same names


@pytest.mark.parametrize("kind", ["force", "cubic"])
def test_steps_are_chosen_for_an_extended_model(kind: str) -> None:
    rng = np.random.default_rng(1)
    channel = {"cubic": "position->velocity"}.get(kind, "velocity")
    plain = engine.get_model("oscillator")
    u = np.repeat(rng.standard_normal((10, 1)), 10, axis=0)
    series = engine.simulate(plain, plain.theta(), 100, rng, u=u, dt=0.1).series
    model = extend(plain, [f"{kind}:{channel}"])
    theta = np.asarray(model.theta())
    assert choose(setting_for(model, series, theta), series, theta) >= 1


@pytest.mark.slow
def test_a_diagnosis_of_an_extended_model() -> None:
    rng = np.random.default_rng(2)
    plain = engine.get_model("oscillator")
    model = extend(plain, ["force:velocity"])
    u = np.repeat(rng.standard_normal((20, 1)), 15, axis=0)
    theta = model.theta({"force_velocity": 2.0})
    series = engine.simulate(model, theta, 300, rng, u=u, dt=0.1).series
    found = diagnose(model, series, effects=["force", "cubic", "bias"], max_effects=1)
    assert found.verdict.value == "nothing"
    assert "force:velocity" not in [x.effect for x in found.detectable]
    again = found.before.theta["force_velocity"]
    assert abs(again - 2.0) < 0.5
