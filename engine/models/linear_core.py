"""A linear core in continuous time, discretised exactly for whatever parameters and dt it is given."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np

from engine.discretize import discretize
from engine.model import Array

# values (..., n), the last one dt -> F (..., nx, nx), G (..., nx, nu), Qc (..., nx, nx)
Build: TypeAlias = Callable[[Array], tuple[Array, Array, Array]]


class LinearCore:
    """A, B, Q of x' = F x + G u + noise over a step dt (van Loan); each distinct one computed once."""

    def __init__(self, build: Build) -> None:
        self._build = build
        self._one = lru_cache(maxsize=4096)(self._of)
        self._many = lru_cache(maxsize=16)(self._of_rows)

    def __call__(self, *values: Any) -> tuple[Array, ...]:
        """A (nx, nx), B (nx, nu), Q (nx, nx); (K, ., .) where some of the values are arrays (K,)."""
        if all(np.ndim(value) == 0 for value in values):
            return self._one(*(float(f"{value:.12g}") for value in values))
        rows = np.stack(np.broadcast_arrays(*values), axis=1).astype(float)
        return self._many(rows.tobytes(), len(values))

    def _of(self, *values: float) -> tuple[Array, ...]:
        return self._discretized(np.array(values))

    def _of_rows(self, data: bytes, n: int) -> tuple[Array, ...]:
        rows = np.frombuffer(data).reshape(-1, n)
        distinct: dict[tuple[float, ...], int] = {}
        which = [distinct.setdefault(tuple(row), len(distinct)) for row in rows.tolist()]
        matrices = self._discretized(np.array(list(distinct)))
        return tuple(matrix[0] if len(distinct) == 1 else matrix[which] for matrix in matrices)

    def _discretized(self, values: Array) -> tuple[Array, ...]:
        F, G, Qc = self._build(values)
        matrices = discretize(F, G, Qc, dt=values[..., -1])
        for matrix in matrices:
            matrix.setflags(write=False)  # they are shared between calls
        return matrices
