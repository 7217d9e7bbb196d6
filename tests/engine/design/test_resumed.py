"""A design that is stopped and goes on: the same input, bit for bit; what is of another design is refused."""

import json

import numpy as np
import pytest

from engine.design import asked_of
from engine.errors import OptionError
from tests.engine.design.models_for_design import BOUNDS, CAUSES, drive
from tests.engine.diagnose.test_checkpoint import Stopped, StopsAfter

LIMITED = BOUNDS | {"states": {"velocity": [-4.0, 4.0]}}


def asked(model=None, bounds=LIMITED, causes=CAUSES, length=60, **more):
    return asked_of(drive() if model is None else model, bounds, length, causes, **more)


def numbers(made):
    told = made.to_dict()
    del told["seconds"]
    return json.dumps(told)


@pytest.mark.slow
@pytest.mark.parametrize("steps", [5, 17])
def test_stopped_after_every_few_parts(steps):
    question = asked(bounds=BOUNDS, length=240)
    expected = question.designed(32, 1)
    kept, times = {}, 0
    while True:
        parts = StopsAfter(json.loads(json.dumps(kept)), steps)
        try:
            found = question.designed(32, 1, kept=parts)
            break
        except Stopped:
            kept, times = parts, times + 1
    assert times == len(parts) // steps > 1
    assert numbers(found) == numbers(expected)
    assert found.u.tobytes() == expected.u.tobytes()
    assert {name.partition(":")[0] for name in parts} >= {"asked", "inputs", "length 1"}
    assert (
        found.seconds > sum(part["seconds"] for part in parts.values() if "seconds" in part) > 0.0
    )


@pytest.mark.slow
def test_what_was_kept_of_another_design_is_refused():
    kept = {}
    asked().designed(16, 1, kept=kept)
    other = {**CAUSES, "drag:velocity": 0.3}
    for question, inputs, seed, what in (
        (asked(drive(q=0.06)), 16, 1, "other causes"),
        (asked(drive(volt=2.0)), 16, 1, "another model"),
        (asked(bounds=BOUNDS), 16, 1, "other bounds"),
        (asked(causes=other), 16, 1, "another model"),
        (asked(alarm=9.0), 16, 1, "other options"),
        (asked(anew=False), 16, 1, "other options"),
        (asked(), 32, 1, "other options"),
        (asked(), 16, 2, "other options"),
    ):
        with pytest.raises(OptionError, match=f"is of a design with {what}") as error:
            question.designed(inputs, seed, kept=kept)
        assert error.value.field == "kept"


@pytest.mark.slow
def test_what_a_document_tells_of_the_next_diagnosis_counts():
    """A higher threshold makes a right name rarer; which outputs are measured is known."""
    sure, careful = (asked(alarm=alarm).designed(16, 1) for alarm in (5.0, 60.0))
    assert careful.experiment.probability.sum() < sure.experiment.probability.sum() - 0.5
    with pytest.raises(OptionError, match="there is no output 'speed'"):
        asked(measured=["speed"])
    assert np.all(asked(measured=["tacho"]).task.seen)
    assert not np.any(asked(measured=[]).task.seen)
