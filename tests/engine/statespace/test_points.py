"""A model at the points of trajectories: what is kept of an evaluation, and for how long."""

from __future__ import annotations

import numpy as np

from engine import Series
from engine.statespace.points import Points
from engine.statespace.refutation import count_refutation
from tests.engine.models_for_tests import theta_everywhere

MODEL = theta_everywhere()


def points(home):
    rng = np.random.default_rng(0)
    series = Series(rng.standard_normal((5, MODEL.ny)), dt=0.5)
    return Points(MODEL, series, rng.standard_normal((5, 3, MODEL.na)), home)


def test_what_it_is_at_home_is_what_it_is_anywhere():
    theta = MODEL.theta()
    kept, made = points(theta), points(None)
    other = np.asarray(theta) * 1.01
    for at in (theta, other, theta):
        record = MODEL.record(at)
        for one, again in zip(kept.transition(record), made.transition(record), strict=True):
            np.testing.assert_array_equal(one, again)
        rows = np.array([0, 3])
        for one, again in zip(
            kept.observation(record, rows), made.observation(record, rows), strict=True
        ):
            np.testing.assert_array_equal(one, again)


def test_it_is_kept_at_home_alone_and_until_a_function_is_refuted():
    theta = MODEL.theta()
    kept, record = points(theta), MODEL.record(theta)
    first = kept.transition(record)
    assert kept.transition(MODEL.record(theta)) is first
    assert kept.observation(record, [0, 3]) is not kept.observation(record, [0, 4])
    away = MODEL.record(np.asarray(theta) * 1.01)
    assert kept.transition(away) is not kept.transition(away)
    count_refutation()
    assert kept.transition(record) is not first
