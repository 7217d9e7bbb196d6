"""A first round between whose names what is left or the error of the steps may decide gets wider.

It keeps its lead.
"""

from types import SimpleNamespace

import pytest

from engine.diagnose.judging import judgement
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.judging.lack_of_fit import LackOfFit
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.rounds import MARGIN, Round


class Found:
    """A refit, as far as it is asked."""

    def __init__(self, name):
        self.effect = SimpleNamespace(name=name, traits=SimpleNamespace(outliers=False))


A, B, C = (Found(name) for name in "abc")


@pytest.mark.parametrize(
    ("worth", "within", "then", "told"),
    [
        (
            0.3,
            (C,),
            (A, B),
            0.0,
        ),  # less than what names need anyway: the set got narrower, and another led
        (
            9.0,
            (C, A),
            (A, C),
            9.0,
        ),  # another led, which the last fit does not hold: the diagnosis broke off
    ],
)
def test_the_lead_stays_and_no_set_gets_narrower(monkeypatch, worth, within, then, told):
    """A gain of a held parameter and a leak: the one that led in turn was not in the last fit, KeyError."""
    margins = []

    def settle(screen, refits, series, setting, margin):
        margins.append(margin)
        if margin < worth or margin == MARGIN:
            return Round(screen, (A, B, C), None, (A, B))
        return Round(screen, (C, A, B), None, within)

    monkeypatch.setattr(judgement, "settle", settle)
    monkeypatch.setattr(judgement, "decides", lambda *args: worth)
    found = Search(None, None, (Round(None, (A, B, C), None, (A, B)),), alarm_left=False)
    kept = SimpleNamespace(within=lambda name: None)
    wide, decided = judgement._widened(found, None, None, kept)
    assert margins == [max(worth, MARGIN)]
    assert decided == told
    assert wide.rounds[0].equivalent == then
    assert wide.rounds[0].refits[0] is A


@pytest.mark.parametrize(("rest", "verdict"), [(30.0, Verdict.SET), (10.0, Verdict.NAMED)])
def test_a_rest_of_the_shape_decides_between_names_that_are_as_near(monkeypatch, rest, verdict):
    """A weir with another exponent: a product was named, 17 ahead of others, of a shape that lacked 46."""

    def settle(screen, refits, series, setting, margin):
        return Round(screen, (A, B), None, (A, B) if margin > 17.0 else (A,))

    found = Search(None, None, (Round(None, (A, B), None, (A,)), Round(None, (), None, ())), False)
    for name, value in {
        "as_one_event": (found, ""),
        "as_between_samples": (found, ()),
        **{
            key: [] for key in ["doubts", "undetermined", "folded", "outliers_at_inputs", "as_open"]
        },
        "_widened": (found, 0.0),
        "verdict_of": Verdict.NAMED,
        "already_there": {},
        "is_small": True,
        "misfit": 1.0,
        "has_tails": False,
        "_shape_left": LackOfFit("head", rest, 3, 0.02, ("head", "head")),
    }.items():
        monkeypatch.setattr(judgement, name, lambda *args, value=value, **named: value)
    monkeypatch.setattr(judgement, "settle", settle)
    A.effect.family = B.effect.family = "state"
    told = judgement.judged(
        None, None, None, found, alpha=0.05, seed=1, kept=None, unnamed=False, read=False
    )
    assert told.verdict is verdict
    assert told.why == ()
    assert ("Those within it are not told apart" in told.notes[-1]) == (verdict is Verdict.SET)
