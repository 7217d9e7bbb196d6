"""Readings that a slow channel repeats are told of; those that repeat themselves otherwise are not."""

import numpy as np
import pytest

from engine.data.faults import faults_of
from engine.data.series import Series


def noisy(seed=0, n=300):
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.standard_normal(n)) + rng.standard_normal(n)


def told(y):
    return " ".join(faults_of({"y": "m"}, {}, Series(y=y[:, None])))


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("step", [0.0, 0.05])
def test_a_slow_channel_that_repeats_its_last_value(scale, step):
    y = noisy()
    y = np.round(y / step) * step if step else y
    assert "Output y gives each reading for 5 rows on end" in told(scale * np.repeat(y, 5)[3:-2])
    asked = (np.arange(450) / 1.5).astype(int)  # by a clock of its own: one or two of each
    assert "for 1.5 rows" in told(scale * y[asked])


def test_missing_rows_between_do_not_hide_it():
    y = np.repeat(noisy(), 4)
    y[np.random.default_rng(1).integers(len(y), size=20)] = np.nan
    assert "rows on end" in told(y)


def test_what_repeats_itself_otherwise():
    rng = np.random.default_rng(2)
    slow = np.round(np.linspace(0.0, 60.0, 600))  # rounded, ten rows on each step
    counts = rng.poisson(20.0, 500).astype(float)
    coarse = np.round(rng.standard_normal(500))
    steps = np.repeat(rng.standard_normal(60), rng.integers(1, 12, 60))  # rests, then steps
    once = noisy()
    once[np.arange(0, 300, 15)] = once[np.arange(0, 300, 15) - 1]  # now and then
    some = noisy()
    some[np.arange(300) % 5 != 0] = np.nan  # as it should be
    for y in (slow, counts, coarse, steps, once, some, noisy()):
        assert "rows on end" not in told(y)


def test_what_clips_rests_at_its_limit_and_nowhere_else():
    wave = 3.0 * np.sin(np.arange(600) / 10.0) + 0.1 * np.random.default_rng(3).standard_normal(600)
    said = told(np.minimum(wave, 1.0))
    assert "rows on end" not in said
    assert "looks clipped" in said
