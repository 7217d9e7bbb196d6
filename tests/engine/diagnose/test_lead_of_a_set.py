"""Which of several names that the data do not tell apart comes first."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import engine
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import _led

BEND, FORCE = "quadratic:position->velocity", "force:velocity"  # its zero is estimated
SETTING = Setting(engine.get_model("servo"))


def refit(name, size, error, score):
    effect = replace(make_effect(name, SETTING), held=())
    fit = SimpleNamespace(
        theta={effect.size.name: size},
        free=[effect.size.name],
        standard_errors=np.array([error]),
    )
    return Refit(effect, fit, score, score)


@pytest.mark.parametrize(
    ("of_bend", "of_force", "first"),
    [
        ((0.0041, 0.0028), (0.053, 0.006), FORCE),  # a bend whose end alone is seen
        ((0.0041, np.nan), (0.053, 0.006), FORCE),
        ((0.0041, 0.0008), (0.053, 0.006), BEND),
        ((0.0041, 0.0028), (0.053, 0.030), BEND),  # neither is sure: the better one
    ],
)
def test_a_size_that_may_be_zero_leaves_the_lead_to_fewer_parameters(of_bend, of_force, first):
    bend, force = (
        refit(BEND, *of_bend, 87.0),
        refit(FORCE, *of_force, 85.6),
    )
    led = _led((bend, force), SETTING)
    assert led[0].effect.name == first
    assert set(led) == {bend, force}


def test_as_many_parameters_do_not_take_it():
    bend = refit(BEND, 0.0041, 0.0028, 87.0)
    other = refit("drag:position->velocity", 0.3, 0.01, 86.0)
    assert _led((bend, other), SETTING)[0] is bend


@pytest.mark.parametrize(
    ("noise", "error", "first"),
    [
        ("variance:y->time", 0.01, FORCE),
        (
            "variance:y->time",
            0.2,
            "variance:y->time",
        ),  # a size that may as well be zero says nothing
        (
            "heavy-tails:y",
            0.01,
            "heavy-tails:y",
        ),  # outliers are taken out before more is looked for
    ],
)
def test_noise_leaves_the_lead_to_what_is_none(noise, error, first):
    """A variance that grows with the wind says where errors are large, a term of the wind what they are."""
    led = _led((refit(noise, 1.0, 0.1, 26.9), refit(FORCE, 0.3, error, 26.5)), SETTING)
    assert led[0].effect.name == first
