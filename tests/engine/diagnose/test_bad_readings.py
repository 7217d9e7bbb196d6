"""One bad reading is a pulse; where more of them are left beside it, they are outliers."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine import diagnose
from engine.data.series import Series
from engine.diagnose import Verdict

LEVEL = engine.get_model("local-level")
N = 300


def readings(bad, seed=0):
    """A slow level with noise of 120; ``bad`` maps rows to errors in standard deviations of it."""
    rng = np.random.default_rng(seed)
    y = 1000.0 + np.cumsum(rng.normal(0.0, 20.0, N)) + rng.normal(0.0, 120.0, N)
    for row, error in bad.items():
        y[row] += 120.0 * error
    return Series(y=y[:, None])


def names(found):
    return [cause.effect for cause in found.causes]


def looked_at(bad):
    return diagnose(LEVEL, readings(bad), effects=["pulse", "heavy-tails", "step", "level"], seed=1)


@pytest.mark.long
def test_one_bad_reading_is_said_to_be_one():
    found = looked_at({150: 9.0})
    (output,) = LEVEL.outputs
    assert found.causes[0].equivalent[0] == f"pulse:{output}"


@pytest.mark.long
def test_the_largest_of_several_bad_readings_is_not_the_cause():
    """The largest alone gains more than a share of outliers does, of which there are few."""
    found = looked_at({150: 10.0, 40: -4.5, 230: 4.5, 270: -5.0})
    (output,) = LEVEL.outputs
    assert found.verdict is Verdict.NAMED
    assert names(found) == [f"heavy-tails:{output}"]


@pytest.mark.slow
def test_a_bad_last_reading_is_told_beside_the_force_that_looks_the_same():
    """A push of the state one row before shows in the last reading only: nothing tells them apart."""
    kinds = ["pulse", "heavy-tails", "step", "level"]
    found = diagnose(LEVEL, readings({N - 1: 9.0}), effects=kinds, held_out=0, seed=1)
    (output,), (state,) = LEVEL.outputs, LEVEL.linear
    assert found.verdict is Verdict.SET
    assert found.causes[0].equivalent == (f"pulse:{output}", f"pulse:{state}")
    assert found.causes[0].parameters[f"pulse_{output}_time"] == N - 1


@pytest.mark.long
def test_a_bad_first_reading_is_said_to_be_one():
    known = replace(LEVEL, initial=lambda theta: (None, [1000.0], [[100.0]]))
    kinds = ["pulse", "heavy-tails", "step"]
    found = diagnose(known, readings({0: 9.0}), effects=kinds, seed=1)
    (output,) = LEVEL.outputs
    assert found.causes[0].equivalent == (f"pulse:{output}",)
    assert found.causes[0].parameters[f"pulse_{output}_time"] == 0.0
