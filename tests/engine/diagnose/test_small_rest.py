"""A small rest that nothing names leaves the name of nearly all that was wrong; a large one does not."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import engine
from engine.diagnose import extend, make_effect
from engine.diagnose.effects.setting import setting_for
from engine.diagnose.search import small_rest
from engine.diagnose.search.findings import Verdict
from engine.diagnose.search.found import Search
from engine.diagnose.search.refits import Refit
from engine.diagnose.search.rounds import Round
from engine.diagnose.search.small_rest import first_alone
from engine.diagnose.search.verdict import doubts, verdict_of
from engine.estimation.quasi_ml import quasi_ml
from tests.engine.diagnose.test_friction import DT, body, measured

FREE = ["q", "r"]


@pytest.fixture(scope="module")
def record():
    x, u = measured(T=200)
    noise = 1e-3 * np.random.default_rng(2).standard_normal(len(x))
    return engine.Series(x + noise, u, dt=DT, y_names=["y"], u_names=["force"])


def fitted(series, *names):
    """The fit of the model with these effects, from sizes that are near."""
    model = body()
    setting = setting_for(model, series, np.asarray(model.theta()))
    effects = [make_effect(name, setting) for name in names]
    extended = extend(model, list(names), setting)
    sizes = {e.size.name: 0.9 if e.kind == "coulomb" else 1e-3 for e in effects}
    fit = quasi_ml(extended, series, extended.theta(sizes), [*FREE, *sizes])
    return fit, effects


def found_in_turn(series, first, second):
    """As a search leaves it that found two effects, and something more beside them that nothing explains."""
    base, _ = fitted(series)
    rounds, before, names = [], base, []
    for name in (first, second):
        names.append(name)
        fit, effects = fitted(series, *names)
        gain = 2.0 * (fit.log_likelihood - before.log_likelihood)
        one, before = Refit(effects[-1], fit, gain, gain), fit
        rounds.append(Round(seen(name), (one,), None, (one,)))
    rounds.append(Round(seen("pole:x", 12.0), (), None, ()))
    return Search(base, before, tuple(rounds), True, begun=rounds[0])


def seen(name, statistic=40.0):
    traits = SimpleNamespace(unnamed=False, outliers=False)
    effect = SimpleNamespace(name=name, kind=name.partition(":")[0], traits=traits)
    score = SimpleNamespace(effect=effect, p_value=1e-4, statistic=statistic)
    screen: Any = SimpleNamespace(scores=[score], p_value=0.002, at_floor=True)
    return screen


def test_nearly_all_that_is_wrong_has_its_name_whatever_the_rest_is(record):
    found = found_in_turn(record, "coulomb:v", "bias:y")
    assert verdict_of(found, 0.05) is Verdict.UNKNOWN
    alone = first_alone(found, record)
    assert alone is not None
    assert [one.effect.name for one in alone.named] == ["coulomb:v"]
    assert verdict_of(alone, 0.05) is Verdict.NAMED
    assert alone.final.theta["coulomb_v"] == pytest.approx(1.0, rel=0.02)
    assert "bias_y" not in alone.final.theta.names
    (said,) = doubts(alone, 0.05)
    assert said.startswith("Something more is seen beside coulomb:v (p <= 0.002), a small part")
    assert "most like bias:y" in said


def test_a_name_for_a_part_of_what_is_wrong_is_not_kept(record):
    assert first_alone(found_in_turn(record, "bias:y", "coulomb:v"), record) is None


def test_a_free_run_that_stays_as_wrong_is_not_explained(record, monkeypatch):
    """As of a patch on the noise, which gains one step ahead only."""
    errors = iter([0.5, 1.0])
    monkeypatch.setattr(small_rest, "_run_error", lambda *_: next(errors))
    assert first_alone(found_in_turn(record, "coulomb:v", "bias:y"), record) is None
