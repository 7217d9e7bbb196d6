"""How bold the p-values of a screen are, found by simulation where it decides."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.setting import Setting
from engine.diagnose.refits import calibration
from engine.diagnose.refits.calibration import (
    BOLDEST,
    OTHERS,
    TURNS,
    Question,
    boldness,
    calibrated,
    decides,
    screen_of_simulated,
    sequential_p,
    swallowed_of_simulated,
)
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.refitting import REFITTED, swallowed_p
from engine.diagnose.screening.score_columns import Column, Projection
from engine.diagnose.screening.screen import make_test, screen
from engine.diagnose.search import search
from engine.estimation.quasi_ml import quasi_ml
from engine.simulation.simulate import simulate
from tests.engine.hidden_effects import DRIVE

ALPHA = 0.05
NOBODY = Question(None, None, None, None)  # nothing is simulated here
T = 300


def silent(stage, fraction):
    pass


def a_screen(seed=0, statistic=None, kinds=("force", "quadratic", "cubic", "drag", "gain")):
    """Of independent effects; the first with the statistic asked for."""
    rng = np.random.default_rng(seed)
    tests = []
    for i, effect in enumerate(all_effects(Setting(DRIVE), list(kinds))):
        v, z = rng.standard_normal(T), rng.standard_normal(T)
        if i == 0 and statistic is not None:
            unit = v / np.linalg.norm(v)
            z += unit * (np.sqrt(statistic) - unit @ z)
        tests.append(make_test(effect, [[((), Column(v * z, v))]], Projection([])))
    return screen(tests, rng, ALPHA)


def largest_of(n, rng):
    """What draws say that the largest -log p of n independent effects is, for each of 19 series."""
    return rng.exponential(size=(19, 499, n)).max(axis=2).mean(axis=1)


def test_boldness_is_that_of_each_effect():
    """One effect of forty has p-values whose logarithms are three times too large."""
    rng = np.random.default_rng(1)
    x = rng.exponential(size=(19, 40))
    x[:, 7] *= 3.0
    found = boldness(x, largest_of(40, rng))
    assert found[7] > 1.5
    assert np.median(np.delete(found, 7)) < 1.2
    assert (found >= 1.0).all()


def test_boldness_of_all_alike_is_found_by_the_smallest_p_value():
    rng = np.random.default_rng(2)
    expected = largest_of(40, rng)
    assert np.median(boldness(1.6 * rng.exponential(size=(19, 40)), expected)) == pytest.approx(
        1.6, rel=0.15
    )
    assert np.median(boldness(rng.exponential(size=(19, 40)), expected)) < 1.15


def test_effects_that_were_not_tested_on_a_series_do_not_count_there():
    rng = np.random.default_rng(3)
    x = rng.exponential(size=(19, 5))
    x[3:, 2] = np.nan
    assert np.isfinite(boldness(x, np.ones(19))).all()


def test_scores_that_few_times_make_up_do_not_count_twice():
    """Their draws raise the p-values of a series; those of simulated series are raised likewise."""
    rng = np.random.default_rng(4)
    x, expected = rng.exponential(size=(19, 40)), largest_of(40, rng)
    raised = 2.0  # by which logarithms of p-values are smaller, of effects and of draws
    assert np.median(boldness(x / raised, expected / raised)) < 1.2
    # as it was once counted: by the draws of the data, whose scores a few times make up
    assert np.median(boldness(x, expected / raised)) > 1.5


@pytest.mark.parametrize(("statistic", "simulates"), [(2.0, False), (13.0, True), (80.0, False)])
def test_simulation_is_made_only_where_it_decides(statistic, simulates):
    seen = a_screen(statistic=statistic)
    assert decides(seen.family_wise_at, ALPHA, seen) is simulates
    assert not decides(seen.family_wise_at, ALPHA, replace(seen, simulated=19))


def test_a_bold_model_has_its_alarm_taken_back(monkeypatch):
    """And one that is not bold keeps it."""
    seen = a_screen(statistic=13.0)
    assert seen.p_value <= ALPHA
    n = len(seen.scores)
    expected = -np.log(seen.lowest).mean()
    for factor, alarm in ((1.0, True), (3.0, False)):
        draws = np.random.default_rng(5)
        monkeypatch.setattr(
            calibration,
            "simulated_logs",
            lambda *a, f=factor, d=draws: np.append(f * d.exponential(size=n), expected),
        )
        judged = calibrated(seen, NOBODY, ALPHA, 0, silent)
        assert (judged.p_value <= ALPHA) is alarm
        assert judged.simulated >= calibration.FEWEST
        # a refit's likelihood ratio is judged by the same boldness
        first = judged.scores[0]
        p = float(min(1.0, first.tests * chi2.sf(13.0, first.degrees)))
        assert first.p_of(13.0) == pytest.approx(p ** (1.0 / first.boldness))


def test_what_may_decide_is_screened_again_each_time_and_others_in_turn(monkeypatch):
    seen = a_screen(statistic=13.0)
    asked = []
    monkeypatch.setattr(calibration, "simulated_logs", lambda q, *a: asked.append(q.kinds))
    calibrated(seen, NOBODY, ALPHA, 0, silent)
    least = min(score.p_value for score in seen.scores) ** (1.0 / BOLDEST)
    near = {score.effect.name for score in seen.scores if score.p_value <= least}
    for names in asked:
        assert near <= {*names}
        assert len(names) == len({*names}) <= len(near) + 2 * OTHERS // TURNS
    in_turn = [set(names) - near for names in asked[:TURNS]]
    together = set().union(*in_turn)
    assert sum(map(len, in_turn)) == len(together)
    assert len(near | together) >= min(len(seen.scores), OTHERS)


def test_a_model_that_cannot_be_simulated_is_believed_least(monkeypatch):
    monkeypatch.setattr(calibration, "simulated_logs", lambda *a: None)
    seen = a_screen(statistic=13.0)
    judged = calibrated(seen, NOBODY, ALPHA, 0, silent)
    assert {score.boldness for score in judged.scores} == {BOLDEST}
    assert judged.p_value == pytest.approx(seen.family_wise_at(BOLDEST))


@pytest.mark.parametrize(
    ("drawn", "left", "expected"),
    [
        ([0.5] * 59, 0, 1.0 / 60.0),
        ([0.001] * 2 + [0.5] * 57, 0, 3.0 / 60.0),  # two unlucky series decide nothing
        ([0.5] * 7 + [0.001] * 52, 49, 3.0 / 10.0),  # the third ends it
    ],
)
def test_refits_are_an_alarm_only_where_few_simulated_series_have_the_like(
    monkeypatch, drawn, left, expected
):
    values = iter(drawn)
    monkeypatch.setattr(calibration, "swallowed_of_simulated", lambda *a: next(values))
    p = sequential_p(0.01, None, ALPHA, 0, silent)
    assert p == pytest.approx(expected)
    assert (p <= ALPHA) == (left == 0)
    assert len(list(values)) == left


def test_a_series_simulated_for_refits_is_screened_for_what_noise_swallows_alone(monkeypatch):
    """It may take sixty of them, and a whole screen of each took half of their time."""
    every, screened = all_effects(Setting(DRIVE)), []

    def seen(*args, asked):
        screened.extend(effect for effect in every if asked(effect))

    monkeypatch.setattr(calibration, "simulated", lambda *a: (None, None))
    monkeypatch.setattr(calibration, "screen_effects", seen)
    monkeypatch.setattr(calibration, "refit_swallowed", lambda *a: [])
    monkeypatch.setattr(calibration, "swallowed_p", lambda *a: 0.5)
    assert swallowed_of_simulated(NOBODY, [1]) == 0.5
    assert screened == [effect for effect in every if effect.traits.swallowed]
    assert 0 < len(screened) < len(every)


@pytest.mark.long
def test_refits_of_a_simulated_series_are_those_of_its_whole_screen():
    u = np.repeat(np.random.default_rng(1).uniform(-3, 3, 12), 10)
    series = simulate(DRIVE, None, len(u), np.random.default_rng(2), u=u, dt=0.05).series
    fit = quasi_ml(DRIVE, series, None)
    question = Question(fit, series, Setting(DRIVE), ["step", "harmonic", "drag", "outliers"])
    for k in range(3):
        whole = screen_of_simulated(question, np.random.default_rng([k, 3]), swallowed=True)
        assert swallowed_of_simulated(question, [k, 3]) == whole[1]


def test_refits_alarm_as_often_as_they_may_and_see_what_is_rare(monkeypatch):
    """Of p-values that are uniform 5 % are alarms; one of .009, as the Nile's, is missed once in sixty."""
    rng = np.random.default_rng(1)

    def alarms(p_values):
        found = []
        for p in p_values:
            monkeypatch.setattr(
                calibration,
                "swallowed_of_simulated",
                lambda *a, p=p: 0.001 if rng.random() < p else 0.5,
            )
            found.append(sequential_p(0.001, None, ALPHA, 0, silent) <= ALPHA)
        return np.mean(found)

    assert alarms(rng.random(3000)) == pytest.approx(ALPHA, abs=0.012)  # three standard errors
    assert alarms([0.009] * 400) > 0.95


def test_refits_of_what_noise_swallows_count_every_family_and_have_their_own_share():
    """So few false alarms come from them that the first screen and they are together at alpha."""
    seen = a_screen(kinds=("step", "drag"))
    swallowed = [score for score in seen.scores if score.effect.traits.swallowed]
    assert len(swallowed) == len(all_effects(Setting(DRIVE), ["step"])) > 1
    refits = [Refit(score.effect, None, 25.0 - i, 0.0) for i, score in enumerate(swallowed)]
    single = swallowed[0].p_of(25.0)
    assert swallowed_p(seen, refits) == pytest.approx(len(swallowed) * single / REFITTED)
    assert swallowed_p(seen, refits) < 1.0
    assert search.FIRST + REFITTED <= 1.0
    bold = min(1.0, len(swallowed) * single**0.5 / REFITTED)
    assert swallowed_p(seen, refits, 2.0) == pytest.approx(bold)
    assert swallowed_p(seen, []) == 1.0


def test_a_screen_that_is_one_of_several_chances_needs_a_smaller_p_value():
    seen = a_screen(statistic=9.0)
    shared = seen.sharing(0.5)
    assert shared.p_value == pytest.approx(min(1.0, 2.0 * seen.p_value))
    assert shared.family_wise(0.01) == pytest.approx(min(1.0, 2.0 * seen.family_wise(0.01)))


@pytest.fixture
def searched(monkeypatch):
    """A search whose screens have these family-wise p-values, each followed by a refit that gains."""
    effect = all_effects(Setting(DRIVE), ["force"])[0]
    best = SimpleNamespace(effect=effect, fit=SimpleNamespace(model=DRIVE))
    monkeypatch.setattr(search, "decides", lambda *a: False)
    monkeypatch.setattr(search, "confirmed", lambda found: found)
    monkeypatch.setattr(search, "finished", lambda fit, series, told: fit)
    monkeypatch.setattr(search, "leading", lambda *a: {})
    monkeypatch.setattr(
        search,
        "refit_best",
        lambda fit, series, seen, *a: search.Round(seen, (best,), None, (best,)),
    )

    def run(*p_values):
        made = []

        def screened(fit, series, setting, kinds, level, seed, progress, taken, asked):
            p = p_values[len(made)]
            made.append(level)
            seen = a_screen(statistic=60.0)
            return replace(seen, p_value=p, lowest=np.where(np.arange(499) < 499 * p - 1, 0.0, 1.0))

        monkeypatch.setattr(search, "screen_effects", screened)
        found = search.search(
            DRIVE,
            None,
            SimpleNamespace(model=DRIVE),
            Setting(DRIVE),
            alpha=ALPHA,
            max_effects=3,
            kinds=["force"],
            seed=0,
            progress=silent,
        )
        return found, made

    return run


def test_later_rounds_need_a_tenth_of_alpha(searched):
    """A second screen with p between alpha / 10 and alpha ends the search quietly."""
    found, made = searched(0.002, 0.02)
    assert made == [ALPHA, pytest.approx(search.LATER * ALPHA)]
    assert [bool(r.equivalent) for r in found.rounds] == [True, False]
    assert not found.alarm_left


@pytest.mark.parametrize(("p", "named"), [(0.03, True), (0.042, False)])
def test_the_first_screen_leaves_a_share_of_alpha_to_refits(searched, p, named):
    """A p-value just below alpha is no alarm, as refits of what noise swallows are a chance too."""
    found, _ = searched(p, 0.5)
    assert [bool(r.equivalent) for r in found.rounds] == [True, False][not named :]
    assert not found.alarm_left
