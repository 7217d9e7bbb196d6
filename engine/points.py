"""The model evaluated at every point of a set of trajectories, in one call where it can be.

The model's functions take all particles of one time step. Many models, written with ``a[:, 0]`` and
``u[0]``, can as well take the particles of all time steps at once, with u (nu, K) and t (K,); this is
tried on a few rows and compared before it is relied on, so a model that cannot is merely slower.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.model import Array, MixedModel
from engine.series import Series

TRIED = 3  # time steps on which the stacked evaluation is compared with the plain one


class Points:
    """Trajectories a (T, N, na) of one series, at which the model is evaluated for any theta.

    Matrices come back as (T', N', ., .), with T' = 1 where common to all times and N' = 1 where
    common to all trajectories.
    """

    def __init__(self, model: MixedModel, series: Series, a: Array, theta: Array) -> None:
        self.model, self.series = model, series
        self.a = np.ascontiguousarray(a)
        self.T, self.N = a.shape[:2]
        record = model.record(theta)
        self.stacked = self._agrees(record)

    def transition(self, record: Any) -> tuple[Array, Array, Array]:
        """f (T-1, N, nx), A (T', N', nx, nz), Q (T', N', nx, nx) at t = 1 .. T-1."""
        return self.at(np.arange(self.T - 1), record, True)

    def observation(self, record: Any, rows: Any = None) -> tuple[Array, Array, Array]:
        """h (n, N, ny), C (T', N', ny, nz), R (T', N', ny, ny) at the given n rows (default all)."""
        return self.at(np.arange(self.T) if rows is None else rows, record, False)

    def at(self, rows: Any, record: Any, transition: bool) -> tuple[Array, Array, Array]:
        """The transition or the observation at the given rows."""
        evaluate = self._at if self.stacked else self._each
        return evaluate(rows, record, transition)

    def _at(self, rows: Any, record: Any, transition: bool) -> tuple[Array, Array, Array]:
        n, N, model = len(rows), self.N, self.model
        a = self.a[rows].reshape(n * N, model.na)
        u = np.repeat(self.series.u[rows].T, N, axis=1)
        t = np.repeat(self.series.t[rows], N)
        if transition:
            dt: Any = self.series.dt
            if dt is None:
                dt = np.repeat(self.series.steps[rows], N)
            value, slope, cov = model.transition(a, u, t, dt, record)
        else:
            value, slope, cov = model.observation(a, u, t, record)
        return value.reshape(n, N, -1), _unstack(slope, n, N), _unstack(cov, n, N)

    def _each(self, rows: Any, record: Any, transition: bool) -> tuple[Array, Array, Array]:
        model, u, times, steps = self.model, self.series.u, self.series.t, self.series.steps
        values, slopes, covs = [], [], []
        for t in rows:
            if transition:
                step = model.transition(self.a[t], u[t], float(times[t]), float(steps[t]), record)
            else:
                step = model.observation(self.a[t], u[t], float(times[t]), record)
            values.append(step[0])
            slopes.append(step[1] if step[1].ndim == 3 else step[1][None])
            covs.append(step[2] if step[2].ndim == 3 else step[2][None])
        return np.stack(values), _pile(slopes, self.N), _pile(covs, self.N)

    def _agrees(self, record: Any) -> bool:
        """Whether one call with all points gives what a call per time step gives."""
        if self.N < 2 and self.T < 4:
            return False
        rows = np.unique(np.linspace(0, self.T - 2, TRIED).astype(int))
        for transition in (True, False):
            plain = self._each(rows, record, transition)
            try:
                together = self._at(rows, record, transition)
            except Exception:  # noqa: BLE001 - the model was never promised stacked arguments
                return False
            for one, other in zip(plain, together, strict=True):
                if not np.allclose(one, other, rtol=1e-12, atol=0.0, equal_nan=True):
                    return False
        return True


def _unstack(matrix: Array, n: int, N: int) -> Array:
    if matrix.ndim == 2:
        return matrix[None, None]
    return matrix.reshape(n, N, *matrix.shape[1:])


def _pile(matrices: list[Array], N: int) -> Array:
    if any(len(m) > 1 for m in matrices):
        matrices = [np.broadcast_to(m, (N, *m.shape[1:])) for m in matrices]
    return np.stack(matrices)
