"""A step may have come at any time at which the data would not have shown it."""

import numpy as np
import pytest

import engine
from engine.diagnose import diagnose
from engine.diagnose.search.event_time import _end

STEP = 150  # row at which it comes


def room():
    """Air that is let in: what comes in with it shows only while it is dirty outside the room's own level."""

    def dynamics(a, u, t, dt, theta):
        return [dt * u[0]], [[1.0 - dt * theta.rate]], [[1e-4 * dt]]

    def measurement(a, u, t, theta):
        return [0.0], [[1.0]], [[1e-4]]

    return engine.MixedModel(
        name="room",
        dynamics=dynamics,
        measurement=measurement,
        initial=lambda theta: (None, [0.0], [[0.01]]),
        nonlinear={},
        linear={"excess": "ppm"},
        inputs={"source": "ppm/min"},
        outputs={"reading": "ppm"},
        parameters=[engine.Parameter("rate", 0.3, "1/min", (0.01, 1.0))],
    )


def record(quiet):
    """300 minutes in which the rate grows at ``STEP``; nobody is in from row 100 to 200 if it is ``quiet``."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(0.5, 2.0, 30), 10)
    if quiet:
        u[100:200] = 0.0
    x, y = 0.0, []
    for k in range(300):
        y.append(x + 0.01 * rng.standard_normal())
        rate = 0.2 if k < STEP else 0.35
        x = x + u[k] - rate * x + 0.01 * rng.standard_normal()
    return engine.Series(np.array(y), u=u, dt=1.0, time_unit="min")


@pytest.mark.long
@pytest.mark.parametrize("quiet", [True, False])
def test_a_step_while_nothing_happens_has_a_range_of_times(quiet):
    found = diagnose(room(), record(quiet), effects=["parameter-step"], seed=1, held_out=0)
    assert [cause.effect for cause in found.causes] == ["parameter-step:rate"]
    said = [note for note in found.notes if "may have come at any time" in note]
    if not quiet:
        assert not said
        return
    (text,) = said
    words = text.split()
    first, last = (float(words[words.index(one) + 1]) for one in ("from", "to"))
    assert 100.0 < first < STEP < last <= 202.0
    assert "min to" in text


@pytest.mark.long
def test_a_step_that_came_with_a_record_has_a_range_into_the_one_before():
    """The first ends with 50 minutes in which nothing happens."""
    whole = record(quiet=True)
    pair = [whole.part(0, STEP), whole.part(200, 300)]
    found = diagnose(room(), pair, effects=["parameter-step"], seed=1, held_out=0)
    assert [cause.effect for cause in found.causes] == ["parameter-step:rate"]
    (text,) = [note for note in found.notes if "may have come at any time" in note]
    words = text.split()
    first, last = (float(words[words.index(one) + 1]) for one in ("from", "to"))
    assert 100.0 < first < 135.0
    assert 199.0 < last < 205.0


@pytest.mark.parametrize(
    ("row", "last", "to", "end"),
    [
        (50, 99, 50, 50),  # nothing beside it
        (50, 99, 53, 53),
        (50, 99, 99, 99),  # up to the end of the record
        (50, 1, 20, 20),
        (50, 1, 1, 1),
    ],
)
def test_the_end_of_a_range(row, last, to, end):
    asked = []

    def as_likely(k):
        asked.append(k)
        return row <= k <= to if last > row else to <= k <= row

    assert abs(_end(as_likely, row, last) - end) <= 0.1 * abs(end - row)
    assert len(asked) < 15
    assert len(asked) == len(set(asked))
