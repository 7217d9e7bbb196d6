"""A series of measurements."""

from __future__ import annotations

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


def test_times_and_a_step_that_do_not_agree_are_refused():
    with pytest.raises(
        SeriesError, match=r"row 1 to row 2 t goes on by 0\.3, and dt = 0\.1; give one"
    ):
        Series(np.zeros(4), t=[0.0, 0.1, 0.4, 0.5], dt=0.1)
    with pytest.raises(SeriesError, match="give one of them"):
        Series(np.zeros(4), t=[0.0, 60.0, 120.0, 180.0], dt=1.0)  # seconds, minutes


@pytest.mark.parametrize("begin", [0.0, 1.7e9])
def test_times_may_be_given_beside_the_step_that_they_have(begin):
    t = begin + 0.01 * np.arange(50)
    np.testing.assert_array_equal(Series(np.zeros(50), t=t, dt=0.01).t, t)
