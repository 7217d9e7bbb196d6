"""The model evaluated at every point of a set of trajectories, in one call where it can be."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.statespace.checks import READING, STEP, check_symmetric
from engine.statespace.first_state import moments_of_first
from engine.statespace.model import Array, LinearGaussian, MixedModel, Theta
from engine.statespace.refutation import refutations

KEPT_NUMBERS = 2**22  # at most, of all that is kept: long records take no more memory for it


class Points:
    """Trajectories a (T, N, na) of one series, at which the model is evaluated for any theta.

    Matrices come back as (T', N', ., .), with T' = 1 where common to all times and N' = 1 where
    common to all trajectories. What they are at ``home``, a theta that is asked for several times, is kept, and
    not to be written into.
    """

    def __init__(
        self, model: MixedModel, series: Series, a: Array, home: Theta | None = None
    ) -> None:
        self.model, self.series = model, series
        self._home = None if home is None else model.record(home)
        self._known: dict[tuple[int, bool, bytes], LinearGaussian] = {}
        self._room = KEPT_NUMBERS
        self.a = np.ascontiguousarray(a)
        self.T, self.N = a.shape[:2]
        model.transitions.look_again(series.u_step)
        model.observations.look_again(series.u)

    def transition(self, record: Any) -> LinearGaussian:
        """f (T-1, N, nx), A (T', N', nx, nz), Q (T', N', nx, nx) at t = 1 .. T-1."""
        return self.at(np.arange(self.T - 1), record, True)

    def observation(self, record: Any, rows: Any = None) -> LinearGaussian:
        """h (n, N, ny), C (T', N', ny, nz), R (T', N', ny, ny) at the given n rows (default all)."""
        return self.at(np.arange(self.T) if rows is None else rows, record, False)

    def at(self, rows: Any, record: Any, transition: bool) -> LinearGaussian:
        """The transition or the observation at the given rows; x_1 where a record begins next."""
        if not self._at_home(record):
            return self._at(rows, record, transition)
        # what a function was found not to take since then is wrong
        key = refutations(), transition, np.asarray(rows).tobytes()
        if key in self._known:
            return self._known[key]
        found = self._at(rows, record, transition)
        size = sum(x.size for x in found)
        if size <= self._room:
            self._known[key], self._room = found, self._room - size
        return found

    def _at_home(self, record: Any) -> bool:
        """Whether the record is that of ``home``; one of several parameter vectors, with arrays, is not."""
        return self._home is not None and all(
            isinstance(value, float) and value == own
            for value, own in zip(record, self._home, strict=True)
        )

    def _at(self, rows: Any, record: Any, transition: bool) -> LinearGaussian:
        n, N = len(rows), self.N
        function = self.model.transitions if transition else self.model.observations
        value, slope, cov = function(*self.arguments(rows, transition), record)
        check_symmetric(self.model, STEP if transition else READING, cov)
        found = value.reshape(n, N, -1), _unstack(slope, n, N), _unstack(cov, n, N)
        if transition and self.series.begins:
            return self._begun(np.asarray(rows), record, *found)
        return found

    def _begun(
        self, rows: NDArray[np.intp], record: Any, f: Array, A: Array, Q: Array
    ) -> LinearGaussian:
        """The transition at the given rows, into x_1 of whatever record begins next."""
        into = np.isin(rows + 1, self.series.begins)
        if not into.any():
            return f, A, Q
        f, A, Q = (np.array(np.broadcast_to(x, (len(rows), *x.shape[1:]))) for x in (f, A, Q))
        f[into], Q[into] = moments_of_first(self.model, record)
        A[into] = 0.0
        return f, A, Q

    def arguments(
        self, rows: NDArray[np.intp], transition: bool
    ) -> tuple[Array, Array, Array, Any]:
        """a (n N, na), u, t, dt of all points at the given rows of the series."""
        N, series = self.N, self.series
        dt: Any = 0.0  # a measurement has none
        if transition:
            dt = series.dt if series.dt is not None else np.repeat(series.steps[rows], N)
        return (
            self.a[rows].reshape(len(rows) * N, self.model.na),
            np.repeat((series.u_step if transition else series.u)[rows].T, N, axis=1),
            np.repeat(series.t[rows], N),
            dt,
        )


def _unstack(matrix: Array, n: int, N: int) -> Array:
    if matrix.ndim == 2:
        return matrix[None, None]
    return matrix.reshape(n, N, *matrix.shape[1:])
