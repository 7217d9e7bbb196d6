"""Effects so large that the scores of the model without them say little."""

import numpy as np
import pytest

import engine
from engine.diagnose.effects.hide import hide
from engine.diagnose.effects.setting import setting_for
from engine.diagnose.screening.screening import screen_effects
from engine.diagnose.search.refitting import REFITS, _with_ties, _worth_refitting
from engine.estimation.quasi_ml import quasi_ml
from tests.engine.plain_models import heated

KINDS = ["drag", "cubic", "linear", "force", "lag", "coupling", "coulomb", "hysteresis", "pole"]


@pytest.fixture(scope="module")
def leaking():
    """A room whose wall loses heat: twenty standard deviations of a reading."""
    u = np.repeat(np.random.default_rng(2).uniform(0.0, 2.0, 20), 10)
    hidden = {"linear_wall": -3e-5}
    rng = np.random.default_rng(3)
    run = hide(heated(1.0), ["linear:wall"], hidden, len(u), rng, u=u, dt=300.0)
    return heated(1.0), engine.Series(run.series.y, u, dt=300.0)


def test_more_are_refitted_where_the_effect_is_larger_than_the_noise(leaking):
    model, series = leaking
    series = series.part(0, 160)
    fit = quasi_ml(model, series, None, None)
    setting = setting_for(model, series, np.asarray(fit.theta))
    seen = screen_effects(fit, series, setting, KINDS, 0.05, 1, lambda stage, share: None)
    assert seen.scores[0].statistic > 10.0 * len(series)
    chosen = [s.effect.name for s in _worth_refitting(seen, series, ())]
    assert "linear:wall" in chosen
    place = sorted(seen.scores, key=lambda s: -s.statistic)
    assert [s.effect.name for s in place].index("linear:wall") >= REFITS  # it scores low


def test_rounding_does_not_decide_which_are_refitted():
    """A constant force is Coulomb friction of a state that never turns: their scores are the same."""
    values = [9.0, 7.0, 5.0, 5.0 * (1.0 - 1e-10), 5.0 * (1.0 - 1e-9), 4.9]
    assert [_with_ties(values, n) for n in (1, 2, 3, 4, 6, 8)] == [1, 2, 5, 5, 6, 6]


@pytest.mark.slow
def test_and_one_of_these_is_named(leaking):
    model, series = leaking
    found = engine.diagnose(model, series, effects=KINDS, seed=1)
    assert [c.effect for c in found.causes] == ["linear:wall"]
    assert found.causes[0].size == pytest.approx(-3e-5, rel=0.1)
