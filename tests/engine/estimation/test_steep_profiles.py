"""The profile of a parameter that the data limit on one side alone, and steeply there."""

import math

import numpy as np
import pytest

import engine
from engine.estimation.uncertainty.likelihood import ends

STEEP = np.array([-400.0, -160.0, -55.0, -15.0, -3.0, -0.73, -0.17, 0.11, 0.25, 0.34, 0.39])
SLOPES = np.array([0, 0, 0, 0, 1.4e-2, -5e-5, -0.16, -0.6, -2.3, -5.4, -51.0])


def test_a_steep_end_does_not_bend_the_other_one():
    (low, high), _ = ends(STEEP, SLOPES, -0.73, 1.92, (-1e4, 0.39))
    assert low == -1e4
    assert 0.25 < high <= 0.39


@pytest.mark.filterwarnings(
    "ignore::engine.errors.NotSettledWarning"
)  # the upper end may not be found
@pytest.mark.long
def test_a_likelihood_that_does_not_fall_has_no_end_there():
    model = engine.MixedModel(
        name="decay",
        dynamics=lambda a, u, t, dt, theta: ([0.0], [[math.exp(theta.k) - 0.5]], [[1e-4]]),
        measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[1.0]]),
        initial=lambda theta: (None, [0.0], [[1.0]]),
        linear={"z": "m"},
        outputs={"y": "m"},
        parameters=[engine.Parameter("k", -0.7, "", (-1e3, 1e3))],
    )
    series = engine.Series(np.random.default_rng(0).normal(size=200), dt=1.0)
    best = engine.rts_em(model, series).theta
    assert engine.likelihood_intervals(model, best, series).values[0, 0] == -1e3
