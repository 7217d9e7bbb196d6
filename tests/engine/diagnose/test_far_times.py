"""What comes with time is found whenever time began to count: with the record, or with our era."""

import re

import numpy as np
import pytest

import engine
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.search.pipeline import find_causes
from engine.words import moment

KINDS = ["harmonic", "step", "pulse", "drift", "parameter-step"]
LEVEL = engine.get_model("local-level")


def waves(first):
    """A level in noise with a wave of a fifth of the record, from a time on."""
    rng = np.random.default_rng(3)
    values = {"q": 10.0, "r": 15000.0, "level": 1000.0}
    y = engine.simulate(LEVEL, values, 80, rng).series.y
    y = y + 150.0 * np.cos(2.0 * np.pi * np.arange(80)[:, None] / 17.0 + 1.0)
    return engine.Series(y, t=first + np.arange(80.0), time_unit="year")


def gains(first, kinds):
    found = find_causes(LEVEL, waves(first), effects=kinds, max_effects=1)
    return {r.effect.name: r for r in found.search.rounds[0].refits}


@pytest.mark.long
@pytest.mark.parametrize(
    ("first", "kinds"),
    [(1e6, ["harmonic"]), *(pytest.param(t, KINDS, marks=pytest.mark.slow) for t in (1900.0, 1e6))],
)
def test_refits_gain_the_same_whenever_time_begins(first, kinds):
    here, there = gains(0.0, kinds), gains(first, kinds)
    assert set(there) == set(here)
    for name, refit in there.items():
        assert refit.gain == pytest.approx(here[name].gain, abs=0.3), name
    wave = there["harmonic:flow"]
    assert wave.gain > 30.0
    theta = wave.fit.theta.asdict()
    size = np.hypot(theta["harmonic_flow"], theta["harmonic_flow_sine"])
    assert size == pytest.approx(150.0, abs=75.0)
    assert 1.0 / theta["harmonic_flow_frequency"] == pytest.approx(17.0, rel=0.03)


@pytest.mark.long
@pytest.mark.parametrize("apart", [1.0, 0.05])
def test_the_time_of_a_step_can_be_read_on_a_clock_that_began_in_1970(apart, tmp_path):
    """Seconds of such a clock have ten digits, and a step is where it is by its last ones."""
    values = {"q": 20.0, "r": 400.0, "level": 1000.0}
    y = engine.simulate(LEVEL, values, 80, np.random.default_rng(1)).series.y
    y = y + 200.0 * (np.arange(80) >= 40)[:, None]
    series = engine.Series(y, t=1.7e9 + apart * np.arange(80.0))
    found = engine.diagnose(LEVEL, series, effects=["step"], seed=1)
    assert [c.effect for c in found.causes] == ["step:flow"]
    when = f"{1.7e9 + 40.0 * apart:.10g}"
    page = str(found)
    assert f"time {when} s" in page
    assert re.search(rf"step_flow_time +{when} +held", page)
    assert found.report(tmp_path / "a.html").read_text(encoding="utf-8").count(when) >= 2
    assert "e+09" not in page


@pytest.mark.parametrize("apart", [1.0, 2e-3, 5e-5])
def test_samples_are_told_from_the_steps_between_them_on_such_a_clock(apart):
    series = engine.Series(np.zeros(200), t=1.7e9 + apart * np.arange(200.0)).refined(4)
    setting = setting_for(LEVEL, series, LEVEL.theta())
    assert setting.tells_samples
    np.testing.assert_array_equal(np.flatnonzero(setting.at_sample(series.t)), series.samples)
    begin, _ = setting.part_of_sample(series.t, setting.dt / 4.0)
    np.testing.assert_allclose(begin, np.resize([0.0, 0.25, 0.5, 0.75], len(begin)), atol=0.01)


@pytest.mark.parametrize(
    ("t", "step", "said"),
    [
        (1899.0, 1.0, "1899 s"),
        (0.0, 0.1, "0 s"),
        (37.30000000000001, 0.1, "37.3 s"),
        (1.7e9 + 90.0, 1.0, "1700000090 s"),
        (1.7e9 + 90.05, 0.05, "1700000090.05 s"),
        (1.7e9 + 90.05, None, "1700000090.05 s"),
        (123.456789, 1.0, "123.46 s"),
    ],
)
def test_a_time_has_the_digits_that_tell_it_from_the_next(t, step, said):
    assert moment(t, step, "s") == said
