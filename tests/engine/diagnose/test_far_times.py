"""What comes with time is found whenever time began to count: with the record, or with our era."""

import numpy as np
import pytest

import engine
from engine.diagnose.search.pipeline import find_causes

KINDS = ["harmonic", "step", "pulse", "drift", "parameter-step"]
LEVEL = engine.get_model("local-level")


def waves(first):
    """A level in noise with a wave of a fifth of the record, from a time on."""
    rng = np.random.default_rng(3)
    values = {"q": 10.0, "r": 15000.0, "level": 1000.0}
    y = engine.simulate(LEVEL, values, 80, rng).series.y
    y = y + 150.0 * np.cos(2.0 * np.pi * np.arange(80)[:, None] / 17.0 + 1.0)
    return engine.Series(y, t=first + np.arange(80.0), time_unit="year")


@pytest.fixture(scope="module")
def here():
    return gains(0.0)


def gains(first):
    found = find_causes(LEVEL, waves(first), effects=KINDS, max_effects=1)
    return {r.effect.name: r for r in found.search.rounds[0].refits}


@pytest.mark.parametrize("first", [1900.0, 1e6])
def test_refits_gain_the_same_whenever_time_begins(here, first):
    there = gains(first)
    assert set(there) == set(here)
    for name, refit in there.items():
        assert refit.gain == pytest.approx(here[name].gain, abs=0.3), name
    wave = there["harmonic:flow"]
    assert wave.gain > 30.0
    theta = wave.fit.theta.asdict()
    size = np.hypot(theta["harmonic_flow"], theta["harmonic_flow_sine"])
    assert size == pytest.approx(150.0, abs=75.0)
    assert 1.0 / theta["harmonic_flow_frequency"] == pytest.approx(17.0, rel=0.03)
