"""What stands in for ``solve`` and ``inv``: small systems by the operations they are, which kernels know."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from engine.statespace.recorded.arrays import (
    as_numbers,
    boxed,
    has_traced,
    opened,
    record_arrays,
    traced_array,
)
from engine.statespace.recorded.numbers import Traced, UntraceableError, record

SMALL = 4  # equations that are eliminated one by one


def solved(solve: Callable[..., Any]) -> Callable[..., Any]:
    """``np.linalg.solve``, or SciPy's: of a vector, of matrices, and of stacks of them."""

    def call(A: Any, b: Any) -> Any:
        left, right = (_objects(each) for each in (A, b))
        if not (has_traced(left) or has_traced(right)):
            return opened(solve(as_numbers(A), as_numbers(b)))
        if right.ndim == 1:
            return traced_array(_solution(left, right[:, None])[..., 0])
        return traced_array(_solution(left, right))

    return call


def inverted(inv: Callable[..., Any]) -> Callable[..., Any]:
    """``np.linalg.inv``, or SciPy's."""

    def call(A: Any) -> Any:
        own = _objects(A)
        if not has_traced(own):
            return opened(inv(as_numbers(A)))
        if own.ndim == 2 and own.shape[0] > SMALL:
            return record_arrays(lambda each: (np.linalg.inv(each),), (own,))[0]
        return traced_array(_solution(own, np.eye(own.shape[-1]).astype(object)))

    return call


def _objects(x: Any) -> Any:
    if isinstance(x, list | tuple):
        x = np.stack([_objects(one) for one in x])
    return np.asarray(boxed(x), dtype=object).view(np.ndarray)


def _solution(A: Any, B: Any) -> Any:
    """X (..., n, m) of A X = B, stacks of matrices (..., n, n) and (..., n, m)."""
    if A.ndim < 2 or B.ndim < 2 or A.shape[-2:] != (B.shape[-2],) * 2:
        raise UntraceableError  # which the function itself refuses
    lead = np.broadcast_shapes(A.shape[:-2], B.shape[:-2])
    out = np.empty((*lead, *B.shape[-2:]), dtype=object)
    both = (np.broadcast_to(each, (*lead, *each.shape[-2:])) for each in (A, B))
    left, right = both
    for at in np.ndindex(*lead):
        one = _eliminated if len(left[at]) <= SMALL else _by_inverse
        out[at] = one(left[at].tolist(), right[at].tolist())
    return out


def _eliminated(A: list[list[Any]], B: list[list[Any]]) -> Any:
    """Gauss's elimination, in the order of the largest pivots."""
    n = len(A)
    rows = [[*left, *right] for left, right in zip(A, B, strict=True)]
    for k in range(n):
        for i in range(k + 1, n):
            larger = record(np.greater, (_size(rows[i][k]), _size(rows[k][k])))
            pairs = list(zip(rows[i], rows[k], strict=True))
            rows[k] = [record(np.where, (larger, x, y)) for x, y in pairs]
            rows[i] = [record(np.where, (larger, y, x)) for x, y in pairs]
        for i in range(k + 1, n):
            factor = record(np.true_divide, (rows[i][k], rows[k][k]))
            for j in range(k + 1, len(rows[k])):
                less = record(np.multiply, (factor, rows[k][j]))
                rows[i][j] = record(np.subtract, (rows[i][j], less))
    for k in reversed(range(n)):
        for j in range(n, len(rows[k])):
            for i in range(k + 1, n):
                less = record(np.multiply, (rows[k][i], rows[i][j]))
                rows[k][j] = record(np.subtract, (rows[k][j], less))
            rows[k][j] = record(np.true_divide, (rows[k][j], rows[k][k]))
    return [row[n:] for row in rows]


def _size(x: Any) -> Any:
    return record(np.absolute, (x,))


def _by_inverse(A: list[list[Any]], B: list[list[Any]]) -> Any:
    """Larger ones: with the inverse, which is found once where no state changes it."""
    left, right = (np.array(each, dtype=object) for each in (A, B))
    entries = [x for x in left.flat if isinstance(x, Traced)]
    if any(x.index in x.recorder.of_states for x in entries):
        return record_arrays(lambda A, B: (np.linalg.solve(A, B),), (left, right))[0]
    inverse = record_arrays(lambda each: (np.linalg.inv(each),), (left,))[0] if entries else None
    own = np.linalg.inv(left.astype(float)) if inverse is None else inverse.view(np.ndarray)
    return own.astype(object).view(type(traced_array(left))) @ traced_array(right)
