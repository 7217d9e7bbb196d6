"""One step of a model of differential equations, for one row of numbers that are being recorded.

The same as :func:`engine.kernels.local_linearization.step_of` after its differences, see
:mod:`engine.statespace.continuous`: the step is x = (a, 0) + B f + A_d (0, z), where A_d, B and the
noise are those of a step of F = [J A] (van Loan).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

from engine.kernels.local_linearization import LEAST, NEAR, SHORT
from engine.kernels.van_loan import van_loan
from engine.statespace.recorded.arrays import TracedArray, record_arrays
from engine.statespace.recorded.derivatives import linear_in
from engine.statespace.recorded.numbers import record
from engine.statespace.recorded.program import traced_results
from engine.statespace.rows import Array

Slope: TypeAlias = Callable[[Any], Any]


def over_a_step(F: Array, G: Array, Qc: Array, dt: Array) -> tuple[Array, Array, Array]:
    """A_d and Q (..., n, n), B (..., n, m) of F, Qc (..., n, n), G (..., n, m) over dt (...)."""
    *lead, n, m = G.shape
    K = math.prod(lead)
    A, B, Q = van_loan(
        F.reshape(K, n, n),
        G.reshape(K, n, m),
        _symmetric(Qc.reshape(K, n, n)),
        dt.reshape(K).copy(),
    )
    return A.reshape(F.shape), B.reshape(G.shape), Q.reshape(F.shape)


def _symmetric(Qc: Array) -> Array:
    return np.ascontiguousarray(0.5 * (Qc + np.swapaxes(Qc, -1, -2)))


class TracedStep:
    """``dynamics`` of one row, of ``drift``, ``diffusion`` and ``jacobian`` that take such rows."""

    def __init__(
        self,
        drift: Callable[..., Any],
        diffusion: Callable[..., Any],
        jacobian: Callable[..., Any] | None,
        sizes: Array,
        nz: int,
    ) -> None:
        self._drift, self._diffusion, self._jacobian = drift, diffusion, jacobian
        self._sizes, self._na, self._nz = sizes, len(sizes), nz

    def __call__(self, a: Any, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        """f (1, nx), A (1, nx, nz) and Q (1, nx, nx)."""
        na, nx = self._na, self._na + self._nz
        middle = t + 0.5 * dt
        recorder = dt.recorder
        begun = len(recorder.done)
        f, A = self._rates(a, u, middle, theta)
        linear = [linear_in(x, recorder, begun) for x in a[0]]
        found = (self._diffusion(a, u, middle, theta),)
        (Qc,) = _entries(found, ((nx, nx),))
        J = self._slopes(a, f, A, u, middle, dt, theta, linear)
        F = np.concatenate([J, A], axis=1)
        A_d, B, Q = record_arrays(over_a_step, [F, np.eye(nx), Qc, dt])
        moved = B @ f
        moved[:na] += a[0]
        return moved[None], A_d[None, :, na:], Q[None]

    def _rates(self, a: Any, u: Any, t: Any, theta: Any) -> Any:
        nx = self._na + self._nz
        return _entries(self._drift(a.copy(), u, t, theta), ((nx,), (nx, self._nz)))

    def _slopes(
        self, a: Any, f: Any, A: Any, u: Any, t: Any, dt: Any, theta: Any, linear: Sequence[Slope]
    ) -> Any:
        """J (nx, na): of a rate in which a state stands linearly as it is, and the same for all states.

        Of others differences over the ways of :func:`engine.kernels.local_linearization.beside`.
        """
        na, nx = self._na, self._na + self._nz
        if self._jacobian is not None:
            (J,) = _entries((self._jacobian(a.copy(), u, t, theta),), ((nx, na),))
            return J
        J = np.zeros((nx, na), dtype=object).view(TracedArray)
        for i, slope in enumerate(linear):
            J[:, i] = [slope(rate) for rate in f]
            bent = [r for r in range(nx) if J[r, i] is None]
            if not bent:
                continue
            way = dt * abs(f[i]) + 0.5 * dt**2 * np.sum(np.abs(A[i]) * np.abs(f[na:]))
            h = SHORT * way + LEAST * abs(a[0, i]) + NEAR * self._sizes[i]
            h = record(np.where, (h > 0.0, h, NEAR))
            up, down = a.copy(), a.copy()
            up[0, i] += h
            down[0, i] -= h
            above, below = (self._rates(one, u, t, theta)[0] for one in (up, down))
            J[bent, i] = (above - below)[bent] / (up[0, i] - down[0, i])
        return J


def _entries(found: Any, shapes: tuple[tuple[int, ...], ...]) -> list[Any]:
    """Results for the row without an axis for it, each (n,) or (r, c)."""
    results = traced_results(found, shapes)
    return [one.reshape(shape) for one, shape in zip(results, shapes, strict=True)]
