"""Which name stands for refits that say the same, and what is never left half-way."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.refits import likeness, refitting
from engine.diagnose.refits import refitted as refits_of
from engine.diagnose.refits.likeness import NEEDED, TIE, distinct
from engine.diagnose.refits.rounds import settle
from tests.engine.hidden_effects import DRIVE


class Place(Setting):
    """A setting in which the speed is known to be a rate, a position, or neither."""

    sort = "rate"

    def is_rate(self, state):
        return self.sort == "rate"

    def has_rate(self, state):
        return self.sort == "position"


def place(sort):
    found = Place(DRIVE)
    object.__setattr__(found, "sort", sort)
    return found


def refits(*named):
    """name, score, what it predicts -> refits whose log-densities are that constant."""
    return [
        SimpleNamespace(effect=make_effect(name, Setting(DRIVE)), score=score, fit=what)
        for name, score, what in named
    ]


@pytest.fixture(autouse=True)
def _predictions(monkeypatch):
    monkeypatch.setattr(likeness, "held_out_terms", lambda fit, series: np.full(4, float(fit)))


def names(found):
    return [r.effect.name for r in found]


@pytest.mark.parametrize(
    ("sort", "left"),
    [
        ("rate", ["drag:speed"]),
        ("position", ["cubic:speed"]),
        ("neither", ["drag:speed", "cubic:speed"]),  # the data cannot say: a set
    ],
)
def test_of_the_same_in_other_words_the_natural_one_is_said(sort, left):
    alike = refits(("drag:speed", 40.0, 1.0), ("cubic:speed", 40.0 - TIE / 2, 1.0))
    assert names(distinct(alike, None, place(sort))) == left


def test_what_fits_better_is_not_displaced_by_what_is_natural():
    alike = refits(("cubic:speed", 40.0, 1.0), ("drag:speed", 40.0 - 2 * TIE, 1.0))
    assert names(distinct(alike, None, place("rate"))) == ["cubic:speed", "drag:speed"]


def test_what_predicts_otherwise_stays():
    unlike = refits(("drag:speed", 40.0, 1.0), ("cubic:speed", 39.9, 2.0))
    assert len(distinct(unlike, None, place("rate"))) == 2


def test_the_plainer_name_stands_for_the_same_thing():
    alike = refits(("pulse:speed", 40.0, 1.0), ("step:reading", 39.8, 1.0))
    assert names(distinct(alike, None, place("neither"))) == ["step:reading"]


@pytest.mark.parametrize("other", ["force:speed", "input-offset:force"])
def test_a_sensors_bias_does_not_stand_for_what_pushes_the_plant(other):
    alike = refits((other, 40.0, 1.0), ("bias:reading", 39.9, 1.0))
    assert names(distinct(alike, None, place("neither"))) == [other, "bias:reading"]


def test_a_held_value_of_the_plant_does_not_stand_for_a_sensor():
    """The gain of an ammeter and the inductance of its motor say the same, and are two repairs."""
    alike = refits(("gain:reading", 40.0, 1.0), ("held:load", 39.9, 1.0))
    assert names(distinct(alike, None, place("neither"))) == ["gain:reading", "held:load"]
    pushes = refits(("coulomb:speed", 40.0, 1.0), ("held:damping", 39.9, 1.0))
    assert names(distinct(pushes, None, place("neither"))) == ["held:damping"]


def test_of_the_same_push_the_plainer_name_is_said():
    alike = refits(("input-offset:force", 40.0, 1.0), ("force:speed", 39.9, 1.0))
    assert names(distinct(alike, None, place("neither"))) == ["force:speed"]


@pytest.mark.parametrize("ahead", [-1e-6, 1e-6, 0.04])
def test_rounding_does_not_decide_which_name_leads(ahead):
    """The square and the drag of what has one sign are one; in other units the other one was ahead."""
    even = refits(("drag:speed", 40.0 + ahead, 1.0), ("quadratic:speed", 40.0, 1.0))
    assert names(settle(None, even, None, place("neither")).equivalent)[0] == "drag:speed"


def test_a_parameter_that_was_held_leads_a_set_unless_another_repair_does():
    """What the model has needs no extension; but a sensor's fault is not the plant's."""
    plant = refits(("coulomb:speed", 40.0, 1.0), ("held:damping", 38.5, 2.0))
    found = settle(None, plant, None, place("neither")).equivalent
    assert names(found) == ["held:damping", "coulomb:speed"]
    sensor = refits(("gain:reading", 40.0, 1.0), ("held:damping", 38.5, 2.0))
    found = settle(None, sensor, None, place("neither")).equivalent
    assert names(found) == ["gain:reading", "held:damping"]


def test_a_wider_kind_must_be_clearly_ahead_of_what_it_contains():
    """Stribeck friction is Coulomb friction with one parameter more, even where it predicts otherwise."""
    for ahead, left in ((0.5, ["coulomb:speed"]), (2.0, ["stribeck:speed", "coulomb:speed"])):
        wide = ("stribeck:speed", 40.0 + ahead * NEEDED, 2.0)
        both = refits(wide, ("coulomb:speed", 40.0, 1.0))
        assert names(distinct(both, None, place("rate"))) == left
    elsewhere = refits(("stribeck:speed", 40.0, 2.0), ("coulomb:load", 40.0, 1.0))
    assert len(distinct(elsewhere, None, place("rate"))) == 2


@pytest.mark.parametrize(
    ("wide", "plain"),
    [
        ("episode:speed", "step:speed"),
        ("episode:reading", "pulse:reading"),
        ("parameter-episode:damping", "parameter-step:damping"),
    ],
)
def test_an_episode_that_is_not_over_before_the_record_is_a_step(wide, plain):
    """Or a pulse where it lasts one sample: its end must gain more than it costs."""
    both = refits((wide, 40.0, 2.0), (plain, 39.0, 1.0))
    assert names(distinct(both, None, place("neither"))) == [plain]
    surely = refits((wide, 40.0, 2.0), (plain, 37.0, 1.0))
    assert wide in names(distinct(surely, None, place("neither")))


def half_way(score, ends_at, name):
    """A refit given up at a score, which would end at another."""
    return SimpleNamespace(
        effect=make_effect(name, Setting(DRIVE)),
        score=score,
        ends_at=ends_at,
        fit=SimpleNamespace(given_up=True, model=DRIVE),
    )


def test_no_rival_within_reach_is_left_half_way(monkeypatch):
    """An input offset stopped at 45.9, whose maximum is 69, where 56.3 was the best that had ended."""
    taken = []

    def taken_up(refit, series):
        taken.append(refit.effect.name)
        return SimpleNamespace(
            effect=refit.effect, score=refit.ends_at, fit=SimpleNamespace(given_up=False)
        )

    monkeypatch.setattr(refitting, "taken_up", taken_up)
    done = SimpleNamespace(
        effect=make_effect("linear:speed", Setting(DRIVE)),
        score=56.3,
        fit=SimpleNamespace(given_up=False),
    )
    offset = half_way(45.9, 69.0, "input-offset:force")
    far = half_way(10.0, 12.0, "bias:reading")
    found = refitting.followed([done, offset, far], None, SimpleNamespace(model=DRIVE))
    assert max(found, key=lambda r: r.score).effect.name == "input-offset:force"
    assert taken == ["input-offset:force"]
    assert [r.fit.given_up for r in found] == [False, False, True]


@pytest.mark.parametrize(
    ("unit", "effect", "is_odd"),
    [
        ("m/s", "coulomb:speed", False),
        ("rpm", "stribeck:speed", False),
        ("counts/s", "coulomb:speed", False),  # nobody knows
        ("", "coulomb:speed", False),
        ("degC", "coulomb:speed", True),
        ("V", "stribeck:speed", True),
        ("degF", "overflow:speed", True),
        ("m", "overflow:speed", False),
        ("degC", "drag:speed", False),
    ],
)
def test_what_nothing_does_at_such_a_channel_is_less_likely_beforehand(unit, effect, is_odd):
    """Dry friction of a temperature; its size has a price, where others have none."""
    model = replace(DRIVE, nonlinear={"speed": unit})
    made, series = make_effect(effect, Setting(model)), SimpleNamespace(n_measured=100)
    assert made.traits.odd == is_odd
    price = refits_of.further_parameters(made) * np.log(100)
    assert refits_of.cost(made, series) == pytest.approx(price + is_odd * refits_of.UNLIKELIER)


def test_what_needs_a_time_constant_is_refitted_beside_what_leads():
    """The screen sees the slope at none: of a sensor behind by twenty samples hardly anything."""
    slow, path = (
        make_effect(n, Setting(DRIVE)) for n in ("slow-sensor:reading", "path:force->speed")
    )
    assert refitting._look_alikes(slow, path)
    assert not refitting._look_alikes(make_effect("bias:reading", Setting(DRIVE)), path)
