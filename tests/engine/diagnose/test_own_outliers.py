"""Outliers on both sides: of a model that knows them, and of what a diagnosis extends one by."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.diagnose import all_effects
from engine.diagnose.effects.setting import Setting

LEVEL = engine.get_model("local-level")
KNOWING = engine.with_mixture(LEVEL, share_default=0.08, ratio_default=8.0)


def record(seed: int) -> engine.Series:
    return engine.simulate(KNOWING, None, 300, np.random.default_rng(seed)).series


@pytest.mark.long
@pytest.mark.parametrize("seed", [pytest.param(101, marks=pytest.mark.slow), 103])
def test_a_model_that_knows_its_outliers_lacks_nothing(seed):
    found = engine.diagnose(KNOWING, record(seed), seed=seed)
    assert found.verdict.value == "nothing", str(found)


@pytest.mark.long
@pytest.mark.parametrize("seed", [pytest.param(101, marks=pytest.mark.slow), 103])
def test_what_outliers_gain_on_held_out_data_is_what_particles_say(seed):
    """By the filter that knows them, not by one that takes the noise for Gaussian and loses there."""
    series = record(seed)
    found = engine.diagnose(LEVEL, series, effects=["heavy-tails", "bias", "step"], seed=seed)
    assert [cause.effect for cause in found.causes] == ["heavy-tails:flow"]
    assert found.gain.adopt
    first = len(series) - found.gain.samples

    def of_held_out(model, theta):
        def value(part, k):
            return engine.rbpf(model, theta, part, 500, np.random.default_rng(k)).log_likelihood

        past = series.part(0, first)
        return np.mean([value(series, k) - value(past, k) for k in range(3)])

    before, after = found.before, found.after
    gained = of_held_out(after.model, after.theta) - of_held_out(before.model, before.theta)
    assert found.gain.log_density == pytest.approx(gained, abs=0.5)
    assert gained > 10.0


def test_nothing_acts_on_a_state_that_only_scales_noise():
    tanks = engine.get_model("tanks")
    known = engine.with_mixture(tanks, name="glitch")
    names = [effect.name for effect in all_effects(Setting(known))]
    usual = [effect.name for effect in all_effects(Setting(tanks))]
    assert not [name for name in names if "g_glitch" in name]
    more = {f"parameter-{way}:glitch_share" for way in ("step", "episode", "drift")}
    more |= {one.replace("share", "ratio") for one in more}
    assert set(names) == {*usual, *more}


@pytest.mark.slow
def test_noise_that_the_search_does_not_see_is_told():
    """The same model, with a size of its noise that the filter of the search is not told of."""
    options = {"effects": ["bias"], "held_out": 0}
    untold = engine.diagnose(replace(KNOWING, random_scales=()), record(101), **options)
    assert any(note.startswith("g_outlier shows in the noise alone") for note in untold.notes)
    told = engine.diagnose(KNOWING, record(101), **options)
    assert not any("noise alone" in note for note in told.notes)
