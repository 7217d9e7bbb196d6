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


def test_of_a_long_record_no_more_is_kept_however_many_rows_are_asked_at_once(monkeypatch):
    """All of it was kept, block by block, with the matrices of every point."""
    theta, asked = MODEL.theta(), list[int]()
    kept, record = points(theta), MODEL.record(theta)
    one = sum(x.size for x in kept.observation(record, [0]))
    monkeypatch.setattr("engine.statespace.points.KEPT_NUMBERS", 2 * one)
    kept = points(theta)
    whole = Points._at

    def counted(self, rows, record, transition):
        asked.append(rows[0])
        return whole(self, rows, record, transition)

    monkeypatch.setattr(Points, "_at", counted)
    for row in (0, 1, 2, 0, 1, 2):
        kept.observation(record, [row])
    assert asked == [0, 1, 2, 2]


def test_several_parameter_vectors_are_asked_as_anywhere():
    """Their record holds arrays: to compare it with that at home raised ValueError."""
    theta = MODEL.theta()
    record = MODEL.record(theta)
    several = record._replace(
        **{name: np.full(6, getattr(record, name)) for name in record._fields}
    )
    for one, again in zip(
        points(theta).at([0, 3], several, True), points(None).at([0, 3], several, True), strict=True
    ):
        np.testing.assert_array_equal(one, again)
