"""What is left beside a named effect, and depends on the states, is seen whatever its shape."""

import numpy as np
import pytest

import engine
from engine.diagnose import Verdict
from engine.diagnose.effects.effect import Effect, add_to_state
from engine.diagnose.search.lack_of_fit import lack_of_fit
from engine.estimation.quasi_ml import quasi_ml
from engine.simulation.simulate import simulate
from tests.engine.hidden_effects import DRIVE, DT, levels
from tests.engine.other_units import Units

N = 400
STATES = ["speed", "load"]
SHAPES = {
    "speed times force": lambda v, own: -own[0] * v["speed"] * v["force"],
    "square of the force": lambda v, own: own[0] * (v["force"] ** 2 - 1.0),
}


def with_shape(term):
    size = engine.Parameter("shape_size", 0.5, "1")
    shape = Effect(
        "shape", "speed", "state", "", "", (size,), lambda m: add_to_state(m, "speed", term)
    )
    return shape.apply(DRIVE)


def series(model, seed):
    rng = np.random.default_rng(seed)
    return simulate(model, None, N, rng, u=levels(rng, N), dt=DT).series


def lacking(record, seed=0):
    return lack_of_fit(quasi_ml(DRIVE, record), record, STATES, STATES, seed)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_shape_that_no_name_has_is_seen(shape):
    found = lacking(series(with_shape(SHAPES[shape]), 1))
    assert found.target == "speed"
    assert found.p_value < 0.01
    assert set(found.largest) <= {"speed", "force"}
    assert "another shape" in found.sentence


def test_a_right_model_lacks_nothing():
    """Of 40 series at a level of 0.1, ten or more have probability 0.5 %."""
    p_values = [lacking(series(DRIVE, 100 + k)).p_value for k in range(40)]
    assert sum(p <= 0.1 for p in p_values) < 10


def test_the_same_in_other_units():
    record = series(with_shape(SHAPES["speed times force"]), 2)
    rng = np.random.default_rng(3)
    units = Units.of(DRIVE, lambda: rng.integers(-20, 20))
    model, there = units.model(DRIVE), units.series(record)
    fits = [quasi_ml(DRIVE, record), quasi_ml(model, there)]
    one, other = (
        lack_of_fit(fit, own, STATES, STATES)
        for fit, own in zip(fits, (record, there), strict=True)
    )
    assert (one.terms, one.largest) == (other.terms, other.largest)
    assert other.statistic == pytest.approx(one.statistic, rel=1e-3)


def test_a_name_whose_shape_is_wrong_is_not_said():
    record = series(with_shape(SHAPES["speed times force"]), 1)
    kinds = ["drag", "cubic", "quadratic", "coulomb", "force"]
    found = engine.diagnose(DRIVE, record, effects=kinds, seed=1)
    assert found.verdict is Verdict.UNKNOWN
    assert any("another shape" in note for note in found.notes)
