"""What becomes of a set where held-out data speak against some of its members."""

from types import SimpleNamespace

import pytest

from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.gain.narrowing import narrowed
from engine.diagnose.judging.findings import AS_LIKELY, CONTRADICTED
from engine.diagnose.judging.verdict import _look_alikes
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import MARGIN, Round
from tests.engine.hidden_effects import DRIVE

SCORES = {"drift:reading": 12.0, "force:speed": 10.5, "drag:speed": 9.0, "cubic:speed": 3.0}
FIT = SimpleNamespace(given_up=False)


def settled(found, refits):
    """The set by the margin alone."""
    ranked = tuple(sorted(refits, key=lambda r: -r.score))
    near = tuple(r for r in ranked if r.score >= ranked[0].score - MARGIN)
    return Round(None if found is None else found.screen, ranked, None, near)


def searched(scores):
    setting = Setting(DRIVE)
    refits = [Refit(make_effect(n, setting), FIT, score, score) for n, score in scores.items()]
    return Search(None, refits[0].fit, (settled(None, refits),), False)


@pytest.mark.parametrize(
    ("against", "left"),
    [
        (["drift:reading"], ["force:speed", "drag:speed"]),  # drag is as near to the force
        (["drift:reading", "drag:speed"], ["force:speed"]),
        (["force:speed"], ["drift:reading", "force:speed"]),  # nobody is asked but the first
    ],
)
def test_a_set_without_its_best_member_is_what_comes_near_the_next_one(against, left):
    asked = []

    def ask(order):
        asked.append(order.rounds[0].refits[0].effect.name)
        return None, "loses" if asked[-1] in against else ""

    found = searched(SCORES)
    narrow = narrowed(found, ask, settled)
    (one,) = narrow.search.rounds
    assert [r.effect.name for r in one.equivalent] == left
    assert one.refits[0] is one.equivalent[0]
    assert len(asked) == len(set(asked))
    assert "cubic:speed" not in asked
    if narrow.search is not found:
        assert {r.effect.name for r in one.contradicted} == set(against)
        assert all(name in narrow.note for name in (*against, *left))


def told_of(one, names):
    """What is said of each beside the first of a round."""
    setting = Setting(DRIVE)
    scores = tuple(SimpleNamespace(effect=make_effect(n, setting), statistic=9.0) for n in names)
    screen = SimpleNamespace(scores=scores, likeness=lambda i, j: 0.1)
    seen = Round(screen, one.refits, None, one.equivalent, one.contradicted)
    return {other.effect: other.difference for other in _look_alikes(seen, seen.refits[0])}


def test_what_held_out_data_contradict_does_not_say_the_same_in_other_words():
    def ask(order):
        first = order.rounds[0].refits[0].effect.name
        return None, "loses" if first == "drift:reading" else ""

    (one,) = narrowed(searched(SCORES), ask, settled).search.rounds
    assert told_of(one, SCORES)["drift:reading"] == CONTRADICTED


def test_a_refit_from_elsewhere_may_lead_though_the_screen_has_not_seen_it():
    """Beside what was found before it an effect may not be tested; its likeness to others is not known."""
    (one,) = searched(SCORES).rounds
    lead = one.refits[0].effect.name
    others = [name for name in SCORES if name != lead]
    assert set(told_of(one, others)) == set(others)


def test_a_wider_kind_does_not_say_the_same_in_other_words():
    """Stribeck's friction has Coulomb's at the end of its range, and more parameters: not the same thing."""
    scores = {"coulomb:speed": 10.0, "stribeck:speed": 10.5}
    found = searched(scores).rounds[0]
    coulomb = next(r for r in found.refits if r.effect.kind == "coulomb")
    stribeck = next(r for r in found.refits if r.effect.kind == "stribeck")
    one = Round(None, (coulomb, stribeck), None, (coulomb,))
    assert told_of(one, scores)["stribeck:speed"] == AS_LIKELY
