"""Derivatives of a free run by parameters and first states, all columns in one recursion over time.

Along the run x_{t+1} = F(x_t, u_t, theta), y_t = G(x_t, u_t, theta), a column of d x_t / d(theta, x_1) obeys

    xi_{t+1} = J_t xi_t + b_t,      dy_t = H_t xi_t + d_t

with J = dF/dx, H = dG/dx and, for a parameter, b = dF/dtheta, d = dG/dtheta, xi_1 = 0; for a component of the
first state b = d = 0 and xi_1 is its unit vector. Columns cost hardly more than one run does, where
differences of runs cost two each. Where F has a kink the derivative is that of the side, or the mean of
both, on which the run is; where F jumps it says nothing of the jump.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.kernels.trajectory import carry
from engine.simulation.steps import (
    Steps,
    Values,
    observations,
    sizes,
    tested,
    transitions,
)
from engine.statespace.model import Array, MixedModel
from engine.statespace.reads import ignores


class Along:
    """A run x (T, nx), finite, with J = dF/dx (T-1, nx, nx) and H = dG/dx (T, ny, nx), which all columns share.

    ``slopes`` are J and H where they are known, as of the same model with an effect of size 0 in it.
    """

    def __init__(
        self,
        model: MixedModel,
        theta: Array,
        series: Series,
        x: Array,
        slopes: tuple[Array, Array] | None = None,
    ) -> None:
        self.model, self.theta, self.series, self.x = model, theta, series, x
        with np.errstate(all="ignore"):
            if slopes is None:
                moved = np.abs(x - x[0]).max(axis=0)
                size = sizes(moved, np.abs(x[0]), model.start_sizes)
                size = np.tile(size, (len(x), 1))
                J = self.F.slopes(x[:-1], self.ahead, size[:-1], central=True)
                slopes = J, self.G.slopes(x, self.seen, size, central=True)
        # in rows, whatever order a model's arrays have: a kernel is compiled for one order
        self.J, self.H = (np.ascontiguousarray(one) for one in slopes)

    @cached_property
    def F(self) -> Steps:
        """The steps from all rows but the last."""
        steps = transitions(self.model, self.model.record(self.theta), self.series)
        return _in_rows(self.model, steps, self.x[:-1])

    @cached_property
    def G(self) -> Steps:
        """The outputs at all rows."""
        steps = observations(self.model, self.model.record(self.theta), self.series)
        return _in_rows(self.model, steps, self.x)

    @cached_property
    def ahead(self) -> Values:
        """F along the run."""
        return self.F(self.x[:-1])

    @cached_property
    def seen(self) -> Values:
        """G along the run."""
        return self.G(self.x)

    def by(
        self,
        parameters: NDArray[np.intp],
        states: NDArray[np.intp],
        steps: Array,
        beginning: Array | None = None,
    ) -> tuple[Array, Array]:
        """Derivatives of the run's outputs and states.

        Parameters
        ----------
        parameters, states : (k,), (m,)
            Indices into theta and into x_1.
        steps : (k,)
            Half the distance over which a parameter's differences are taken, in its unit; shorter at a bound.
        beginning : (nx, k), optional
            Derivatives of the first states by the parameters, where they move these.

        Returns
        -------
        dy : (T, ny, k + m)
            In an output's unit per unit of the parameter or the state.
        dx : (T, nx, k + m)
            Likewise for the states.
        """
        k = len(parameters)
        ends = [_ends(self.model, self.theta, i, h) for i, h in zip(parameters, steps, strict=True)]
        first = np.zeros((self.model.nx, k + len(states)))
        first[:, :k] = 0.0 if beginning is None else beginning
        first[states, k + np.arange(len(states))] = 1.0
        with np.errstate(all="ignore"):
            b, d = self._steps(parameters, ends)
            still = np.zeros((*b.shape[:2], len(states)))
            xi = carry(self.J, np.concatenate((b, still), axis=2), first)
            dy = self.H @ xi
            dy[:, :, :k] += d
        return dy, xi

    def over_time(self, parameter: int, step: float, courses: Array) -> Array:
        """dy (T, ny, n) where one parameter runs over time along each of the ``courses`` (T, n)."""
        ends = [_ends(self.model, self.theta, parameter, step)]
        first = np.zeros((self.model.nx, courses.shape[1]))
        with np.errstate(all="ignore"):
            b, d = self._steps(np.array([parameter]), ends)
            b, d = b * courses[:-1, None], d * courses[:, None]
            return np.asarray(self.H @ carry(self.J, b, first) + d)

    def _steps(self, parameters: NDArray[np.intp], ends: list[Any]) -> tuple[Array, Array]:
        """dF/dtheta (T-1, nx, k) and dG/dtheta (T, ny, k) along the run."""
        T, nx = self.x.shape
        b, d = np.zeros((T - 1, nx, len(ends))), np.zeros((T, self.model.ny, len(ends)))
        for i, (k, end) in enumerate(zip(parameters, ends, strict=True)):
            if not ignores(self.model.dynamics, int(k)):
                b[:, :, i] = self.F.slope_between(self.x[:-1], self.ahead, *end)
            if not ignores(self.model.measurement, int(k)):
                d[:, :, i] = self.G.slope_between(self.x, self.seen, *end)
        return b, d


def _in_rows(model: MixedModel, steps: Steps, x: Array) -> Steps:
    return replace(steps, split=tested(model, steps, x) is None)


def _ends(
    model: MixedModel, theta: Array, i: int, step: float
) -> tuple[tuple[Any, Any], float, float]:
    """The records on both sides of theta in parameter i, and how far they are."""
    low, high = np.array(theta), np.array(theta)
    low[i] = max(theta[i] - step, model.lower[i])
    high[i] = min(theta[i] + step, model.upper[i])
    records = model.record(low), model.record(high)
    return records, float(low[i] - theta[i]), float(high[i] - theta[i])
