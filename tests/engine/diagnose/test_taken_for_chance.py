"""What is seen none too clearly, and denied by data that nothing was fitted to, is no finding."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import engine
from engine.diagnose import diagnose
from engine.diagnose.gain.adoption import Decision
from engine.diagnose.gain.chance import taken_for_chance
from engine.diagnose.judging.findings import Verdict
from tests.engine.diagnose.test_falls_short import LOSS


def search(*p_values):
    """One with these p-values of its rounds; what leads the first is named."""
    led = SimpleNamespace(effect=SimpleNamespace(name="drag:v"))
    screens = [SimpleNamespace(p_value=p) for p in p_values]
    return SimpleNamespace(rounds=[SimpleNamespace(screen=one) for one in screens], named=(led,))


def test_a_faint_finding_that_loses_elsewhere_is_chance():
    said = taken_for_chance(search(0.02, 0.6), LOSS, 0.05)
    assert "drag:v seemed to be seen (p = 0.02)" in said
    assert "worse with that, by 20 in log-density" in said


@pytest.mark.parametrize(
    ("p_values", "changed", "alpha"),
    [
        ((0.004, 0.6), {}, 0.05),  # too improbable
        ((0.02, 0.003, 0.6), {}, 0.05),  # something else is clear beside it
        ((0.02, 0.6), {"log_density": -0.9}, 0.05),  # as good as no loss
        ((0.02, 0.6), {"log_density": 3.0}, 0.05),
        ((0.02, 0.6), {"decision": Decision.ADOPTED}, 0.05),  # better in free run
        ((0.02, 0.6), {"samples": 12}, 0.05),  # rows that tell nothing
    ],
)
def test_what_is_clear_or_not_denied_is_none(p_values, changed, alpha):
    assert not taken_for_chance(search(*p_values), replace(LOSS, **changed), alpha)


def test_nor_is_it_where_nothing_was_held_out():
    assert not taken_for_chance(search(0.02, 0.6), None, 0.05)


def record(seed, wave=0.0):
    """Two linear states without any fault, but for a wave of its reading."""
    model = engine.get_model("linear-2")
    series = engine.simulate(model, model.theta(), 200, np.random.default_rng(seed)).series
    y = series.y[:, 0] + wave * np.sin(2.0 * np.pi * 0.21 * series.t)
    return model, engine.Series(y, dt=series.dt)


@pytest.mark.long
def test_a_faint_wave_is_judged_by_the_rows_kept_back_and_a_chance_one_is_none():
    model, series = record(121)
    found = diagnose(model, series, seed=1, effects=["harmonic", "cubic", "coupling", "quadratic"])
    assert found.verdict is Verdict.NOTHING
    assert found.p_value < 0.05
    assert (found.causes, found.gain, found.extended) == ((), None, model)
    assert "harmonic:y seemed to be seen" in found.why[0]
    assert " ".join(found.why[0].split()) in " ".join(str(found).split())
    document = found.to_dict()
    assert (document["verdict"], document["why"]) == ("nothing", [found.why[0]])


@pytest.mark.long
def test_a_wave_that_is_clearly_there_is_judged_among_the_rows_that_chose_it():
    model, series = record(6, wave=0.4)
    found = diagnose(model, series, seed=1, effects=["harmonic", "cubic", "coupling", "quadratic"])
    assert found.causes[0].effect.startswith("harmonic:")
    assert found.adopted
    assert found.gain.among
