"""Which candidates survive a round: gaining on rows left out is not enough."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.free_run.answer import _look_alikes
from engine.diagnose.free_run.null import Alarm
from engine.diagnose.free_run.search import Candidate, FreeRound, _errors, survivors
from engine.diagnose.free_run_fits.fitted import Pick, fit_runs, with_effects
from engine.diagnose.free_run_fits.folds import folds_of, losses, p_better
from engine.diagnose.judging.findings import AS_GOOD, AS_LIKELY
from engine.presentation.cause_sentences import standing
from tests.engine.diagnose.free_run.cubic import MODEL, fit_beside_cubic


@pytest.fixture(scope="module")
def fit():
    return fit_beside_cubic(2)


def candidate(fit, name, own):
    """Refitted; as if it gained as much as anything can."""
    setting = setting_for(MODEL, fit.records[0], np.asarray(fit.theta))
    effect = make_effect(name, setting)
    found = with_effects(fit, [Pick(effect, 1e-3)])
    return Candidate(found, (effect,), own - 3.0, 0.2, 1e-6, 0.5), setting


def test_an_effect_whose_size_may_as_well_be_zero_does_not_survive(fit):
    own = losses(fit, folds_of(fit.records))
    true, setting = candidate(fit, "cubic:position->velocity", own)
    (only,) = survivors(own, [true], setting)
    assert only[0].names == true.names
    beside = with_effects(true.fit, [Pick(make_effect("bias:y", setting), 1e-3)])
    (name,) = (effect.size.name for effect in beside.effects[1:])
    k = beside.problem.names(beside.problem.active).index(name)
    assert abs(beside.p[k]) < 2.0 * np.sqrt(beside.covariance[k, k])
    nothing = Candidate(beside, beside.effects, own - 3.0, 0.2, 1e-6, 0.5)
    assert survivors(own, [nothing], setting) == ()


@pytest.mark.parametrize(("gained", "chosen"), [(0.1, 1), (0.6, 2)])
def test_a_second_effect_must_take_its_share_however_sure_it_is(fit, gained, chosen):
    """Two effects gain 5 or 26 % more of the error than one of them, in each of the blocks."""
    own = losses(fit, folds_of(fit.records))
    one, setting = candidate(fit, "cubic:position->velocity", own)
    two = replace(one, added=(*one.added, *one.added), losses=one.losses - gained, held_out=0.1)
    assert p_better(two.losses, one.losses) < 1e-9
    ((first,),) = survivors(own, [two, one], setting)
    assert len(first.added) == chosen


@pytest.mark.long
def test_a_size_in_a_unit_that_nothing_tells_survives(fit):
    """With another gain of the sensor it is another number, and so is the gain of the input; neither is 0."""

    def move(a, u, t, dt, theta):
        return MODEL.dynamics(a, u, t, dt, theta[:-1])

    def read(a, u, t, theta):
        _, C, R = MODEL.measurement(a, u, t, theta)
        return [theta.per * a[:, 0]], C, R  # C is zero

    per = engine.Parameter("per", 1.0, "", (0.0, 100.0))
    model = replace(
        MODEL,
        dynamics=move,
        measurement=read,
        parameters=(*MODEL.parameters, per),
    )
    theta = model.theta([*fit.theta, 1.0])
    base = fit_runs(model, fit.records, theta, (*fit.free, "per"), fit.x1)
    own = losses(base, folds_of(base.records))
    setting = setting_for(model, fit.records[0], np.asarray(theta))
    effect = make_effect("cubic:position->velocity", setting)
    found = Candidate(
        with_effects(base, [Pick(effect, -4.0)]), (effect,), own - 3.0, 0.2, 1e-6, 0.5
    )
    assert {"per", "gain"} <= {
        n for n, e in zip(base.free, _errors(base), strict=True) if np.isinf(e)
    }
    (only,) = survivors(own, [found], setting, before=base)
    assert only[0].names == (effect.name,)
    assert survivors(own, [found], setting, before=fit) == ()


def test_a_dead_zone_that_the_record_does_not_leave_does_not_survive(fit):
    """Within its width it is a straight line, here the damping that the model has too little of."""
    series = fit.records[0]
    weak = MODEL.theta({"zeta": 0.01})
    base = fit_runs(MODEL, [series], weak, ("omega", "gain"), np.zeros((1, 2)))
    setting = setting_for(MODEL, series, np.asarray(weak))
    own = losses(base, folds_of(base.records))
    effect = make_effect("deadzone:velocity", setting)
    size, width = effect.parameters[0].name, effect.parameters[1]
    found = with_effects(base, [Pick(effect, -0.1, (width.bounds[1],))])
    names = found.problem.names(found.problem.active)
    assert size in names
    assert width.name not in names
    wide = Candidate(found, (effect,), own - 3.0, 0.2, 1e-6, 0.5)
    assert survivors(own, [wide], setting) == ()


@pytest.mark.long
def test_only_what_is_worse_on_rows_left_out_is_ruled_out(fit):
    """One that was left for its parameters, or whose own gain is not sure, is not."""
    own = losses(fit, folds_of(fit.records))
    first, _ = candidate(fit, "cubic:position->velocity", own)
    names = {
        "pole:position": 0.1,
        "bias:y": 0.1,
        "drift:y": 4.0,
    }  # losses beyond those of the first
    wiggle = np.resize([1.0, -1.0], own.size)
    others = []
    for name, worse in names.items():
        other, _ = candidate(fit, name, own)
        others.append(replace(other, losses=first.losses + worse + wiggle, p_gain=0.06))
    alarm = Alarm(1e-3, 1e-3, 1e-3, 1.0, 0.1, 3.0)
    one = FreeRound(fit, own, alarm, (), (first, *others), ((first,),), 0.05)
    told = {o.effect: o for o in _look_alikes(one, first.added[0], ())}
    assert {name: o.ruled_out for name, o in told.items()} == {
        "pole:position": False, "bias:y": False, "drift:y": True
    }  # fmt: skip
    assert told["pole:position"].difference == AS_LIKELY  # with more parameters
    assert told["bias:y"].difference == AS_GOOD
    assert standing(told["bias:y"], ()) == standing(told["pole:position"], ()) == "not ruled out"
