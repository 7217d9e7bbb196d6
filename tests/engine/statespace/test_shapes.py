"""What a model may return, in the one layout that kernels are compiled for."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import ModelError
from engine.statespace.shapes import as_matrix, as_rows

M = 5
x = np.arange(1.0, M + 1)
ROWS = np.stack([x, np.zeros(M), np.full(M, 2.0)], axis=1)
MATRIX = np.array([[1.0, 2.0], [0.0, 4.0], [5.0, 6.0]])
EACH = np.repeat(MATRIX[None], M, axis=0)
EACH[:, 0, 1] = x


def read_only(array):
    array = array.copy()
    array.setflags(write=False)
    return array


@pytest.mark.parametrize(
    "value",
    [
        [x, 0.0, 2],
        (x, 0, np.float32(2.0)),
        [x, np.zeros(M), np.array(2.0)],
        np.array([x, np.zeros(M), np.full(M, 2.0)]),
        ROWS,
        np.asfortranarray(ROWS),
        ROWS.astype(np.float32),
        read_only(ROWS),
        np.array([x, 0.0, 2.0], dtype=object),
    ],
)
def test_rows_come_in_one_layout_however_they_are_written(value):
    if isinstance(value, np.ndarray) and value.shape == (3, M):
        value = list(value)
    out = as_rows(value, M, 3, "f")
    np.testing.assert_array_equal(out, ROWS)
    assert out.dtype == float
    assert out.flags.carray


@pytest.mark.parametrize(
    "value",
    [
        MATRIX.tolist(),
        tuple(map(tuple, MATRIX.tolist())),
        [[1, np.float64(2.0)], [False, np.array(4.0)], np.array([5.0, 6.0])],
        [[np.float32(1.0), 2], [0, 4], [5, 6]],
        MATRIX.astype(int),
        np.asfortranarray(MATRIX),
        read_only(MATRIX),
        MATRIX.astype(object),
    ],
)
def test_a_common_matrix_comes_in_one_layout_however_it_is_written(value):
    out = as_matrix(value, M, 3, 2, "A")
    np.testing.assert_array_equal(out, MATRIX)
    assert out.dtype == float
    assert out.flags.carray


@pytest.mark.parametrize(
    "value",
    [[[1.0, x], [0, np.array(4.0)], [5.0, np.full(M, 6)]], EACH, np.asfortranarray(EACH)],
)
def test_a_matrix_of_each_row_comes_in_one_layout(value):
    out = as_matrix(value, M, 3, 2, "A")
    np.testing.assert_array_equal(out, EACH)
    assert out.flags.carray


def test_a_matrix_of_one_entry_may_be_a_number_and_one_without_entries_anything():
    np.testing.assert_array_equal(as_matrix(3, M, 1, 1, "R"), np.full((M, 1, 1), 3.0))
    for nothing in ([], [[], [], []], np.zeros((0, 0)), None):
        assert as_matrix(nothing, M, 3, 0, "A").shape == (3, 0)


def test_what_is_returned_is_not_the_list_that_was_given():
    value = MATRIX.tolist()
    as_matrix(value, M, 3, 2, "A")[0, 0] = 9.0
    assert value[0][0] == 1.0
    assert as_matrix(value, M, 3, 2, "A")[0, 0] == 1.0


@pytest.mark.parametrize("value", [[[1.0, 2.0]], [[1.0], [2.0], [3.0]], [1.0, 2.0, 3.0]])
def test_a_matrix_of_another_shape_is_refused(value):
    with pytest.raises(ModelError, match="A "):
        as_matrix(value, M, 3, 2, "A ")
