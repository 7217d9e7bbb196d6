"""Effects so large that the scores of the model without them say little."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import engine
from engine.diagnose import make_effect
from engine.diagnose.effects.hide import hide
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.refits.refitting import REFITS, _with_ties, _worth_refitting
from engine.diagnose.screening.screening import screen_effects
from engine.estimation.quasi_ml import quasi_ml
from tests.engine.hidden_effects import DRIVE, DT
from tests.engine.plain_models import heated

KINDS = ["drag", "cubic", "linear", "force", "lag", "coupling", "coulomb", "hysteresis", "pole"]


@pytest.fixture(scope="module")
def leaking():
    """A room whose wall loses heat: twenty standard deviations of a reading."""
    u = np.repeat(np.random.default_rng(2).uniform(0.0, 2.0, 20), 10)
    hidden = {"linear_wall": -3e-5}
    rng = np.random.default_rng(3)
    model = replace(heated(1.0), reference={"air": 0.0, "wall": 0.0})
    run = hide(model, ["linear:wall"], hidden, len(u), rng, u=u, dt=300.0)
    return model, engine.Series(run.series.y, u, dt=300.0)


@pytest.mark.long
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


def worth(tails, asked=()):
    """Names worth refitting of fifteen, of which twelve explain much, where outliers have this p-value."""
    setting = Setting(DRIVE)
    kinds = ["drag", "cubic", "quadratic", "coulomb", "deadzone", "saturation"]
    names = [f"{kind}:{place}" for kind in kinds for place in ("speed", "speed->load")]
    scores = [
        SimpleNamespace(effect=effect, statistic=200.0 - i, p_value=1e-9, at=effect.probes[0])
        for i, effect in enumerate(make_effect(name, setting) for name in names)
    ]
    little = [("bias:reading", 30.0, 1e-6), ("gain:reading", 20.0, 1e-5)]
    for name, statistic, p in (*little, ("heavy-tails:reading", 15.0, tails)):
        effect = make_effect(name, setting)
        scores.append(
            SimpleNamespace(effect=effect, statistic=statistic, p_value=p, at=effect.probes[0])
        )
    seen = SimpleNamespace(scores=scores)
    chosen = _worth_refitting(seen, engine.Series(np.zeros(300), dt=DT), asked)
    return [s.effect.name for s in chosen], names


def behind(leading):
    """What of the reading is refitted behind a dozen effects of noise and of a while, one ahead of them."""
    setting = Setting(DRIVE)
    effects = [
        f"{kind}:{place}" for kind in ("episode", "pulse") for place in ("speed", "load", "reading")
    ]
    effects += [f"variance:reading->{place}" for place in ("speed", "force", "time")]
    effects += [f"variance:load->{place}" for place in ("speed", "load", "force", "time")]
    effects += ["colored:reading", "bias:reading", "saturation-sensor:reading", "drag:load"]
    scores = [
        SimpleNamespace(
            effect=effect,
            statistic=150.0 if i == 0 else 100.0 - i,
            p_value=1e-9,
            at=effect.probes[0],
        )
        for i, effect in enumerate(make_effect(name, setting) for name in [leading, *effects])
    ]
    chosen = _worth_refitting(
        SimpleNamespace(scores=scores), engine.Series(np.zeros(300), dt=DT), ()
    )
    return [s.effect.name for s in chosen]


def test_behind_what_acts_for_a_while_some_laws_are_refitted_whatever_their_rank():
    """A sensor that clips is seen at first as an episode, as outliers, and eight times too small as itself."""
    laws = {"saturation-sensor:reading", "bias:reading", "drag:load"}
    assert laws <= {*behind("parameter-episode:damping")}
    assert laws - {*behind("gain:reading")}


def test_outliers_are_refitted_where_they_are_likely_whatever_their_rank():
    chosen, large = worth(tails=1e-5)
    assert chosen == [*large, "heavy-tails:reading"]
    chosen, large = worth(tails=0.01)
    assert chosen == large


def test_what_is_asked_for_is_refitted_whatever_its_rank():
    chosen, large = worth(tails=0.01, asked=["gain:reading"])
    assert chosen == [*large, "gain:reading"]


@pytest.mark.slow
def test_and_one_of_these_is_named(leaking):
    model, series = leaking
    found = engine.diagnose(model, series, effects=KINDS, seed=1)
    assert [c.effect for c in found.causes] == ["linear:wall"]
    assert found.causes[0].size == pytest.approx(-3e-5, rel=0.1)
