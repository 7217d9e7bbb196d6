"""Records whose clocks all begin at 0 are told apart by times of their own, where the model reads none."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.data.joined import overlapping
from engine.diagnose.records import records_of
from engine.errors import SeriesError
from engine.presentation.diagnosis_document import as_dict
from service.validation import load

DT, BIAS = 10.0, 1.5


def decay(dt, theta):
    return np.exp(-dt / theta.tau)


VESSEL = engine.MixedModel(
    name="vessel",
    dynamics=lambda a, u, t, dt, theta: (
        [(20.0 + theta.g * u[0]) * (1.0 - decay(dt, theta))],
        [[decay(dt, theta)]],
        [[theta.q**2 * dt]],
    ),
    measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r**2]]),
    initial=lambda theta: (None, [20.0], [[4.0]]),
    linear={"T": "degC"},
    inputs={"heat": "kW"},
    outputs={"probe": "degC"},
    parameters=[
        engine.Parameter("tau", 300.0, "s", (10.0, 5000.0)),
        engine.Parameter("g", 15.0, "degC/kW", (1.0, 100.0)),
        engine.Parameter("q", 0.01, "degC/s^0.5", (1e-4, 1.0)),
        engine.Parameter("r", 0.2, "degC", (1e-3, 5.0)),
    ],
)


def record(seed, bias=0.0, T=120):
    """A vessel that is heated, by Euler's method at a tenth of the sampling time."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.0, 3.0, T // 20), 20)
    x, y, h = 20.0 + rng.standard_normal(), np.empty(T), DT / 10.0
    for k in range(T):
        y[k] = x + bias + 0.2 * rng.standard_normal()
        for _ in range(10):
            noise = 0.01 * np.sqrt(h) * rng.standard_normal()
            x += h * (20.0 + 15.0 * u[k] - x) / 300.0 + noise
    return engine.Series(y, u, dt=DT)


@pytest.fixture(scope="module")
def records():
    return [record(101), record(102, BIAS), record(103, T=140)]


@pytest.fixture(scope="module")
def found(records):
    return engine.diagnose(VESSEL, records, effects=["step", "bias", "linear"], seed=0)


def test_one_keeps_its_times_and_the_others_stay_in_their_order(records):
    moved = engine.in_turn(records)
    assert [one.t[0] for one in moved] == [-4000.0, -2000.0, 0.0]
    assert not overlapping(moved)
    for one, other in zip(records, moved, strict=True):
        assert other.dt == one.dt
        np.testing.assert_array_equal(other.y, one.y)
    with pytest.raises(SeriesError, match="no series"):
        engine.in_turn([])


@pytest.mark.parametrize("unit", [1e-6, 1.0, 3.7e4])
def test_they_do_in_any_unit_of_time_and_whenever_it_began(records, unit):
    early = [one.replace(t=unit * (one.t + 70.0)) for one in records]
    moved = engine.in_turn(early)
    assert not overlapping(moved)
    np.testing.assert_array_equal(moved[2].t, early[2].t)


@pytest.mark.long
def test_a_sensor_that_was_off_in_one_of_three_records(found, records):
    """Once it was named a drifting parameter and a pole: nothing that holds throughout looks like it.

    What warms that vessel by as much is a step too.
    """
    (cause,) = found.causes
    assert "step:probe" in cause.equivalent
    assert set(cause.equivalent) <= {"step:probe", "step:T"}
    name = cause.effect.replace(":", "_")
    assert found.theta[f"{name}_time"] == pytest.approx(-2000.0, abs=5.0 * DT)
    (note,) = (note for note in found.notes if "one came after the other" in note)
    assert "record 0 at t = -4000 s and record 1 at t = -2000 s" in note
    fitted = engine.rts_em(found.extended, engine.in_turn(records), found.theta)
    assert fitted.theta[name] == pytest.approx(cause.size, abs=cause.standard_error)


@pytest.mark.long
def test_a_job_of_the_extended_model_takes_them_so_too(found, records):
    series = [{"y": one.y.tolist(), "u": one.u.tolist(), "dt": DT} for one in records]
    model = as_dict(found)["extension"]["model"] | {"name": "servo", "with": ["step:y"]}
    for reference, first in ((model, [-4000.0, -2000.0, 0.0]), ("servo", [0.0, 0.0, 0.0])):
        made = load({"kind": "estimate", "model": reference, "series": series})
        assert [one.t[0] for one in made.series] == first


def test_a_model_that_reads_the_clock_keeps_its_own(records):
    def dynamics(a, u, t, dt, theta):
        f, A, Q = VESSEL.dynamics(a, u, t, dt, theta)
        return (
            [f[0] + (theta.g - 15.0) * np.sin(t / 500.0)],
            A,
            Q,
        )  # at the default it does not show

    for model, moved in ((VESSEL, True), (replace(VESSEL, dynamics=dynamics), False)):
        _, made = records_of(model, records, None)
        assert made.in_turn is moved
        assert overlapping([made.main, *made.others]) is not moved


def test_records_with_times_of_their_own_keep_them(records):
    apart = [one.replace(t=one.t + 3600.0 * k) for k, one in enumerate(records)]
    _, made = records_of(VESSEL, apart, None)
    assert not made.in_turn
    assert sorted(one.t[0] for one in made.others) == [0.0, 3600.0]
