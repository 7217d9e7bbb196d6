"""Hide an effect in the data and require finding it: one of every family, a pair, none, a stranger."""

import numpy as np
import pytest

import engine
from engine.diagnose import Verdict, diagnose, extend
from tests.engine.hidden_effects import DRIVE, DT, T, levels


def hidden(effects, sizes, seed):
    rng = np.random.default_rng(seed)
    model = extend(DRIVE, effects)
    return engine.simulate(model, sizes, T, rng, u=levels(rng), dt=DT).series


CASES = [
    ("coulomb:speed", {"coulomb_speed": 0.4}, "state"),
    ("cubic:speed", {"cubic_speed": -0.8}, "state"),
    ("bias:reading", {"bias_reading": 0.5}, "measurement"),
    ("lag:reading", {"lag_reading": 0.6}, "measurement"),
    ("input-deadzone:force", {"input_deadzone_force": 0.5}, "input"),
    ("step:reading", {"step_reading": 0.4, "step_reading_time": 16.0}, "time"),
    (
        "harmonic:speed",
        {"harmonic_speed": 0.4, "harmonic_speed_frequency": 0.83},
        "time",
    ),
    ("variance:reading->speed", {"variance_reading_speed": 2.0}, "noise"),
]
QUICK = ("cubic:speed",)  # the others' look-alikes alone are in test_catalogue


def open_to(*few):
    """With the whole catalogue (None), or with a few kinds."""
    whole = pytest.param(None, marks=pytest.mark.slow, id="all")
    return pytest.mark.parametrize("effects", [whole, pytest.param([*few], id="few")])


@pytest.mark.parametrize(
    ("name", "sizes", "family"),
    [
        pytest.param(*one, id=one[0], marks=[pytest.mark.slow] * (one[0] not in QUICK))
        for one in CASES
    ],
)
def test_a_hidden_effect_is_found(name, sizes, family):
    found = diagnose(DRIVE, hidden([name], sizes, seed=5), seed=1)
    assert found.verdict in (Verdict.NAMED, Verdict.SET)
    assert name in found.causes[0].equivalent
    assert found.p_value <= 0.05
    cause = found.causes[0]
    if cause.effect == name:
        assert cause.where == family
        truth = next(iter(sizes.values()))
        # the phase of a harmonic counts from the middle of the record
        size = np.hypot(cause.size, cause.parameters.get(f"{name.replace(':', '_')}_sine", 0.0))
        assert abs(abs(size) - abs(truth)) < 5.0 * cause.standard_error
        assert cause.size * truth > 0.0 or name.startswith("harmonic")
        assert found.extended.parameter_names[: len(DRIVE.parameters)] == DRIVE.parameter_names


@pytest.mark.slow
@open_to("coulomb:speed", "bias:reading")
def test_two_effects_are_found_in_turn(effects):
    names = ["coulomb:speed", "bias:reading"]
    series = hidden(names, {"coulomb_speed": 0.6, "bias_reading": 0.6}, seed=7)
    found = diagnose(DRIVE, series, seed=1, effects=effects)
    seen = [name for cause in found.causes for name in cause.equivalent]
    assert set(names) <= set(seen)
    assert len(found.causes) == 2


@pytest.mark.slow
def test_nothing_hidden_nothing_found():
    """Four clean series at a family-wise 5 %: two or more alarms have probability 1.4 %."""
    verdicts = [diagnose(DRIVE, hidden([], {}, seed), seed=1).verdict for seed in range(4)]
    assert verdicts.count(Verdict.NOTHING) >= 3


@pytest.mark.slow
@open_to("coulomb", "bias", "step", "harmonic", "latent")
def test_a_stranger_is_not_named_with_confidence(effects):
    """A chirp, a force of rising frequency, is in no catalogue."""
    rng = np.random.default_rng(3)
    u, t = levels(rng), DT * np.arange(T)
    driven = engine.simulate(
        DRIVE, None, T, rng, u=u + 1.5 * np.sin(2 * np.pi * (0.1 + 0.02 * t) * t), dt=DT
    )
    series = engine.Series(driven.y, u, dt=DT)
    found = diagnose(DRIVE, series, seed=1, effects=effects)
    assert found.verdict in (Verdict.UNKNOWN, Verdict.SET)


@pytest.mark.slow
@pytest.mark.parametrize(("since", "seed"), [(1871.0, 0), (0.0, 0), (1871.0, 5)])
def test_the_step_of_the_nile_in_1899(since, seed):
    """Wherever time begins, whatever is drawn: process noise swallows it, and simulations judge refits."""
    flows = engine.data.nile()
    series = engine.Series(flows.y, t=flows.t - 1871.0 + since, time_unit="year")
    found = diagnose(engine.get_model("local-level"), series, seed=seed)
    assert found.verdict is Verdict.NAMED
    assert found.causes[0].effect == "step:flow"
    assert found.causes[0].parameters["step_flow_time"] == since + 28.0
    assert found.causes[0].size == pytest.approx(-258.0, abs=30.0)


def test_an_extended_model_is_an_ordinary_model():
    model = engine.get_model("mixed-4", effects=["bias:y1", "coulomb:a"])
    assert model.parameter_names[-2:] == ("bias_y1", "coulomb_a")
    run = engine.simulate(model, {"bias_y1": 1.0}, 60, np.random.default_rng(0))
    filtered = engine.rbpf(model, None, run.series, 50, np.random.default_rng(1))
    assert np.isfinite(filtered.log_likelihood)
    with pytest.raises(engine.OptionError, match="kinds are"):
        engine.get_model("mixed-4", effects=["magic:a"])
    with pytest.raises(engine.OptionError, match="channels are"):
        engine.get_model("mixed-4", effects=["bias:nowhere"])
