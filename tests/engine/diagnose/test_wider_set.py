"""Names that the likelihood prefers by little, and that another one beats over the horizon."""

import importlib
from types import SimpleNamespace

import pytest

from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.held_out import Judged
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.over_horizon import Candidate, OverHorizon
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import Round
from engine.diagnose.wider_set import widened
from tests.engine.hidden_effects import DRIVE

module = importlib.import_module("engine.diagnose.wider_set")


def test_what_predicts_better_at_every_horizon_is_as_good_in_place_of_an_effect():
    noise = "variance:v->time"
    rows = [
        Candidate((), (1.0, 1.0), (0.0,)),
        Candidate(("drag:v", noise), (0.95, 1.3), (-35.0,)),
        Candidate(("pole:v", noise), (0.52, 0.76), (-38.0,)),
        Candidate(("bias:y", noise), (0.52, 1.5), (-38.0,)),  # not everywhere
        Candidate(("cubic:v",), (0.5, 0.5), (-38.0,)),  # without the noise
        Candidate(("gain:y", noise), (0.5, 0.5), (-38.0,)),  # ruled out
        Candidate(("drag:v", "step:v"), (0.5, 0.5), (-38.0,)),  # in place of the noise
    ]
    found = OverHorizon((1, 50), (1.0,), tuple(rows))
    assert found.as_good(["pole:v", "bias:y", "cubic:v", "step:v"], "drag:v") == ("pole:v",)


@pytest.mark.parametrize(
    ("behind", "better", "verdict"),
    [(4.0, True, Verdict.SET), (7.0, True, Verdict.NAMED), (4.0, False, Verdict.NAMED)],
)
def test_what_is_behind_by_little_and_better_at_every_horizon_is_in_the_set(
    behind, better, verdict, monkeypatch
):
    monkeypatch.setattr(module, "named_by", lambda search: search.rounds[0].equivalent)
    setting, fit = Setting(DRIVE), SimpleNamespace(given_up=False)
    drag = Refit(make_effect("drag:speed", setting), fit, 40.0, 40.0)
    cubic = Refit(make_effect("cubic:speed", setting), fit, 40.0 - behind, 40.0 - behind)
    search = Search(None, fit, (Round(None, (drag, cubic), None, (drag,)),), False)
    asked = SimpleNamespace(decides=False)
    judged = Judged(Verdict.NAMED, (drag,), None, fit, None, search, asked)
    rows = [Candidate((), (1.0, 1.0), (0.0,)), Candidate(("drag:speed",), (0.9, 0.9), (9.0,))]
    rows.append(Candidate(("cubic:speed",), (0.5, 0.5 if better else 1.2), (8.0,)))
    wide = widened(judged, OverHorizon((1, 50), (1.0,), tuple(rows)))
    assert wide.verdict is verdict
    names = [one.effect.name for one in wide.causes]
    assert names == ["drag:speed", "cubic:speed"][: 2 if verdict is Verdict.SET else 1]
    said = ["cubic:speed is less likely than drag:speed, by too little" in n for n in wide.notes]
    assert said == ([True] if verdict is Verdict.SET else [])
    assert widened(judged, None) is judged
