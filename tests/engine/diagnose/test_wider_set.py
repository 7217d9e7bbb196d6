"""Names that the likelihood prefers by little, and that another one beats over the horizon."""

import importlib
from types import SimpleNamespace

import numpy as np
import pytest

from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.held_out import Judged
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.over_horizon import Candidate, OverHorizon
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import Round
from engine.diagnose.wider_set import widened, widened_by_records
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


@pytest.mark.parametrize(
    ("gain", "of_the_first", "verdict"),
    [
        (29.0, None, Verdict.SET),  # four values more, each log(50)
        (25.0, None, Verdict.NAMED),
        (29.0, 29.0, Verdict.NAMED),  # and the first one has such values as well
        (None, None, Verdict.NAMED),
    ],
)
def test_a_name_that_explains_as_much_where_records_have_values_of_their_own_is_in_the_set(
    gain, of_the_first, verdict, monkeypatch
):
    """Trees whose growth ends at limits of their own: by one limit for all, growth that falls with time led."""
    monkeypatch.setattr(module, "named_by", lambda search: search.rounds[0].equivalent)
    setting = Setting(DRIVE)
    drift, drag, left, noise = (
        Refit(
            make_effect(name, setting),
            SimpleNamespace(given_up=name == "cubic:speed"),
            score,
            score,
        )
        for name, score in (
            *(("ramp:speed", 40.0), ("drag:speed", 26.0)),
            *(("step:speed", 26.0), ("variance:speed->time", 39.0)),
        )
    )
    own = {id(drift.fit): of_the_first, id(drag.fit): gain, id(left.fit): 99.0, id(noise.fit): 99.0}

    def own_values(fit, series):
        gain = own[id(fit)]
        return (
            None if gain is None else SimpleNamespace(gain=gain, names=("drag_speed",), further=4)
        )

    monkeypatch.setattr(module, "own_values", own_values)
    round_ = Round(None, (drift, noise, drag, left), None, (drift,))
    asked = SimpleNamespace(decides=False)
    none = SimpleNamespace(log_likelihood=0.0)
    search = Search(none, none, (round_,), False)
    judged = Judged(Verdict.NAMED, (drift,), None, drift.fit, None, search, asked)
    records = SimpleNamespace(begins=(10, 20, 30, 40), n_measured=50)
    assert 26.0 + 25.0 - 4 * np.log(50) < 38.0 < 26.0 + 29.0 - 4 * np.log(50)
    wide = widened_by_records(judged, records)
    assert wide.verdict is verdict
    if verdict is Verdict.SET:
        assert [one.effect.name for one in wide.causes] == ["ramp:speed", "drag:speed"]
        assert (
            "drag:speed with values of drag_speed for each of them explains as much"
            in wide.notes[-1]
        )
    assert widened_by_records(judged, SimpleNamespace(begins=())) is judged


@pytest.mark.parametrize(("gain", "verdict"), [(45.0, Verdict.UNKNOWN), (35.0, Verdict.NAMED)])
def test_two_names_in_turn_are_none_where_one_explains_as_much_by_records(
    gain, verdict, monkeypatch
):
    """As those that are patches on growth whose limit is another one in each record may do together."""
    setting = Setting(DRIVE)
    base, final = SimpleNamespace(log_likelihood=0.0), SimpleNamespace(log_likelihood=25.0)

    def refit(name, score):
        return Refit(make_effect(name, setting), SimpleNamespace(given_up=True), score + 4.0, score)

    first, second, drag = (
        refit("gain:reading", 30.0),
        refit("ramp:speed", 9.0),
        refit("drag:speed", 9.0),
    )
    own = {id(drag.fit): SimpleNamespace(gain=gain, names=("drag_speed",), further=3)}
    monkeypatch.setattr(module, "own_values", lambda fit, series: own.get(id(fit)))
    rounds = Round(None, (first,), None, (first,)), Round(None, (second,), None, (second,))
    begun = Round(None, (first, drag), None, (first,))
    asked = SimpleNamespace(decides=False)
    search = Search(base, final, rounds, False, begun=begun)
    judged = Judged(Verdict.NAMED, (first, second), None, None, None, search, asked)
    least = 50.0 - 8.0 - np.log(50) - 2.0  # two sizes, each with 4 of further parameters
    assert 9.0 + 35.0 - 3 * np.log(50) < least < 9.0 + 45.0 - 3 * np.log(50)
    told = widened_by_records(judged, SimpleNamespace(begins=(10, 20, 30), n_measured=50))
    assert told.verdict is verdict
    assert [note.endswith("no cause is named.") for note in told.notes] == [True] * (gain > 40.0)
