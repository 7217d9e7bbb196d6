"""A gauge that reads an input wrongly: more rain falls on a catchment than is recorded."""

import pytest

import engine
from tests.engine.reservoir import RESERVOIR, record

CAUGHT = 1.35
KINDS = [
    "input-gain", "extra-input", "input-offset", "path", "direct", "gain", "drag", "saturation", "linear",
    "bias",
]  # fmt: skip


def asked(seed, caught):
    return engine.diagnose(RESERVOIR, record(seed, 400, 0.02, caught), effects=KINDS, seed=1)


@pytest.mark.slow
def test_rain_that_is_more_than_recorded_is_a_gain_of_the_input():
    found = asked(1, CAUGHT)
    assert [cause.effect for cause in found.causes] == ["input-gain:rain"]
    assert found.causes[0].size == pytest.approx(CAUGHT - 1.0, abs=0.08)
    assert found.gain.adopt


@pytest.mark.slow
def test_rain_that_is_what_was_recorded_is_left_alone():
    assert asked(2, 1.0).causes == ()
