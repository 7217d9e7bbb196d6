"""Short runs of one value in a record that moves are told of; those of a signal that rests are not."""

import numpy as np
import pytest

from engine.data.faults import faults_of
from engine.data.series import Series
from engine.data.stuck import stuck_at_times


def signal(seed=0, n=300, noise=0.1):
    rng = np.random.default_rng(seed)
    return np.sin(np.arange(n) / 20.0) + noise * rng.standard_normal(n)


def stuck(y, runs):
    y = y.copy()
    for start, length in runs:
        y[start : start + length] = y[start]
    return y


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("scale", "shift"), [(1.0, 0.0), (1e-9, 1e-7), (1e6, -1e8)])
def test_a_few_short_runs_are_told_in_any_units(seed, scale, shift):
    y = stuck(signal(seed), [(50, 4), (120, 6), (200, 3)])
    said = " ".join(faults_of({"y": "m"}, {}, Series(y=scale * y + shift)))
    assert (
        "Output y keeps exactly one value for up to 6 rows on end, 3 times, first from row 50"
        in said
    )


def test_one_run_is_told_and_digits_do_not_hide_it():
    (said,) = stuck_at_times("y", np.round(stuck(signal(), [(80, 9)]), 3))
    assert "for 9 rows on end, once, first from row 80" in said


@pytest.mark.parametrize("seed", range(20))
def test_what_rests_or_is_rounded_is_not_stuck(seed):
    y = signal(seed)
    rng = np.random.default_rng(seed)
    assert not stuck_at_times("y", y)
    for step in (0.01, 0.05, 0.1, 0.5):  # of an ADC
        assert not stuck_at_times("y", step * np.round(y / step))
    for bits in (8, 10, 12):
        step = 3.0 / 2**bits
        assert not stuck_at_times("y", step * np.round(signal(seed, noise=0.001) / step))
    assert not stuck_at_times("y", np.minimum(y, 0.8))
    assert not stuck_at_times("y", np.maximum(y, 0.0))  # dark at night
    assert not stuck_at_times("y", np.cumsum(rng.random(300) < 0.3).astype(float))  # counts
    speed = np.maximum(np.sin(np.arange(300) / 10.0), 0.0)
    assert not stuck_at_times("y", np.cumsum(speed))  # stands still for a while
    assert not stuck_at_times("y", np.repeat(rng.random(30), 10))  # levels


def test_missing_readings_end_a_run():
    y = signal()
    y[60:70:2] = np.nan
    y[61:70:2] = 0.5
    assert not stuck_at_times("y", y)
