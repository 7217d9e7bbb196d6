"""A series of measurements."""

from __future__ import annotations

import numpy as np
import pytest

from engine import Series


@pytest.mark.parametrize("dt", [0.1, 1.0 / 3.0, 300.0, 0.0004])
def test_all_steps_of_a_part_are_the_step_of_the_whole(dt):
    """To the last bit: a model may remember what belongs to a step."""
    series = Series(np.zeros((1000, 1)), dt=dt)
    for part in (series, series.part(373, 801)):
        assert part.dt == dt
        assert set(part.steps.tolist()) == {dt}
