"""Two effects at once, the whole catalogue open: found in turn, each weighed again beside the other."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import engine
from engine.diagnose import make_effect
from engine.diagnose.effects.hide import hide
from engine.diagnose.judging.verdict import cause_of, named_by, set_of
from engine.diagnose.refits import joint_refit
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.search.pipeline import find_causes
from tests.engine.hidden_effects import DRIVE, levels

T = 500
DT = 0.02


def friction(seed, n=T):
    """A servo without friction of its own but viscous; Coulomb's and the air's are hidden."""
    model, rng = engine.get_model("servo"), np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-10.0, 10.0, n // 20), 20)
    theta = {"Fc": 0.0, "offset": 0.0, "sigma_load": 0.0}
    names = ("coulomb:velocity", "drag:velocity")
    values = {"coulomb_velocity": 0.3, "drag_velocity": 2.0}
    run = hide(model, names, values, n, rng, theta=theta, u=u, dt=DT)
    return model, run.series, model.theta(theta), ["M", "Fv", "sigma_v", "sigma_y"], names


def spring(seed):
    """A hardening spring whose position sensor has a bias."""
    model, rng = engine.get_model("oscillator"), np.random.default_rng(seed)
    u = np.repeat(0.5 * rng.uniform(-1.0, 1.0, T // 20), 20)
    names = ("bias:y", "cubic:position->velocity")
    values = {"bias_y": 0.05, "cubic_position__velocity": -3.0}
    return model, hide(model, names, values, T, rng, u=u, dt=DT).series, None, None, names


def sensor(seed):
    """A sensor that was knocked once and glitches now and then."""
    rng = np.random.default_rng(seed)
    names = ("step:reading", "heavy-tails:reading")
    values = {
        "step_reading": 0.4,
        "step_reading_time": 20.0,
        "heavy_tails_reading_share": 0.03,
        "heavy_tails_reading_ratio": 8.0,
    }
    run = hide(DRIVE, names, values, T, rng, u=levels(rng, T), dt=0.1)
    return DRIVE, run.series, None, None, names


def found_in_turn(pair, seed):
    """Whether both are found in rounds of their own, alone or in the stated set; and the search."""
    model, series, theta, free, names = pair(seed)
    found = find_causes(model, series, theta, free=free, seed=1)
    rounds = [set_of(r) for r in found.search.rounds if r.equivalent]
    first = [i for i, equivalent in enumerate(rounds) if names[0] in equivalent]
    second = [i for i, equivalent in enumerate(rounds) if names[1] in equivalent]
    return any(i != j for i in first for j in second), found


@pytest.mark.slow
def test_friction_and_drag_are_told_apart_once_both_are_known():
    """Before drag is known Coulomb friction passes for Stribeck's; after it, it does not."""
    both, found = found_in_turn(friction, 0)
    assert both
    assert found.verdict.value == "named"
    final = found.search.final
    for name, truth in (("coulomb_velocity", 0.3), ("drag_velocity", 2.0)):
        error = final.standard_errors[final.free.index(name)]
        assert abs(final.theta[name] - truth) < 4.0 * error


@pytest.mark.slow
@pytest.mark.parametrize("pair", [friction, spring, sensor])
def test_two_effects_are_found_in_turn(pair):
    """In at least four of five series."""
    missed = 0
    for seed in range(5):
        missed += not found_in_turn(pair, seed)[0]
        if missed > 1 or seed - missed == 3:
            break
    assert missed <= 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "kinds",
    [["stribeck", "drag"], ["stribeck", "coulomb", "drag"]],
)
def test_few_effects_asked_for_are_weighed_again_too(kinds):
    """A rival may be another round's cause, and a plainer kind may not have been asked for."""
    model, series, theta, free, _ = friction(0, n=300)
    effects = [f"{kind}:velocity" for kind in kinds]
    found = find_causes(model, series, theta, free=free, seed=1, effects=effects)
    named = [r.refits[0].effect.name for r in found.search.rounds if r.equivalent]
    assert "drag:velocity" in named
    assert len(set(named)) == len(named) >= 2
    assert all(cause_of(r).equivalent for r in found.search.rounds if r.equivalent)
    assert ("coulomb:velocity" in named) == ("coulomb" in kinds)


@pytest.mark.slow
def test_looking_back_loses_nothing_that_was_found(monkeypatch):
    """Neither to a refit that does not arrive, nor to outliers that were weighed beside other effects."""
    names, values = ["bias:reading", "cubic:speed"], {"bias_reading": 0.5, "cubic_speed": -2.0}
    rng = np.random.default_rng(5)
    series = hide(DRIVE, names, values, 160, rng, u=levels(rng, 160), dt=0.1).series
    found = find_causes(DRIVE, series, seed=1, effects=names)
    base, setting, search = found.base, found.setting, found.search
    one, other = (r for r in search.rounds if r.equivalent)
    choice = one.refits[0]
    theta = choice.fit.model.theta({**choice.fit.theta.asdict(), choice.effect.size.name: 8.0})
    astray = replace(choice, fit=replace(choice.fit, theta=theta))
    tails = Refit(make_effect("heavy-tails:reading", setting), choice.fit, 1e6, 1e6)
    one = replace(one, refits=(astray, *one.refits[1:], tails))
    monkeypatch.setattr(joint_refit, "ITERATIONS", 1)
    final, rounds, _ = joint_refit.look_back(base, [one, other], series, setting)
    assert {r.refits[0].effect.name for r in rounds} == set(names)
    assert final.log_likelihood > search.final.log_likelihood - 0.01


@pytest.mark.long
def test_what_gains_too_little_beside_what_was_found_later_is_dropped():
    """It had been found as a part of what the later one explains as a whole."""
    rng = np.random.default_rng(5)
    hidden = ["bias:reading", "cubic:speed"]
    series = hide(
        DRIVE, hidden[:1], {"bias_reading": 0.5}, 160, rng, u=levels(rng, 160), dt=0.1
    ).series
    found = find_causes(DRIVE, series, seed=1, effects=hidden)
    true = found.search.rounds[0]
    assert true.refits[0].effect.name == "bias:reading"
    stale = tuple(r for r in true.refits if r.effect.name == "cubic:speed")
    before = replace(true, refits=stale, equivalent=stale)
    look_back = partial(joint_refit.look_back, found.base, [before, true], series, found.setting)
    for level, left in ((1.0, ["cubic:speed", "bias:reading"]), (0.05, ["bias:reading"])):
        final, rounds, _ = look_back(level=level)
        assert [r.refits[0].effect.name for r in rounds] == left
        assert ("cubic_speed" in final.model.parameter_names) == (len(left) == 2)
        assert all(r.refits[0].fit.model is final.model for r in rounds[-1:])


@pytest.mark.long
def test_every_cause_has_the_size_that_the_extended_model_has():
    """Not that of the round that found it, in whose fit what was found later is mixed: 0.46 there, not 0.42."""
    rng, names = np.random.default_rng(0), ["step:reading", "heavy-tails:reading"]
    values = {"step_reading": 0.4, "step_reading_time": 8.0}
    values |= {"heavy_tails_reading_share": 0.05, "heavy_tails_reading_ratio": 8.0}
    run = hide(DRIVE, names, values, 160, rng, u=levels(rng, 160), dt=0.1)
    search = find_causes(DRIVE, run.series, seed=1, effects=names).search
    causes = named_by(search)
    assert {cause.effect for cause in causes} == set(names)
    for cause in causes:
        assert cause.parameters == {name: search.final.theta[name] for name in cause.parameters}
        at = search.final.free.index(next(iter(cause.parameters)))
        assert cause.standard_error == search.final.standard_errors[at]
