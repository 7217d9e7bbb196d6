"""One of a model's functions at many times of a series in one call, and its derivative there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from engine.data.series import Series
from engine.statespace.evaluation import ModelFunction
from engine.statespace.model import Array, MixedModel
from engine.statespace.refutation import calls_split
from engine.statespace.shapes import through

FORWARD, CENTRAL = 1e-7, 5e-6  # length of a difference as a share of a state's size, by kind
OF_VALUE = 1e-9  # the same as a share of a state's value, which rounding is a share of
TRIED = 4  # rows on which a function is tried first


@dataclass(frozen=True, eq=False)
class Steps:
    """x_{t+1} = f(a_t) + A(a_t) z_t, or y_t = h(a_t) + C(a_t) z_t, at n rows of a series at once.

    ``u`` (nu, n), ``t`` (n,) and ``dt``, (n,) or a number, are those of the rows; ``na`` of the nx states are
    nonlinear. ``record`` holds plain numbers. ``split`` says that the function does not take such rows in one
    call.
    """

    function: ModelFunction
    na: int
    u: Array
    t: Array
    dt: Any
    record: Any
    split: bool = False

    def rows(self, start: int, stop: int) -> Steps:
        """Those of rows start ... stop - 1."""
        own = slice(start, stop)
        dt = self.dt[own] if np.ndim(self.dt) else self.dt
        return replace(self, u=self.u[:, own], t=self.t[own], dt=dt)

    def at(self, record: Any) -> Steps:
        """The same with other parameters."""
        return replace(self, record=record)

    def __call__(self, x: Array) -> tuple[Array, Array, Array]:
        """The values (n, m) at x (n, nx), A and Q, common or (n, ., .); whatever the function raises."""
        call = self.function if self.split else self.function.once
        f, A, Q = call(x[:, : self.na], self.u, self.t, self.dt, self.record)
        return f + through(A, x[:, self.na :]), A, Q

    def slopes(self, x: Array, value: Array, A: Array, size: Array, central: bool) -> Array:
        """The derivative (n, m, nx) at x: A for the linear states, differences for the others.

        ``value`` and ``A`` are those at x, ``size`` (n, nx) or (nx,) what each state typically moves by.
        """
        J = np.empty((*value.shape, x.shape[1]))
        J[:, :, self.na :] = A
        share = CENTRAL if central else FORWARD
        step = np.maximum(share * size, OF_VALUE * np.abs(x))
        for i in range(self.na):
            J[:, :, i] = self._slope(x, value, i, step[:, i], central)
        return J

    def _slope(self, x: Array, value: Array, i: int, step: Array, central: bool) -> Array:
        """Difference quotients (n, m) in state i, one-sided unless ``central``."""
        up, ahead = self._moved(x, i, step)
        slope: Array = (ahead - value) / up
        if central or not np.isfinite(slope).all():
            down, behind = self._moved(x, i, -step)
            slope = _quotient((behind, value, ahead), down, up, central)
        return slope

    def _moved(self, x: Array, i: int, step: Array) -> tuple[Array, Array]:
        """By how much state i was really moved (n, 1), and the values there."""
        moved = x.copy()
        moved[:, i] += step
        return (moved[:, i] - x[:, i])[:, None], self(moved)[0]

    def slope_between(
        self, x: Array, value: Array, ends: tuple[Any, Any], down: float, up: float
    ) -> Array:
        """Difference quotient (n, m) between two records, at ``down`` <= 0 <= ``up`` from this one."""
        behind, ahead = (self.at(record)(x)[0] for record in ends)
        return _quotient((behind, value, ahead), down, up, True)


def _quotient(values: tuple[Array, Array, Array], down: Any, up: Any, central: bool) -> Array:
    """The slope from values behind, at and ahead of a point; on one side where the other is not finite."""
    behind, value, ahead = values
    forward, backward = (ahead - value) / up, (behind - value) / down
    slope: Array = np.where(np.isfinite(forward), forward, backward)
    if central:
        both = (ahead - behind) / (up - down)
        slope = np.where(np.isfinite(both), both, slope)
    return slope


def sizes(moved: Array, *others: Array) -> Array:
    """What each state (nx,) typically moves by; where that is 0 the first of ``others`` that is not, or 1."""
    size: Array = moved
    for other in (*others, np.ones_like(moved)):
        size = np.where(size > 0.0, size, other)
    return size


def deviations(Q: Array) -> Array:
    """Largest standard deviation (nx,) of each state's noise; Q (nx, nx) or (n, nx, nx)."""
    variances: Array = np.diagonal(Q, axis1=-2, axis2=-1).reshape(-1, Q.shape[-1]).max(axis=0)
    return np.sqrt(np.maximum(variances, 0.0))


def transitions(model: MixedModel, record: Any, series: Series) -> Steps:
    """The steps from all rows of a series but the last."""
    dt = series.dt if series.dt is not None else series.steps
    return Steps(model.transitions, model.na, series.u[:-1].T, series.t[:-1], dt, record)


def observations(model: MixedModel, record: Any, series: Series) -> Steps:
    """The outputs at all rows."""
    return Steps(model.observations, model.na, series.u.T, series.t, 0.0, record)


def tested(model: MixedModel, steps: Steps, x: Array) -> tuple[Array, Array, Array] | None:
    """Values, A and noise covariance at x, tested as :mod:`engine.statespace.evaluation` tests calls.

    None where the model, or one within it, does not take rows of other times in one call; that is found out
    on a few rows and remembered.
    """
    known = model.derived.setdefault("takes other times", {})
    kind = steps.function.name, np.ndim(steps.dt)
    few = min(TRIED, len(x))
    for n in (few, len(x)) if kind not in known else (len(x),):
        if known.get(kind, True):
            before, some = calls_split(), steps.rows(0, n)
            f, A, Q = some.function(x[:n, : some.na], some.u, some.t, some.dt, some.record)
            known[kind] = calls_split() == before
    return (f + through(A, x[:, steps.na :]), A, Q) if known[kind] else None
