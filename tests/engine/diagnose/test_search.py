"""What counts as an alarm, what it costs, and where effects may enter."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, kstest

import engine
from engine.diagnose.effects.catalogue import all_effects, extend, make_effect
from engine.diagnose.effects.hide import hide
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.refits.refit import refit
from engine.diagnose.refits.refitted import Refit, cost
from engine.diagnose.refits.rounds import Round
from engine.diagnose.screening.score_columns import Column, Projection
from engine.diagnose.screening.screen import Score, make_test, screen
from engine.diagnose.search.pipeline import Clock, find_causes
from engine.diagnose.search.search import confirmed
from engine.estimation.quasi_ml import quasi_ml
from tests.engine.hidden_effects import DRIVE, DT, hidden


def enters(effect):
    """The channel in whose equation an effect is."""
    return effect.channel.partition(",")[0].partition("->")[2] or effect.channel.partition(",")[0]


def test_nothing_is_added_to_an_equation_that_holds_by_definition():
    servo = engine.get_model("servo")
    assert servo.kinematic == ("position",)
    there = {enters(e) for e in all_effects(Setting(servo)) if e.family != "noise"}
    assert "velocity" in there
    assert "position" not in there
    free = replace(servo, kinematic=())
    names = {e.name for e in all_effects(Setting(free))}
    assert {"force:position", "coupling:velocity->position", "step:position"} <= names
    # asked for by name it is there all the same
    assert make_effect("force:position", Setting(servo)).name == "force:position"
    # what the position does to others stays
    assert "cubic:position->velocity" in {e.name for e in all_effects(Setting(servo))}


def test_a_kinematic_state_must_be_a_state():
    with pytest.raises(engine.ModelError, match="'place' is not among its states"):
        replace(engine.get_model("servo"), kinematic=("place",))


def scored(rng, n=8, T=500):
    """A screen of n independent effects, the first of them with a large score."""
    tests = []
    effects = list(
        all_effects(Setting(DRIVE), ["force", "quadratic", "cubic", "drag", "coupling"])
    )[:n]
    for i, effect in enumerate(effects):
        v = rng.standard_normal(T)
        z = rng.standard_normal(T) + (0.3 * v if i == 0 else 0.0)
        tests.append(make_test(effect, [[((), Column(v * z, v))]], Projection([])))
    return screen(tests, rng, alpha=0.05)


def test_an_alarm_needs_a_refit_that_gains():
    rng = np.random.default_rng(3)
    seen = scored(rng)
    assert seen.p_value <= 0.01
    series = hidden([], {}, 1)
    fit = quasi_ml(DRIVE, series, DRIVE.theta())
    effect = seen.scores[0].effect
    for gain, alarm in ((seen.scores[0].statistic, True), (0.5, False)):
        found = confirmed(Round(seen, (Refit(effect, fit, gain, gain),), None, ()))
        assert (found.screen.p_value <= 0.05) is alarm
    assert found.screen.p_value > seen.p_value


def test_family_wise_p_values_are_those_of_the_smallest_of_all_tests():
    seen = scored(np.random.default_rng(4))
    n = len(seen.scores)
    for single in (0.002, 0.01, 0.05):  # n independent tests
        assert seen.family_wise(single) == pytest.approx(1 - (1 - single) ** n, abs=0.05)
    level = float(chi2.sf(seen.threshold, 1))
    assert seen.family_wise(level) == pytest.approx(0.05, abs=0.005)


def test_a_further_parameter_must_gain_the_logarithm_of_the_rows():
    series = hidden([], {}, 1)
    setting = Setting(DRIVE)
    assert cost(make_effect("force:speed", setting), series) == 0.0
    assert cost(make_effect("stribeck:speed", setting), series) == pytest.approx(np.log(400))
    assert cost(make_effect("step:reading", setting), series) == pytest.approx(np.log(400))


@pytest.mark.slow
def test_when_all_that_was_asked_for_is_found_the_search_ends():
    series = hidden(["bias:reading"], {"bias_reading": 0.5}, 1)
    found = engine.diagnose(DRIVE, series, effects=["bias:reading"], seed=1)
    assert [cause.effect for cause in found.causes] == ["bias:reading"]
    assert found.verdict.value == "named"


def test_a_column_too_large_to_square_shows_nothing_and_spoils_nothing():
    """As a filter leaves it that runs away."""
    rng = np.random.default_rng(1)
    v = rng.standard_normal((2, 50))
    v[1] *= 1e200
    z = rng.standard_normal(50)
    lost, sound = all_effects(Setting(DRIVE), ["bias", "gain"])
    nuisance = Projection([Column(z, np.ones(50))])
    tests = [
        make_test(effect, [[((), Column(column * z, column))]], nuisance)
        for effect, column in ((lost, v[1]), (sound, v[0]))
    ]
    seen = screen(tests, rng, alpha=0.05)
    found = {score.effect.name: score for score in seen.scores}
    assert found[lost.name].statistic == 0.0
    assert not np.isfinite(found[lost.name].se)
    assert found[sound.name].statistic > 0.0
    assert np.isfinite(seen.likenesses).all()


def test_draws_of_a_family_have_p_values_beyond_their_number():
    """As the data have: 499 draws that are ranked among themselves end at 1 / 500, where data do not."""
    rng = np.random.default_rng(2)
    tests = []
    for effect in all_effects(Setting(DRIVE), ["stribeck", "deadzone"]):
        v, z = rng.standard_normal((4, 300)), rng.standard_normal(300)
        tests.append(make_test(effect, [[((), Column(one * z, one)) for one in v]], Projection([])))
    assert screen(tests, rng, alpha=0.05).lowest.min() < 1.0 / 500.0


@pytest.mark.slow
def test_family_wise_p_values_of_clean_tests_are_uniform():
    """Families of several columns beside single ones."""
    rng = np.random.default_rng(8)
    effects = list(all_effects(Setting(DRIVE), ["stribeck", "deadzone", "force", "cubic"]))[:12]
    found = []
    for _ in range(150):
        z = rng.standard_normal(200)
        tests = []
        for effect in effects:
            columns = rng.standard_normal((4 if effect.parameters[1:] else 1, 200))
            tests.append(
                make_test(effect, [[((), Column(v * z, v)) for v in columns]], Projection([]))
            )
        found.append(screen(tests, rng, alpha=0.05).p_value)
    assert kstest(found, "uniform").pvalue > 0.01
    assert sum(p <= 0.1 for p in found) <= 26  # 15 are expected


def one_test(kind, channel, s, v, degrees=1):
    effect = make_effect(f"{kind}:{channel}", Setting(DRIVE))
    columns = [((), Column(si, vi)) for si, vi in zip(s, v, strict=True)]
    return make_test(effect, [columns], Projection([]), degrees)


def test_a_one_sided_test_has_half_the_tail():
    """And none on the wrong side."""
    rng = np.random.default_rng(5)
    v = rng.standard_normal(400)
    unit = v / np.linalg.norm(v)
    for sign, p in ((1.0, 0.5 * chi2.sf(9.0, 1)), (-1.0, 0.5)):
        z = rng.standard_normal(400)
        z += unit * (3.0 * sign - unit @ z)
        seen = screen([one_test("lag", "reading", [v * z], [v])], rng, 0.05)
        assert seen.scores[0].p_value == pytest.approx(p, rel=1e-6)


def test_of_a_family_the_best_place_is_told():
    rng = np.random.default_rng(9)
    z, v = rng.standard_normal(300), rng.standard_normal((4, 300))
    z += 0.3 * v[2]
    effect = make_effect("stribeck:speed", Setting(DRIVE))
    columns = [((float(k), 0.0), Column(one * z, one)) for k, one in enumerate(v)]
    (score,) = screen([make_test(effect, [columns], Projection([]))], rng, 0.05).scores
    power = (v[2] ** 2).sum()
    assert score.at == (2.0, 0.0)
    assert score.size == pytest.approx((v[2] @ z) / power)
    assert score.se == pytest.approx(power**-0.5)
    assert score.statistic == pytest.approx((score.size / score.se) ** 2)
    assert score.rho == pytest.approx(1.0)


def test_two_columns_tested_together_are_two_degrees_of_freedom():
    """Their statistic is that of the regression on both, however alike the two are."""
    rng = np.random.default_rng(6)
    z = rng.standard_normal(400)
    one, other = rng.standard_normal((2, 400))
    z += 0.25 * (one - other)  # enough that thirty places leave something to see
    v = np.array([one, 0.9 * one + 0.4 * other])
    s = v * z
    total = s.sum(axis=1)
    expected = float(total @ np.linalg.solve(v @ v.T, total))
    test = one_test("harmonic", "speed", s, v, degrees=2)
    assert float(test.statistics(test.s.sum(axis=1))[0]) == pytest.approx(expected)
    alone = screen([test], rng, 0.05)
    assert alone.scores[0].p_value == pytest.approx(chi2.sf(expected, 2))
    test = replace(test, tries=30)  # chosen from thirty frequencies
    seen = screen([test], rng, 0.05)
    p = 30 * chi2.sf(expected, 2)
    assert p < 0.1
    assert seen.scores[0].p_value == pytest.approx(p)
    assert seen.scores[0].p_of(expected) == pytest.approx(p)  # as of a refit's likelihood ratio


def test_two_waves_that_explain_the_same_are_alike_whatever_their_phases():
    """A hum behind a lag is the same hum, later: the plane of sine and cosine counts, not a column of it."""
    rng = np.random.default_rng(7)
    z = rng.standard_normal(400)
    angle = 0.3 * np.arange(400.0)
    plane = np.array([np.cos(angle), np.sin(angle)])
    z += 0.3 * (plane[0] + plane[1])  # so that neither column of a pair is most of it
    turned = np.array([[0.3, -0.9], [0.9, 0.3]]) @ plane
    other = rng.standard_normal((2, 400))
    tests = [
        one_test("harmonic", channel, v * z, v, degrees=2)
        for channel, v in (("speed", plane), ("load", turned), ("reading", other))
    ]
    seen = screen([*tests, one_test("force", "speed", [plane[0] * z], [plane[0]])], rng, 0.05)
    place = {score.effect.name: i for i, score in enumerate(seen.scores)}
    likeness = {name: seen.likeness(place["harmonic:speed"], i) for name, i in place.items()}
    assert likeness["harmonic:load"] == pytest.approx(1.0)
    assert likeness["harmonic:reading"] < 0.3
    # one column explains part of what two do, however well it is explained by them
    wave = plane.T @ np.linalg.lstsq(plane.T, z, rcond=None)[0]
    share = abs(wave @ plane[0]) / np.linalg.norm(wave) / np.linalg.norm(plane[0])
    assert likeness["force:speed"] == pytest.approx(share)
    assert np.allclose(seen.likenesses, seen.likenesses.T)


@pytest.mark.parametrize("begins", ["at rest", "in motion"])
def test_a_memory_begins_at_rest_or_anywhere_whichever_explains_more(begins):
    """A lag of speed that acts back; in motion, the record begins while the lag is far behind."""
    first = 0 if begins == "at rest" else 105
    model = replace(DRIVE, initial=lambda theta: (engine.Gaussian([0.0], [[4.0]]), [0.0], [[0.05]]))
    values = {"pole_speed": 2.0, "pole_speed_time": 2.0, "pole_speed_spread": 0.0}
    force = np.repeat([2.0, -2.0, 2.0], [100, 100, 300])
    whole = hide(model, ["pole:speed"], values, 500, np.random.default_rng(4), u=force, dt=DT)
    series = whole.series.part(first, 500)
    base = quasi_ml(model, series)
    setting = setting_for(model, series, base.theta)
    effect = make_effect("pole:speed", setting)
    most = float(setting.scale["speed"])
    found = refit(base, series, Score(effect, 1.0, 1.0, 0.1, 0.1, 1.0, (1.0, most)))
    spread = found.fit.theta["pole_speed_spread"]
    assert spread == (0.0 if begins == "at rest" else most)
    other = found.fit.model.theta({**found.fit.theta.asdict(), "pole_speed_spread": most - spread})
    free = list(found.fit.free)
    there = quasi_ml(found.fit.model, series, other, free)
    assert found.fit.log_likelihood > there.log_likelihood + 0.5
    assert "pole_speed_spread" not in free
    # the value says it all: a model extended by name, which knows no data, is the same
    named = quasi_ml(extend(model, ["pole:speed"]), series, found.fit.theta, [], max_iterations=0)
    assert named.log_likelihood == pytest.approx(found.fit.log_likelihood, abs=1e-9)


@pytest.mark.long
def test_noise_that_went_to_a_bound_for_want_of_an_effect_comes_back_with_it():
    """The first reading is met exactly where its noise is nothing: a maximum of its own, at the bound."""
    walk = engine.MixedModel(
        name="walk",
        dynamics=lambda a, u, t, dt, th: ([0.0], [[1.0]], [[th.q]]),
        measurement=lambda a, u, t, th: ([0.0], [[1.0]], [[th.r]]),
        initial=lambda th: (engine.Gaussian([], np.zeros((0, 0))), [th.level], [[th.r]]),
        linear={"level": "m"},
        outputs={"y": "m"},
        parameters=[
            engine.Parameter("q", 5e-4, "m^2", (0.0, 1.0)),
            engine.Parameter("r", 4e-3, "m^2", (1e-8, 1.0)),
            engine.Parameter("level", 0.0, "m", (-1e3, 1e3)),
        ],
    )
    own = {"harmonic_y": 0.6, "harmonic_y_frequency": 0.0244}
    series = hide(walk, ["harmonic:y"], own, 134, np.random.default_rng(2)).series
    base = quasi_ml(walk, series, {"q": 0.01, "r": 1e-8})
    assert base.theta["r"] < 1e-6
    kinds = ["harmonic", "step", "drift"]
    seen = find_causes(walk, series, base.theta, max_effects=1, effects=kinds).search.rounds[0]
    found = next(r for r in seen.refits if r.effect.name == "harmonic:y")
    truth = found.fit.model.theta({**walk.theta().asdict(), **own})
    best = quasi_ml(found.fit.model, series, truth, found.fit.free)
    assert found.fit.log_likelihood > best.log_likelihood - 0.1
    assert found.fit.theta["r"] > 1e-4


def test_seconds_are_of_a_stage_that_has_a_name():
    """A part that was kept is counted where it belongs, also after its stage has ended."""
    clock = Clock()
    clock.start("search")
    clock.stop()
    clock.spent(3.0)
    clock.stop()
    clock.start("gain")
    clock.stop()
    assert list(clock.seconds) == ["search", "gain"]
    assert 3.0 <= clock.seconds["search"] < 4.0
