"""Held-out data that contradict what the search gained."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from engine import Series
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.free_run.second_opinion import SecondOpinion
from engine.diagnose.gain.adoption import Decision, falls_short, nothing_better, runs_worse
from engine.diagnose.gain.gain import Gain
from engine.diagnose.gain.narrowing import last_alone
from engine.diagnose.gain.simulation_gain import OutputGain
from engine.diagnose.held_out import HeldOut
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.records import Records
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import Round
from engine.estimation.quasi_ml import quasi_ml
from tests.engine.hidden_effects import DRIVE, hidden

LOSS = Gain(
    how="held-out rows",
    samples=100,
    log_density=-20.0,
    per_sample=-0.2,
    standard_error=0.08,  # 8 nats in all
    p_value=0.99,
    p_loss=0.01,
    outputs=(),
    decision=Decision.NO_EVIDENCE,
)


def test_a_loss_where_a_gain_was_promised_contradicts():
    said = falls_short(LOSS, 10.0)
    assert "loses 20 in log-density" in said
    assert "10 were to be gained" in said
    assert "log-density (as otherwise fitted), where" in falls_short(
        LOSS, 10.0, " (as otherwise fitted)"
    )


def output(after: float, difference: tuple[float, float]) -> OutputGain:
    return OutputGain(
        "y", "m", 1.0, after, (0.9, 1.1), (0.9, 1.1), after - 1.0, difference, 50.0, 40.0, 0.1, None
    )


@pytest.mark.parametrize(
    ("changed", "none"),
    [
        ({}, True),
        ({"outputs": (output(1.01, (-0.2, 0.3)),)}, True),
        ({"outputs": (output(0.99, (-0.3, 0.2)),)}, False),  # a run is better, though not surely
        ({"log_density": -0.9}, False),  # as good as no loss
        ({"log_density": -0.9, "outputs": (output(1.2, (0.0, 0.4)),)}, True),
        ({"log_density": -0.9, "outputs": (output(1.005, (-0.2, 0.3)),)}, False),  # nor is the run
        ({"log_density": 0.1, "outputs": (output(1.2, (0.0, 0.4)),)}, False),
        ({"decision": Decision.ADOPTED}, False),
        ({"samples": 10}, False),  # too few to tell
        ({"log_density": np.nan}, False),
    ],
)
def test_nothing_is_better_where_predictions_lose_and_no_run_gains(changed, none):
    assert nothing_better(replace(LOSS, **changed)) is none


def test_worse_one_step_ahead_and_in_the_free_run_contradicts_whatever_was_promised():
    """As of a step of the record that is gone again where the data go on."""
    worse = replace(LOSS, outputs=(output(1.4, (0.1, 0.7)),))
    said = falls_short(worse, 0.0, " (as otherwise fitted)")
    assert "predicts worse, by 20 in log-density (as otherwise fitted)" in said
    assert "simulates y worse" in said
    perhaps = replace(LOSS, outputs=(output(1.4, (-0.1, 0.7)),))
    assert falls_short(perhaps, 0.0) == ""
    by_chance = replace(worse, p_loss=0.2)
    assert falls_short(by_chance, 0.0) == ""
    assert falls_short(replace(worse, log_density=-0.5), 0.0) == ""


@pytest.mark.parametrize(
    ("gain", "promised"),
    [
        (LOSS, 0.0),  # nothing was promised
        (replace(LOSS, log_density=-0.5, per_sample=-0.005), 30.0),  # as good as no loss
        (replace(LOSS, log_density=-5.0, per_sample=-0.05, standard_error=0.5), 10.0),  # by chance
        (replace(LOSS, decision=Decision.ADOPTED), 10.0),  # its free run is better
        (replace(LOSS, log_density=float("nan")), 10.0),
        (
            replace(LOSS, samples=8, standard_error=1.0),
            10.0,
        ),  # of so few rows the scatter is not known
    ],
)
def test_other_losses_do_not(gain, promised):
    assert falls_short(gain, promised) == ""


@pytest.mark.parametrize(
    ("effects", "promised"),
    [
        (["drag:speed"], (20.0 - 2.0) * 100.0 / 150.0),
        (["drag:speed", "bias:reading"], (20.0 - 2.0) * 100.0 / 150.0),
        (["level:reading"], 0.0),  # noise may be another there
        (["drag:speed", "step:reading"], 0.0),  # what came once need not come again
    ],
)
def test_a_gain_is_promised_in_proportion_to_the_rows_less_a_nat_for_each_parameter(
    effects, promised
):
    """Of 160 rows that were searched ten have no reading; two parameters gained 20 nats there."""
    y = np.zeros(160)
    y[:10] = np.nan
    rounds = [
        SimpleNamespace(refits=(SimpleNamespace(effect=make_effect(name, Setting(DRIVE))),))
        for name in effects
    ]
    for one in rounds:
        one.equivalent = one.refits
    search = SimpleNamespace(
        rounds=[*rounds, SimpleNamespace(refits=(), equivalent=())],
        base=SimpleNamespace(log_likelihood=-120.0, free=("k",)),
        final=SimpleNamespace(log_likelihood=-100.0, free=("k", "size", "another")),
    )
    searched = Series(y, dt=1.0)
    judge = HeldOut(Records(searched), searched, 0, 0.05)
    assert judge._promised(search, LOSS) == pytest.approx(promised)
    # of a record with five times as many samples, one in five was searched
    judge = HeldOut(Records(Series(np.repeat(y, 5), dt=0.2)), searched, 0, 0.05)
    assert judge._promised(search, LOSS) == pytest.approx(promised / 5.0)


def test_what_noise_gains_one_step_ahead_does_not_speak_for_what_is_named_beside_it():
    gains = replace(LOSS, log_density=90.0, p_value=1e-4, p_loss=0.9999, decision=Decision.LOSES)
    worse = replace(gains, outputs=(output(1.6, (0.1, 0.9)),))
    said = runs_worse(worse, ["saturation:y"], ["heavy-tails:x"])
    assert "simulates y worse: its free run of y is wrong by 1.6 m rms instead of 1" in said
    assert "may be by heavy-tails:x, and saturation:y stands in for something else" in said
    assert runs_worse(worse, [], ["heavy-tails:x"]) == ""  # its run is that of the model as given
    assert runs_worse(gains, ["saturation:y"], ["heavy-tails:x"]) == ""
    assert runs_worse(replace(worse, samples=10), ["saturation:y"], ["heavy-tails:x"]) == ""


def test_what_is_gained_from_row_to_row_alone_does_not_speak_for_a_name():
    """As of a wave in the readings of lynxes, which named the cycle that the model has of its own."""
    gains = replace(LOSS, log_density=50.0, p_value=0.007, p_loss=0.993, decision=Decision.LOSES)
    worse = replace(gains, outputs=(output(2.9, (1.1, 2.6)),))
    said = runs_worse(worse, ["harmonic:y"], [])
    assert "simulates y worse: its free run of y is wrong by 2.9 m rms instead of 1" in said
    assert "from row to row alone: harmonic:y stands in for something else, so no cause" in said
    another = replace(output(0.5, (-0.7, -0.3)), output="v")
    assert runs_worse(replace(worse, outputs=(*worse.outputs, another)), ["harmonic:y"], []) == ""
    by_noise = replace(worse.outputs[0], as_worse=0.3)
    assert runs_worse(replace(worse, outputs=(by_noise,)), ["harmonic:y"], []) == ""
    seldom, same = replace(by_noise, as_worse=0.03), replace(output(1.0, (-0.1, 0.1)), output="v")
    for others, refuted in (((), True), ((same,), False)):  # one in 33 of either of two
        outputs = (seldom, *others)
        assert bool(runs_worse(replace(worse, outputs=outputs), ["harmonic:y"], [])) is refuted


@dataclass(frozen=True, eq=False)
class Said(HeldOut):
    """Held-out data that object to some names."""

    objections: dict[str, str]

    def _asked(self, search):
        return None, self.objections.get(search.rounds[0].refits[0].effect.name, "")

    def _heeding_particles(self, judged):
        return judged


@pytest.mark.parametrize(
    ("objections", "verdict", "causes"),
    [
        ({}, Verdict.SET, {"drag:speed", "cubic:speed"}),
        ({"drag:speed": "It loses."}, Verdict.NAMED, {"cubic:speed"}),
        (
            {"drag:speed": "It loses.", "cubic:speed": "So does it."},
            Verdict.UNKNOWN,
            {"drag:speed", "cubic:speed"},
        ),
    ],
)
def test_the_verdict_is_that_of_the_names_to_which_nothing_objects(objections, verdict, causes):
    refits = []
    for name in ("drag:speed", "cubic:speed"):
        effect = make_effect(name, Setting(DRIVE))
        fit = SimpleNamespace(
            theta={p.name: 0.5 for p in effect.parameters}, given_up=False, free=()
        )
        refits.append(
            SimpleNamespace(
                effect=effect, fit=fit, size=0.5, standard_error=0.1, gain=50.0, score=50.0
            )
        )
    scores = tuple(SimpleNamespace(effect=r.effect, statistic=40.0) for r in refits)
    screen = SimpleNamespace(
        p_value=0.002, scores=scores, likeness=lambda i, j: 0.9, at_floor=False
    )
    found = Search(None, None, (Round(screen, tuple(refits), None, tuple(refits)),), False)
    records = SimpleNamespace(held_out=("another record",))
    base = SimpleNamespace(model=SimpleNamespace(na=0))
    judged = Said(records, Series(np.zeros(160), dt=1.0), 0, 0.05, objections).judge(
        SimpleNamespace(search=found, verdict=Verdict.SET, base=base, setting=Setting(DRIVE)),
        SecondOpinion(Verdict.SET, (), False, ""),
    )
    assert judged.verdict is verdict
    assert set(judged.causes[0].equivalent) == causes
    assert len(judged.notes) == (1 if objections else 0)


class Measured(HeldOut):
    """Held-out data on which the likelihood's answer gains nothing, and which know of no other."""

    def _gain(self, search, beside=None):
        return LOSS if beside is None else None

    def _heeding_particles(self, judged):
        return judged


def test_what_is_shown_is_judged_also_where_the_free_run_decides_and_names_nothing():
    """Once the page said that nothing had been held out."""
    found = Search(SimpleNamespace(), SimpleNamespace(), (), False)
    free_run = SimpleNamespace(found=(), verdict=Verdict.UNKNOWN)
    asked = SecondOpinion(Verdict.UNKNOWN, ("step:y",), True, "", search=free_run)
    records = SimpleNamespace(held_out=("another record",))
    judge = Measured(records, Series(np.zeros(160), dt=1.0), 0, 0.05)
    judged = judge.judge(SimpleNamespace(search=found, verdict=Verdict.UNKNOWN), asked)
    assert judged.gain is LOSS
    assert (judged.verdict, judged.free_run.decides) == (Verdict.UNKNOWN, True)


@pytest.mark.long
def test_a_last_name_that_loses_beside_another_is_contradicted_though_both_together_gain():
    """The sensor is off in both records, only the one that was searched has the drag."""
    off = {"bias_reading": 1.0}
    series = hidden(["bias:reading", "drag:speed"], off | {"drag_speed": 0.3}, 0, n=400)
    other = hidden(["bias:reading"], off, 100, n=400)
    bias, drag = (make_effect(name, Setting(DRIVE)) for name in ("bias:reading", "drag:speed"))
    model = drag.apply(bias.apply(DRIVE))
    final = quasi_ml(model, series, model.theta())
    screen = SimpleNamespace(
        p_value=0.002,
        scores=tuple(SimpleNamespace(effect=e, statistic=40.0) for e in (bias, drag)),
        likeness=lambda i, j: 0.0,
        at_floor=False,
    )
    refits = [(Refit(effect, final, 40.0, 40.0),) for effect in (bias, drag)]
    rounds = tuple(Round(screen, one, None, one) for one in refits)
    search = Search(quasi_ml(DRIVE, series, DRIVE.theta()), final, rounds, False)
    gain, said = HeldOut(Records(series, (), (other,)), series, 0, 0.05)._asked(search)
    assert gain.log_density > 0.0
    assert said.startswith("Of drag:speed beside bias:reading: On data that it has not seen")
    alone = last_alone(search, series)
    assert alone.base.theta["drag_speed"] == 0.0
    assert abs(alone.base.theta["bias_reading"] - 1.0) < 0.3
