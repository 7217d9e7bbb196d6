"""A series of measurements."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from engine import Series
from engine.errors import SeriesError


@pytest.mark.parametrize("dt", [0.1, 1.0 / 3.0, 300.0, 0.0004])
def test_all_steps_of_a_part_are_the_step_of_the_whole(dt):
    """To the last bit: a model may remember what belongs to a step."""
    series = Series(np.zeros((1000, 1)), dt=dt)
    for part in (series, series.part(373, 801)):
        assert part.dt == dt
        assert set(part.steps.tolist()) == {dt}


@pytest.mark.parametrize("dt", [1.0, 0.05, 1e-3, 2e-5])
def test_the_step_is_that_of_a_clock_from_0_where_times_count_since_1970(dt):
    """Their rounding, 2e-7 s, is more than a millionth of a step of 0.2 s: it was no step any more."""
    series = Series(np.zeros(400), t=1.7e9 + dt * np.arange(400))
    for one in (series, series.part(37, 80), series.held("foh")):
        assert one.dt == dt
    assert series.refined(4).dt == dt / 4.0


def test_two_records_on_such_a_clock_have_one_step():
    t = 1.7e9 + 0.05 * np.r_[0:100, 40:90]
    assert Series(np.zeros(150), t=t, begins=[100]).dt == 0.05


@pytest.mark.parametrize("times", ["drawn", "slower"])
def test_times_that_rounding_does_not_explain_are_at_no_step(times):
    k = np.arange(400)
    drawn = np.cumsum(np.random.default_rng(0).uniform(0.9, 1.1, 400))
    course = {"drawn": drawn, "slower": k * (1.0 + 1e-5 * k)}[times]
    assert Series(np.zeros(400), t=1.7e9 + 2e-5 * course).dt is None


def test_times_and_a_step_that_do_not_agree_are_refused():
    with pytest.raises(
        SeriesError, match=r"row 1 to row 2 t goes on by 0\.3, and dt = 0\.1; give one"
    ):
        Series(np.zeros(4), t=[0.0, 0.1, 0.4, 0.5], dt=0.1)
    with pytest.raises(SeriesError, match="give one of them"):
        Series(np.zeros(4), t=[0.0, 60.0, 120.0, 180.0], dt=1.0)  # seconds, minutes
    with pytest.raises(SeriesError, match="on average"):
        Series(np.zeros(1000), t=1.02 * np.arange(1000), dt=1.0)


def test_a_logger_may_round_the_times_that_it_writes_beside_its_step():
    t = np.round(np.arange(300) / 30.0, 3)
    even = Series(np.zeros(300), t=t, dt=1.0 / 30.0).t
    np.testing.assert_allclose(even, np.arange(300) / 30.0, atol=1e-12)


@pytest.mark.parametrize("begin", [0.0, 1.7e9])
def test_times_may_be_given_beside_the_step_that_they_have(begin):
    t = begin + 0.01 * np.arange(50)
    np.testing.assert_array_equal(Series(np.zeros(50), t=t, dt=0.01).t, t)


@pytest.mark.parametrize(("unit", "step"), [("s", 1800.0), ("min", 30.0), ("h", 0.5)])
def test_dates_are_counted_in_the_unit_of_the_series(unit, step):
    """Once they were seconds that were called hours."""
    t = np.datetime64("2024-01-01") + 30 * np.arange(4) * np.timedelta64(1, "m")
    for times in (t, t - t[0], t.astype(object)):
        series = Series(np.zeros(4), t=times, time_unit=unit)
        np.testing.assert_allclose(series.t, step * np.arange(4))
    with pytest.raises(SeriesError, match="not known how many seconds"):
        Series(np.zeros(4), t=t, time_unit="year")


@pytest.mark.parametrize("t", [np.arange(3.0), np.datetime64("2024-01-01") + np.arange(3)])
def test_a_masked_time_is_missing_and_a_complex_one_refused(t):
    with pytest.raises(SeriesError, match="t is not finite at row 1"):
        Series(np.zeros(3), t=np.ma.masked_array(t, mask=[False, True, False]), time_unit="day")
    with pytest.raises(SeriesError, match="complex"):
        Series(np.zeros(3), t=np.arange(3) + 1j)


def test_what_is_masked_is_missing():
    y = np.ma.masked_equal([[1.0], [-999.0], [3.0]], -999.0)
    np.testing.assert_array_equal(Series(y).y, [[1.0], [np.nan], [3.0]])
    with pytest.raises(SeriesError, match="u"):
        Series([1.0, 2.0, 3.0], y)


def test_complex_numbers_are_no_readings():
    with pytest.raises(SeriesError, match=r"y is not a table of numbers .* complex"):
        Series(np.array([1.0 + 1j, 2.0, 3.0]))


@pytest.mark.parametrize("again", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_a_copy_cannot_be_written_either(again):
    """Arrays come back writable; a kernel would be compiled anew for them, in every process of a pool."""
    series = Series(np.arange(4.0), u=np.ones(4), dt=0.5, hold="foh", extra=np.ones(4))
    assert not series.u_step.flags.writeable
    found = again(series)
    for name in ("y", "u", "extra", "t", "u_step"):
        assert not getattr(found, name).flags.writeable
        np.testing.assert_array_equal(getattr(found, name), getattr(series, name))


def test_values_by_columns_are_kept_by_rows():
    """As a frame's are; kernels would be compiled anew for them."""
    table = np.asfortranarray(np.arange(12.0).reshape(6, 2))
    series = Series(table, u=table[::-1], extra=table)
    for values in (series.y, series.u, series.extra, series.u_step):
        assert values.flags.c_contiguous
    np.testing.assert_array_equal(series.y, table)
    np.testing.assert_array_equal(series.u, table[::-1])


def test_times_in_the_place_of_a_step_are_told_where_they_go():
    with pytest.raises(
        SeriesError, match=r"dt has 5 values; one positive number is needed. Times are t="
    ):
        Series(np.zeros(5), np.zeros(5), np.arange(5.0))
