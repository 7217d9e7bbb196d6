"""A linear core in continuous time, discretised exactly for whatever parameters and dt it is given."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np

from engine.statespace.discretization import checked_step, discretize
from engine.statespace.model import Array
from engine.statespace.recorded.arrays import TracedArray, record_arrays
from engine.statespace.recorded.numbers import Traced
from engine.statespace.recorded.stand_ins import Within, traceable

# values (..., n), the last one dt -> F (..., nx, nx), G (..., nx, nu), Qc (..., nx, nx)
Build: TypeAlias = Callable[[Array], tuple[Array, Array, Array]]


class LinearCore:
    """A, B, Q of x' = F x + G u + noise over a step dt (van Loan); each distinct one computed once."""

    def __init__(self, build: Build) -> None:
        self._build = build
        self._one = lru_cache(maxsize=4096)(self._of)
        self._many = lru_cache(maxsize=16)(self._of_rows)
        self._last: tuple[tuple[Any, ...], tuple[Array, ...]] = ((), ())

    def __call__(self, *values: Any) -> tuple[Array, ...]:
        """A (nx, nx), B (nx, nu), Q (nx, nx); (K, ., .) where some of the values are arrays (K,)."""
        if any(isinstance(value, Traced) for value in values):
            return self._recorded(values)
        values = (*values[:-1], _rounded(values[-1]))
        known, matrices = self._last  # a filter asks for the same ones at every step
        if len(known) == len(values) and all(map(_same, known, values)):
            return matrices
        matrices = self._of_values(values)
        if all(map(_lasting, values)):
            self._last = (values, matrices)
        return matrices

    def _of_values(self, values: tuple[Any, ...]) -> tuple[Array, ...]:
        if all(np.ndim(value) == 0 for value in values):
            return self._one(*map(float, values))
        rows = np.stack(np.broadcast_arrays(*values), axis=1).astype(float)
        return self._many(rows.tobytes(), len(values))

    def _of(self, *values: float) -> tuple[Array, ...]:
        return self._discretized(np.array(values))

    def _of_rows(self, data: bytes, n: int) -> tuple[Array, ...]:
        rows = np.frombuffer(data).reshape(-1, n)
        distinct: dict[tuple[float, ...], int] = {}
        which = [distinct.setdefault(tuple(row), len(distinct)) for row in rows.tolist()]
        matrices = self._discretized(np.array(list(distinct)))
        return _shared(matrix[0] if len(distinct) == 1 else matrix[which] for matrix in matrices)

    def _recorded(self, values: tuple[Any, ...]) -> tuple[Array, ...]:
        """A, B, Q in a function that is being recorded."""
        row = np.array([values], dtype=object).view(TracedArray)
        matrices = traceable(self._build, Within())(row)
        return record_arrays(checked_step, [*(one[0] for one in matrices), values[-1]])

    def _discretized(self, values: Array) -> tuple[Array, ...]:
        F, G, Qc = self._build(values)
        return _shared(discretize(F, G, Qc, dt=values[..., -1]))


def _shared(matrices: Iterable[Array]) -> tuple[Array, ...]:
    """Read-only, as they are handed out again in later calls."""
    out = tuple(matrices)
    for matrix in out:
        matrix.setflags(write=False)
    return out


def _same(one: Any, other: Any) -> bool:
    return one is other or (isinstance(one, float) and isinstance(other, float) and one == other)


def _rounded(dt: Any) -> Any:
    """To 12 digits, a number or (K,): differences of times scatter by their rounding.

    Alone and beside others alike; parameters stay as they are, as a rounded one would be another.
    """
    if not isinstance(dt, np.ndarray) or not dt.ndim:
        return _rounded_number(float(dt))
    digits = 10.0 ** (11.0 - np.floor(np.log10(dt)))
    return np.round(dt * digits) / digits


@lru_cache(maxsize=4096)
def _rounded_number(dt: float) -> float:
    return float(f"{dt:.12g}")


def _lasting(value: Any) -> bool:
    """Whether a value cannot change behind our back."""
    return isinstance(value, float) or (isinstance(value, np.ndarray) and not value.flags.writeable)
