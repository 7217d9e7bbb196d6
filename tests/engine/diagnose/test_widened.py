"""A first round between whose names the error of the steps may decide gets wider, and keeps its lead."""

from types import SimpleNamespace

import pytest

from engine.diagnose.judging import judgement
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
