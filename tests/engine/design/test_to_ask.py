"""What the document of a diagnosis asks of a design: the same as the diagnosis itself, whatever decided."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

import engine
from engine.design.candidates import before_any
from engine.design.rivals import of_diagnosis, rivals_of, to_ask
from engine.diagnose import extend
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.free_run.answer import search_free_runs
from engine.diagnose.judging.findings import Verdict
from engine.errors import OptionError
from engine.estimation.quasi_ml import quasi_ml

MODEL = engine.get_model("oscillator")


def record(effects, values, T=200):
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(-1, 1, T // 10), 10)
    true = engine.get_model("oscillator", effects=effects)
    return engine.simulate(true, values, T, rng, u=u, dt=0.05).series


def told_of(rounds, free_run=None, verdict=Verdict.SET):
    search = SimpleNamespace(rounds=rounds, base=None)
    return SimpleNamespace(
        free_run=free_run, search=search, verdict=verdict, measured=("y",), model=MODEL
    )


def a_round(*refits, left):
    return SimpleNamespace(
        refits=refits, equivalent=refits[:left], screen=SimpleNamespace(threshold=9.5)
    )


def refitted(model, series, name):
    effect = make_effect(name, Setting(model, dt=series.dt))
    extended = effect.apply(model)
    fit = quasi_ml(extended, series, {effect.size.name: 0.3}, max_iterations=1)
    return SimpleNamespace(effect=effect, fit=fit, score=10.0)


def asked_again(diagnosis):
    """What a service reads: through JSON, with a model that is built from its name."""
    told = json.loads(json.dumps(to_ask(diagnosis)))
    model = extend(MODEL, told["with"])
    return before_any(
        model, told["causes"], told["theta"], 0.05, told["free"], told["alarm"], told["measured"]
    )


def the_same(question, other):
    assert [c.name for c in question.candidates] == [c.name for c in other.candidates]
    assert question.alarm == other.alarm
    for one, two in zip(
        (*question.candidates, question.base), (*other.candidates, other.base), strict=True
    ):
        assert one.free == two.free
        assert one.model.parameter_names == two.model.parameter_names
        np.testing.assert_allclose(two.theta, one.theta)
        assert (one.further, one.rank) == (two.further, two.rank)
        if one is not question.base:
            np.testing.assert_allclose(two.information, one.information)


@pytest.mark.long
def test_what_an_earlier_round_found_is_in_the_model():
    series = record(["coulomb:velocity"], {"coulomb_velocity": 0.5})
    first = refitted(MODEL, series, "coulomb:velocity")
    rivals = [refitted(first.fit.model, series, name) for name in ("drag:velocity", "gain:y")]
    diagnosis = told_of([a_round(first, left=1), a_round(*rivals, left=2)])
    told = to_ask(diagnosis)
    assert told["with"] == ["coulomb:velocity"]
    assert "coulomb_velocity" in told["theta"]
    the_same(of_diagnosis(diagnosis, None), asked_again(diagnosis))


@pytest.mark.slow
def test_where_the_free_run_decided_its_causes_are_asked_for():
    """Pairs among them; the likelihood's rounds say something else here."""
    series = record(["cubic:position->velocity"], {"cubic_position__velocity": -20.0}, T=240)
    base = quasi_ml(MODEL, series, MODEL.theta(), max_iterations=3)
    found = search_free_runs(
        base,
        [series],
        MODEL.theta(),
        levels=(0.05, 0.01),
        kinds=("cubic", "drag", "force", "bias", "gain"),
        seed=1,
        progress=lambda stage, fraction: None,
    )
    assert found.found
    likelihood = [a_round(refitted(MODEL, series, "bias:y"), left=1)]
    diagnosis = told_of(likelihood, SimpleNamespace(decides=True, search=found))
    names = [one.name for one in rivals_of(diagnosis).several]
    assert names[0] != "bias:y"
    assert any("cubic" in name for name in names)
    question, other = of_diagnosis(diagnosis, None), asked_again(diagnosis)
    the_same(question, other)


def test_effects_that_are_one_cause_need_a_size_each():
    both = "cubic:position->velocity + force:velocity"
    sizes = {"cubic_position__velocity": -20.0, "force_velocity": 0.3}
    question = before_any(MODEL, {both: sizes, "drag:velocity": 0.3}, None, 0.05, None)
    pair = question.candidates[0]
    assert pair.name == both
    assert pair.further == 1  # the second size must earn its place
    assert pair.theta[pair.model.index("force_velocity")] == 0.3
    for given, field in ((1.0, f"causes.{both}"), ({"force_velocity": 0.3}, f"causes.{both}")):
        wrong = given if isinstance(given, float) else {**given, "cubic_position__velocity": 0.0}
        with pytest.raises(OptionError) as refused:
            before_any(MODEL, {both: wrong, "drag:velocity": 0.3}, None, 0.05, None)
        assert refused.value.field == field


def test_fewer_than_two_causes_are_nothing_to_ask():
    assert to_ask(told_of([], verdict=Verdict.NOTHING)) is None
