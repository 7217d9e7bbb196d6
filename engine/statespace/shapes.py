"""What a model's functions may return, in the one layout that kernels are compiled for."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.errors import ModelError
from engine.kernels.gaussian import NEGATIVE
from engine.statespace.rows import Array

ROUNDING = (
    NEGATIVE  # of a standard deviation each, what a covariance may be off: one rule at every step
)


def as_rows(value: Any, M: int, n: int, where: str) -> Array:
    """(M, n) float array from an array or a list of n rows, each a number or (M,)."""
    if value.__class__ is not list:
        if isinstance(value, np.ndarray) and value.dtype.char != "O":
            if value.shape == (M, n):
                return regular(value, where)
            if value.shape == (n,):
                return np.repeat(regular(value, where)[None], M, axis=0)
            raise _shape_error(where, value.shape, f"({M}, {n}) or ({n},)")
        if _is_number(value):  # a single row may be written as a number
            value = [value]
    if len(value) != n:
        raise _shape_error(where, (len(value),), f"a list of {n} rows")
    out = np.zeros((M, n))
    i, row = 0, value
    try:
        for i, row in enumerate(value):
            if row.__class__ is not float or row != 0.0:
                out[:, i] = real(row, where) if row.__class__ is np.ndarray else row
    except (ValueError, TypeError) as error:
        real(row, where)
        raise ModelError(
            f"{where}: row {i} has shape {np.shape(row)}; a number or ({M},) is needed"
        ) from error
    return out


def as_matrix(value: Any, M: int, rows: int, columns: int, where: str) -> Array:
    """(rows, columns) when common to all particles, else (M, rows, columns)."""
    if value.__class__ is not np.ndarray or value.dtype.char == "O":
        numbers = _numbers(value)
        if numbers is not None and numbers.shape == (rows, columns):
            return numbers
        value = _nested(value, M, rows, columns, where)
    shape = value.shape
    if shape == (rows, columns) or shape == (M, rows, columns):
        return regular(value, where)
    if value.size == rows * columns == 0:
        return np.zeros((rows, columns))
    raise _shape_error(where, shape, f"({rows}, {columns}) or ({M}, {rows}, {columns})")


def regular(value: Any, where: str) -> Array:
    """The one layout that kernels are compiled for: float, C-contiguous, writeable."""
    out: Array = value
    if out.flags.carray and out.dtype.char == "d":
        return out
    out = np.ascontiguousarray(real(value, where), dtype=float)
    return out if out.flags.writeable else out.copy()


def real(value: Any, where: str) -> Any:
    """The value, unless it is complex: its real part alone, which NumPy would keep, is another model."""
    if np.iscomplexobj(value):
        raise ModelError(f"{where} is complex, as the root of a negative number is", numeric=True)
    return value


def stacked(matrix: Array) -> Array:
    """(B, ., .) with B = 1 for a matrix common to all particles."""
    return matrix[None] if matrix.ndim == 2 else matrix


def squared(root: Array) -> Array:
    """The covariances (..., n, n) of roots (..., n, n)."""
    return np.asarray(root @ np.swapaxes(root, -1, -2))


def through(A: Array, z: Array) -> Array:
    """A z for each row of z (K, nz): A (n, nz) or (K, n, nz) -> (K, n)."""
    return z @ A.T if A.ndim == 2 else np.einsum("kij,kj->ki", A, z)


def _nested(value: Any, M: int, rows: int, columns: int, where: str) -> Array:
    """A nested list whose entries are numbers or (M,)."""
    if rows * columns == 0:
        return np.zeros((rows, columns))
    if _is_number(value):  # a 1 x 1 matrix may be written as a number
        value = [[value]]
    if len(value) != rows or any(_is_number(row) or len(row) != columns for row in value):
        raise ModelError(f"{where} is not a list of {rows} rows of {columns} entries")
    out = np.empty((M, rows, columns))
    for i, row in enumerate(value):
        for j, entry in enumerate(row):
            out[:, i, j] = real(entry, where)
    return out


def _numbers(value: Any) -> Array | None:
    """A nested list of numbers as an array, None where entries are arrays."""
    try:
        for row in value:
            for entry in row:
                if entry.__class__ is np.ndarray and entry.ndim:
                    return None  # sooner than NumPy would say so
        return np.array(value, dtype=float)
    except (ValueError, TypeError):  # entries of different shapes, or no list of lists
        return None


def _is_number(value: Any) -> bool:
    return not isinstance(value, (list, tuple)) and getattr(value, "ndim", 0) == 0


def _shape_error(where: str, got: tuple[int, ...], needed: str) -> ModelError:
    return ModelError(f"{where} has shape {got}; {needed} is needed")


def is_symmetric(S: Array) -> bool:
    """Whether covariances (..., n, n) are symmetric, up to rounding of the standard deviations they hold."""
    other = np.swapaxes(S, -1, -2)
    if S.tobytes() == other.tobytes():  # a fifth of the time of a comparison of numbers
        return True
    spread = np.sqrt(np.abs(np.diagonal(S, axis1=-2, axis2=-1)))
    return not (np.abs(S - other) > ROUNDING * spread[..., None] * spread[..., None, :]).any()
