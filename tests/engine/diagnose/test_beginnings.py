"""Of two faults the first that is named may be neither: another beginning is tried, and told where even."""

from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace as Of

import numpy as np
import pytest

import engine
from engine.data.series import Series
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.rounds import FORESEEN, Round
from engine.diagnose.search.beginnings import best_beginning, may_begin_otherwise
from engine.diagnose.search.search import ANEW, TWICE, _by_rounds
from tests.engine.diagnose.test_held import kettle


def refit(name, score=0.0, outliers=False):
    family = "noise" if name in ("variance", "level") else "state"
    traits = Of(outliers=outliers, unnamed=False, bends=name == "bend")
    effect = Of(name=name, kind=name, family=family, traits=traits)
    return Of(effect=effect, score=score, fit=Of(log_likelihood=0.0))


def a_round(*refits, equivalent=1):
    return Round(Of(scores=range(8)), refits, None, refits[:equivalent])


def a_search(gain, *names):
    ends = Of(log_likelihood=0.0), Of(log_likelihood=0.5 * gain)
    return Search(*ends, tuple(a_round(refit(name)) for name in names), False)


BEGUN = a_round(
    refit("pulse", 80.0), refit("variance", 50.0), refit("step", 40.0), refit("bias", 1.0)
)
LEFT = {"variance": 10.0, "step": 50.0, "bias": 60.0}


def beside(rival, bend):
    assert not bend
    return FORESEEN * LEFT[rival.effect.name]


@pytest.fixture(autouse=True)
def no_costs(monkeypatch):
    """But those of sizes, for a series of twenty readings: 3."""
    monkeypatch.setattr(import_module("engine.diagnose.refits.found"), "cost", lambda *_: 0.0)


SERIES = Of(n_measured=np.exp(3.0))


@pytest.mark.parametrize(
    ("gain", "better", "as_well"),
    [(110.0, True, ()), (99.0, False, ("drag", "step")), (90.0, False, ())],
)
def test_the_most_promising_rival_is_tried_as_the_first(gain, better, as_well):
    found, tried = a_search(100.0, "pulse", "path"), []

    def other(first, simulating):
        tried.append((first.refits[0].effect.name, simulating))
        assert [one.effect.name for one in first.equivalent] == ["step"]
        return a_search(gain, "step", "drag")

    best = best_beginning(found, BEGUN, SERIES, beside, other)
    # what is behind even where nothing is doubted need not be doubted
    assert tried == [("step", False), ("step", True)][: 1 if gain == 90.0 else 2]
    assert [one.effect.name for one in best.named] == (
        ["step", "drag"] if better else ["pulse", "path"]
    )
    assert best.as_well == as_well


def test_what_is_ahead_only_where_nothing_is_doubted_is_not_taken():
    found = a_search(100.0, "pulse", "path")
    best = best_beginning(
        found,
        BEGUN,
        SERIES,
        beside,
        lambda first, simulating: a_search(90.0 if simulating else 120.0, "step"),
    )
    assert best is found


def test_what_has_been_looked_for_and_not_seen_is_not_begun_with():
    """A search that ends without an alarm has asked for a third effect; a beginning with it asks nobody."""
    found = a_search(100.0, "pulse", "path")
    more = best_beginning(
        found, BEGUN, SERIES, beside, lambda *_: a_search(120.0, "step", "pulse", "path")
    )
    assert more is found
    left = replace(found, alarm_left=True)
    more = best_beginning(
        left, BEGUN, SERIES, beside, lambda *_: a_search(120.0, "step", "pulse", "path")
    )
    assert len(more.named) == 3


def test_those_that_share_an_effect_are_not_told_and_none_is_tried_in_vain():
    found = a_search(100.0, "pulse", "drag")
    even = best_beginning(found, BEGUN, SERIES, beside, lambda *_: a_search(99.5, "step", "drag"))
    assert even is found
    far = a_search(500.0, "pulse", "path")
    assert best_beginning(far, BEGUN, SERIES, beside, lambda *_: pytest.fail("tried")) is far


@pytest.mark.parametrize(("gain", "better"), [(99.5, True), (96.0, False)])
def test_fewer_effects_are_ahead_of_more_that_gain_hardly_more(gain, better):
    """A third that mends what is wrong with the first is not needed where another one begins."""
    found = a_search(100.0, "pulse", "drag", "hold")
    best = best_beginning(found, BEGUN, SERIES, beside, lambda *_: a_search(gain, "step", "drag"))
    assert (best is found) != better


@pytest.mark.parametrize(
    ("gain", "alarm_left", "better"),
    [(107.0, False, False), (107.0, True, True), (111.0, False, True)],
)
def test_more_effects_gain_more_by_the_choice_alone(gain, alarm_left, better):
    """A drag beside a bent sensor left nothing; a cubic force, that sensor and friction were 3 ahead."""
    found = replace(a_search(100.0, "pulse", "path"), alarm_left=alarm_left)
    more = a_search(gain, "step", "path", "bias")
    assert (best_beginning(found, BEGUN, SERIES, beside, lambda *_: more) is more) == better


@pytest.mark.parametrize("begin", [0.0, TWICE])
def test_another_search_is_a_stage_that_moves_with_its_rounds(begin):
    """It may take minutes, in which nothing else was told than that the stage before is done."""
    told = []
    progress = _by_rounds(lambda stage, share: told.append((stage, share)), begin, 4)
    for stage in ("screen", "screen", "refit", "screen", "calibration", "refit", "looking back"):
        progress(stage, 0.0)
    assert {stage for stage, _ in told} == {ANEW}
    shares = [share - begin for _, share in told]
    assert shares == [1 / 8, 1 / 8, 1 / 8, 1 / 4, 1 / 4, 1 / 4, 1 / 4]


def test_one_effect_and_outliers_begin_in_one_way():
    assert may_begin_otherwise(a_search(10.0, "drag", "step"), BEGUN)
    assert not may_begin_otherwise(a_search(10.0, "drag"), BEGUN)
    tails = Search(None, None, (a_round(refit("a")), a_round(refit("b", outliers=True))), False)
    assert not may_begin_otherwise(tails, BEGUN)


def test_noise_that_leads_alone_is_doubted_by_another_beginning_that_is_no_noise():
    """What several faults leave together looks like noise, beside which nothing is seen."""
    found, tried = a_search(85.0, "variance"), []
    assert may_begin_otherwise(found, BEGUN)
    begun = a_round(refit("variance", 85.0), refit("level", 84.0), *BEGUN.refits[2:])

    def other(first, simulating):
        tried.append(first.refits[0].effect.name)
        return a_search(150.0, "step", "drag")

    assert [
        one.effect.name for one in best_beginning(found, begun, SERIES, beside, other).named
    ] == [
        "step",
        "drag",
    ]
    assert tried == ["step", "step"]


@pytest.mark.parametrize("gain", [111.0, 100.0])
def test_beside_one_effect_the_drift_behind_it_is_tried_for_its_bend(gain):
    """The bend is a part of the drift: it pays for its size, and not for having been chosen among all."""
    found = a_search(100.0, "path")
    begun = a_round(refit("path", 100.0), refit("pole", 99.0), refit("parameter-drift", 90.0))
    assert may_begin_otherwise(found, begun)

    def seen(rival, bend):
        assert bend
        assert rival.effect.kind == "parameter-drift"
        return 60.0

    def other(first, simulating):
        return a_search(gain, "parameter-drift", "bend")

    best = best_beginning(found, begun, SERIES, seen, other)
    assert (best is found) == (gain < 105.0)


def test_beside_a_drift_no_other_is_tried():
    begun = a_round(refit("drift", 100.0), refit("ramp", 99.0))
    assert not may_begin_otherwise(a_search(100.0, "drift"), begun)


@pytest.mark.slow
def test_a_drag_and_a_knock_of_the_sensor():
    """They were named a pulse of the force and a path from the input, which hold each other."""
    rng = np.random.default_rng(6)
    u = np.repeat(rng.uniform(0.0, 20.0, 10), 20)
    T, y, kept = 0.0, np.empty(200), np.exp(-1.0 / 25.0)
    for i in range(200):
        y[i] = T + 0.2 * rng.standard_normal() + 1.5 * (i >= 90)
        heated = (1.0 - kept) * 25.0 * 0.06 * u[i] + np.sqrt(1e-3) * rng.standard_normal()
        T = kept * T + heated - 4e-3 * T * abs(T)
    found = engine.diagnose(kettle(20.0), Series(y, u, dt=1.0), seed=0)
    names = [set(cause.equivalent) for cause in found.causes]
    assert [bool(one & {"step:reading", "drag:T"}) for one in names] == [True, True]
