"""Rows of a filter's result put one above the other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from engine.filters.rbpf import over_time


class Row(NamedTuple):
    value: object


COMMON, EACH = np.arange(4.0).reshape(1, 2, 2), np.arange(12.0).reshape(3, 2, 2)


@pytest.mark.parametrize(
    "rows",
    [
        [1.0, 2.0, -np.inf],
        [np.arange(3), np.arange(3)[::-1].copy()],
        [EACH, 2.0 * EACH],
        [EACH, EACH[::-1], np.asfortranarray(EACH)],
        [np.asfortranarray(EACH), EACH],
        [EACH, EACH.astype(np.float32)],
        [np.empty((3, 0)), np.empty((3, 0))],
    ],
)
def test_rows_of_one_shape_are_those_of_an_array(rows):
    out = over_time([Row(row) for row in rows])["value"]
    expected = np.array(rows)
    np.testing.assert_array_equal(out, expected)
    assert out.dtype == expected.dtype
    assert out.flags.carray


@pytest.mark.parametrize("rows", [[COMMON, EACH, COMMON], [EACH, COMMON], [COMMON, COMMON, EACH]])
def test_what_is_common_at_some_rows_is_repeated(rows):
    out = over_time([Row(row) for row in rows])["value"]
    np.testing.assert_array_equal(out, [np.broadcast_to(row, EACH.shape) for row in rows])
