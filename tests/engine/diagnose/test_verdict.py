"""When several effects found in turn are trusted, and when they are patches on something else."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.judging.verdict import (
    at_most_in_words,
    detectable_of,
    doubts,
    patchwork,
    verdict_of,
)
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import Round
from engine.diagnose.screening.screen import Score
from tests.engine.hidden_effects import DRIVE

DRAG, BIAS, STEP = "drag:speed", "bias:reading", "step:reading"
FORCE = "latent:speed"
LEVEL, COLORED, OUTLIERS = "level:reading", "colored:reading", "heavy-tails:reading"


def searched(*names, left=0.6, alarm=False, unnamed=None, together=120.0, beside=True):
    """A search that found effects in turn, the last screen's p-value being ``left``.

    Each has a score of 50, and all gain so much ``together``; the unnamed force has ``unnamed``. ``beside``
    tells whether each was refitted with the others in the model.
    """
    effects = [make_effect(name, Setting(DRIVE)) for name in names]
    sizes = [effect.size.name for effect in effects]
    generic = None
    if unnamed is not None:
        generic = Refit(make_effect(FORCE, Setting(DRIVE)), None, unnamed, unnamed)
    rounds = []
    for effect in effects:
        model = SimpleNamespace(parameter_names=sizes if beside else [effect.size.name])
        refit = Refit(effect, SimpleNamespace(model=model), 50.0, 50.0)
        rounds.append(Round(SimpleNamespace(p_value=0.002), (refit,), generic, (refit,)))
    rounds.append(Round(SimpleNamespace(p_value=left, at_floor=False), (), None, ()))
    base, final = (
        SimpleNamespace(log_likelihood=0.0),
        SimpleNamespace(log_likelihood=0.5 * together),
    )
    return Search(base, final, tuple(rounds), alarm)


@pytest.mark.parametrize(
    ("names", "left", "verdict"),
    [
        ([], 0.6, "nothing"),
        ([DRAG], 0.6, "named"),
        ([DRAG], 0.02, "named"),
        ([LEVEL], 0.6, "named"),
        ([LEVEL], 0.02, "named"),  # one true noise in fifty has as much left
        ([LEVEL], 0.008, "unknown"),
        ([DRAG, BIAS], 0.6, "named"),
        ([DRAG, BIAS], 0.008, "unknown"),  # quiet enough to stop, not to be sure of both
        ([DRAG, LEVEL], 0.6, "unknown"),  # the rest of what drag explains in part
        ([DRAG, BIAS, STEP], 0.6, "unknown"),
        ([OUTLIERS, STEP], 0.6, "named"),  # outliers had hidden the step
        ([OUTLIERS, STEP, BIAS], 0.6, "named"),
    ],
)
def test_more_than_two_effects_or_noise_beside_another_are_not_trusted(names, left, verdict):
    search = searched(*names, left=left)
    assert verdict_of(search, alpha=0.05).value == verdict
    assert bool(patchwork(search, 0.05)) == (verdict == "unknown")


@pytest.mark.parametrize(
    ("names", "found", "verdict"),
    [
        ([DRAG, LEVEL], {"together": 90.0}, "named"),  # by themselves they gain 40 each
        ([LEVEL, DRAG], {"together": 90.0}, "named"),
        ([DRAG, LEVEL], {"together": 99.0}, "unknown"),  # by chance
        ([DRAG, LEVEL], {"together": 90.0, "beside": False}, "unknown"),  # nobody knows
        ([DRAG, LEVEL, STEP], {"together": 90.0}, "unknown"),
        ([COLORED, LEVEL], {"together": 90.0}, "unknown"),  # is there a cause at all?
        ([DRAG, LEVEL], {"together": 90.0, "left": 0.008}, "unknown"),
    ],
)
def test_noise_that_is_seen_better_beside_another_effect_is_no_patch(names, found, verdict):
    """What one effect has explained is not there any more for a patch on the same cause."""
    assert verdict_of(searched(*names, **found), alpha=0.05).value == verdict


def test_why_names_are_not_trusted_is_said():
    assert patchwork(searched(DRAG, BIAS, STEP), 0.05) == "more than 2 effects are needed"
    assert patchwork(searched(DRAG, LEVEL), 0.05).startswith(f"{LEVEL} is a property of the noise")
    said = patchwork(searched(DRAG, BIAS, left=0.008), 0.05)
    assert said == f"something is still seen beside {DRAG} and {BIAS} (p = 0.008)"
    assert doubts(searched(DRAG, BIAS), 0.05) == []
    (said,) = doubts(searched(DRAG, unnamed=51.0), 0.05)
    assert said.startswith(f"An unnamed force explains what {DRAG} explains as well")
    (said,) = doubts(searched(DRAG, left=0.03, alarm=True), 0.05)
    assert f"beside {DRAG} (p = 0.03), and max_effects leaves no room" in said


def test_what_is_seen_too_little_for_a_further_name_is_said():
    """The model with the names is not told as whole where a first screen would raise an alarm at it."""
    found = searched(DRAG, left=0.01)
    p_values = {STEP: 1e-4, BIAS: 0.2, FORCE: 1e-5, OUTLIERS: 1e-6}
    found.rounds[-1].screen.scores = [
        SimpleNamespace(effect=make_effect(name, Setting(DRIVE)), p_value=p, statistic=0.0)
        for name, p in p_values.items()
    ]
    (said,) = doubts(found, 0.05)
    assert said.startswith(f"Something more may be there beside {DRAG} (p = 0.01)")
    assert f"it looks most like {STEP} or {BIAS}. " in said
    assert verdict_of(found, 0.05).value == "named"
    assert doubts(searched(DRAG, left=0.06), 0.05) == []


def test_an_alarm_that_nothing_explains_is_unknown():
    assert verdict_of(searched(DRAG, alarm=True), alpha=0.05).value == "unknown"
    assert verdict_of(searched(alarm=True), alpha=0.05).value == "unknown"


@pytest.mark.parametrize(
    ("unnamed", "verdict"), [(40.0, "named"), (46.0, "set"), (51.0, "unknown")]
)
def test_a_name_must_clearly_beat_the_unnamed_force(unnamed, verdict):
    assert verdict_of(searched(DRAG, unnamed=unnamed), alpha=0.05).value == verdict


def detectable(boldness=1.0, rho=0.5, se=0.3):
    """The smallest size of a drag that is seen where a statistic of 9 is an alarm, and whether one is."""
    effect = make_effect(DRAG, Setting(DRIVE))
    score = Score(effect, 2.0, 0.1, se, 0.2, rho, (), boldness=boldness)
    (found,) = detectable_of(SimpleNamespace(scores=(score,), threshold=9.0))
    return found


def test_what_a_refit_has_shown_is_not_said_to_be_untestable():
    effect = make_effect(DRAG, Setting(DRIVE))
    seen = SimpleNamespace(scores=(Score(effect, 0.0, 0.0, np.inf, 1.0, 0.0, ()),), threshold=9.0)
    assert not detectable_of(seen)[0].testable
    assert detectable_of(seen, (Refit(effect, None, 51.0, 51.0),)) == ()
    assert len(detectable_of(seen, (Refit(effect, None, 0.0, -5.0),))) == 1


def test_what_is_detectable_is_seen_four_times_in_five():
    """An estimate scatters by its standard error about the size; beyond three of them it is an alarm."""
    se = 0.3
    assert norm.sf(3.0 * se, detectable(se=se).smallest, se) == pytest.approx(0.8, abs=0.005)
    # where p-values are four times as bold, an alarm needs twice the size
    bold = detectable(boldness=4.0, se=se).smallest
    assert norm.sf(6.0 * se, bold, se) == pytest.approx(0.8, abs=0.005)


def test_a_detector_and_outliers_have_no_smallest_size():
    """An unnamed force stands for anything; how often outliers come is not how large they are."""
    scores = tuple(
        Score(make_effect(name, Setting(DRIVE)), 2.0, 0.1, 0.3, 0.2, 0.5, ())
        for name in (STEP, FORCE, OUTLIERS, BIAS)
    )
    found = detectable_of(SimpleNamespace(scores=scores, threshold=9.0))
    assert [one.effect for one in found] == [BIAS, STEP]  # by name


def test_what_the_parameters_explain_or_leaves_no_trace_is_not_detectable_at_any_size():
    for found in (detectable(rho=0.0), detectable(se=np.inf)):
        assert not found.testable
        assert found.smallest == np.inf
    assert detectable().testable


def test_nor_is_what_no_allowed_size_would_show():
    """A share above one, a correlation of five."""
    score = Score(make_effect("lag:reading", Setting(DRIVE)), 2.0, 0.1, 0.5, 0.2, 0.5, ())
    (found,) = detectable_of(SimpleNamespace(scores=(score,), threshold=9.0))
    assert not found.testable


def test_a_sensor_that_clips_entirely_does_so_and_no_more():
    model = make_effect("saturation-sensor:reading", Setting(DRIVE)).apply(DRIVE)
    theta = model.theta({"saturation_sensor_reading": 1.0})
    cause = SimpleNamespace(effect="any", parameters={"saturation_sensor_reading": 1.0})
    assert at_most_in_words(model, theta, [cause], ["saturation_sensor_reading"]) == []


@pytest.mark.parametrize(("samples", "said"), [(12.0, True), (3.0, False)])
def test_a_delay_that_is_as_long_as_any_that_is_looked_for_says_so(samples, said):
    model = make_effect("delay:force", Setting(DRIVE)).apply(DRIVE)
    theta = model.theta({"delay_force": samples})
    cause = SimpleNamespace(effect="delay:force", parameters={"delay_force": samples})
    told = at_most_in_words(model, theta, [cause], ["delay_force"])
    assert told == said * [
        "The size of delay:force is the most that is looked for, 12 samples: it may be more."
    ]


@pytest.mark.parametrize(("end", "said"), [(0, "least"), (1, "most"), (None, "")])
def test_a_time_constant_at_an_end_of_its_range_says_that_the_name_is_not_sure(end, said):
    model, name = make_effect("pole:speed", Setting(DRIVE)).apply(DRIVE), "pole_speed_time"
    ends = (0.2, 50.0)
    model = model.with_parameters(
        [replace(p, bounds=ends) if p.name == name else p for p in model.parameters]
    )
    values = {"pole_speed": 0.3, name: 5.0 if end is None else ends[end]}
    theta = model.theta(values)
    cause = SimpleNamespace(effect="pole:speed", parameters=values)
    told = at_most_in_words(model, theta, [cause], ["pole_speed", name])
    assert told == bool(said) * [
        f"{name} is the {said} that is looked for, {values[name]:g} s: there pole:speed may stand for an "
        "effect of another kind."
    ]
    assert at_most_in_words(model, theta, [cause], ["pole_speed"]) == []
