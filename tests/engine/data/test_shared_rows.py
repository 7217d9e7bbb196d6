"""A test that is a part of a training record is told, wherever the part stands; experiments alike are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.data.series import Series
from engine.data.shared_rows import about_shared_rows, shared_rows


def record(seed, T=200, missing=0.1):
    rng = np.random.default_rng(seed)
    y = np.round(rng.standard_normal((T, 2)).cumsum(axis=0), 2)
    y[rng.random((T, 2)) < missing] = np.nan
    return Series(y, np.sign(rng.standard_normal((T, 1))), dt=0.5)


@pytest.mark.parametrize(("first", "last"), [(0, 199), (30, 90), (120, 200)])
@pytest.mark.parametrize("before", [0, 1, 37])
def test_a_part_of_another_record_is_found(first, last, before):
    one, other = record(1), record(2)
    y, u = (
        np.concatenate([b[:before], a[first:last]]) for a, b in ((one.y, other.y), (one.u, other.u))
    )
    found = shared_rows([record(3), one, Series(y, u, dt=0.5)])
    assert (found.earlier, found.later) == (1, 2)
    assert abs(found.first - before) <= 2
    assert found.last == before + last - first - 1
    given = [record(3), one]
    assert (
        f"to {found.last} of the test, counted from 0, are those of a record"
        in about_shared_rows(given, [Series(y, u, dt=0.5)])
    )
    assert "of record 2, counted from 0, are those of record 1" in about_shared_rows(
        [*given, Series(y, u, dt=0.5)]
    )


def test_what_is_alike_is_not():
    """Independent records, the same input, rests of a coarse sensor, seldom readings, a few rows in common."""
    rng, one = np.random.default_rng(5), record(1)
    same_input = replace(record(2), u=one.u)
    at_rest = [
        Series(
            np.round(0.1 * rng.standard_normal((300, 1)), 1) * (np.arange(300) > 200)[:, None],
            dt=1.0,
        )
        for _ in range(2)
    ]
    seldom = [
        Series(
            np.where(np.arange(300) % 20, np.nan, rng.standard_normal(300))[:, None],
            np.ones((300, 1)),
            dt=1.0,
        )
        for _ in range(2)
    ]
    few = Series(
        np.concatenate([one.y[:25], record(4).y]), np.concatenate([one.u[:25], record(4).u]), dt=0.5
    )
    for records in ([one, record(2), record(3)], [one, same_input], at_rest, seldom, [one, few]):
        assert shared_rows(records) is None
        assert about_shared_rows(records[:1], records[1:]) == ""


def test_short_and_other_records_say_nothing():
    assert shared_rows([record(1)]) is None
    assert shared_rows([record(1, T=10), record(2, T=10)]) is None
    assert shared_rows([record(1), Series(np.zeros((50, 1)), dt=1.0)]) is None
