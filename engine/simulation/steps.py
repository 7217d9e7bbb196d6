"""One of a model's functions at many times of a series in one call, and its derivative there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from engine.data.series import Series
from engine.failing import where_it_fails
from engine.kernels.trajectory import displaced, fill_column
from engine.statespace.compare import Result
from engine.statespace.evaluation import ModelFunction
from engine.statespace.model import Array, MixedModel
from engine.statespace.refutation import calls_split
from engine.statespace.shapes import through

FORWARD, CENTRAL = 1e-7, 5e-6  # length of a difference as a share of a state's size, by kind
OF_VALUE = 1e-9  # the same as a share of a state's value, which rounding is a share of
ALONE, OF_NUMBER = 1e-9, 1e-12  # of how values vary, of their size: what calls may differ by
TRIED = 4  # rows on which a function is tried first


class Values(NamedTuple):
    """f + A z (n, m); f (n, m), A and the noise's covariance Q, common or (n, ., .)."""

    value: Array
    f: Array
    A: Array
    Q: Array


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

    def __call__(self, x: Array) -> Values:
        """The values at x (n, nx); whatever the function raises."""
        call = self.function if self.split else self.function.once
        return _values(x, call(x[:, : self.na], self.u, self.t, self.dt, self.record))

    def as_alone(self, x: Array, values: Array) -> bool:
        """Whether values (n, m) at x (n, nx) are those of single rows: the last, extreme states.

        A function may take its rows together until a state that was not seen before.
        """
        ends = (end(x[:, i]) for i in range(self.na) for end in (np.argmin, np.argmax))
        rows = np.array(sorted({len(x) - 1, *map(int, ends)}))
        alone = np.empty((len(rows), values.shape[1]))
        for k, i in enumerate(rows.tolist()):
            dt = float(self.dt[i]) if np.ndim(self.dt) else self.dt
            row = x[i : i + 1]
            own = self.function(row[:, : self.na], self.u[:, i], float(self.t[i]), dt, self.record)
            alone[k] = _values(row, own).value[0]
        return near(alone, values, rows)

    def slopes(
        self, x: Array, at: Values, size: Array, central: bool, known: Array | None = None
    ) -> Array:
        """The derivative (n, m, nx) at x: A for the linear states, differences for the others.

        ``at`` are the values at x, ``size`` (n, nx) what each state typically moves by. ``known`` is
        the derivative at other states of the same rows, which is overwritten.
        """
        J = np.empty((*at.value.shape, x.shape[1])) if known is None else known
        if known is None or at.A.ndim == 3:  # else it is common to all states
            J[:, :, self.na :] = at.A
        share = CENTRAL if central else FORWARD
        for i in range(self.na):
            up, ahead, base = self._moved(x, at, i, share, size)
            if central or not fill_column(J, i, ahead, base, up):
                down, behind, _ = self._moved(x, at, i, -share, size)
                ends = behind - base, ahead - base, down[:, None], up[:, None]
                J[:, :, i] = _quotient(*ends, central)
        return J

    def _moved(
        self, x: Array, at: Values, i: int, share: float, size: Array
    ) -> tuple[Array, Array, Array]:
        """By how much state i was really moved (n,); values (n, m) there and at x, without what is alike."""
        a, up = displaced(x, self.na, i, share, OF_VALUE, size)
        call = self.function if self.split else self.function.once
        f, A, _ = call(a, self.u, self.t, self.dt, self.record)
        if A.ndim == 2 and at.A.ndim == 2:  # common to all states
            return up, f, at.f
        return up, f + through(A, x[:, self.na :]), at.value

    def slope_between(
        self, x: Array, at: Values, ends: tuple[Any, Any], down: float, up: float
    ) -> Array:
        """Difference quotient (n, m) between two records, at ``down`` <= 0 <= ``up`` from this one.

        Where the model cannot be had at one of them, it is that between the other and this one.
        """
        lost = np.full_like(at.value, np.nan)

        def values(record: Any) -> Array:
            return self.at(record)(x).value

        fall, rise = (where_it_fails(lost)(values)(record) - at.value for record in ends)
        return _quotient(fall, rise, down, up, True)


def _values(x: Array, result: Result) -> Values:
    f, A, Q = result
    return Values(f + through(A, x[:, x.shape[1] - A.shape[-1] :]), f, A, Q)


def _quotient(fall: Array, rise: Array, down: Any, up: Any, central: bool) -> Array:
    """The slope from what changes below and above a point; of one side where the other is not finite."""
    forward, backward = rise / up, fall / down
    slope: Array = np.where(np.isfinite(forward), forward, backward)
    if central:
        both = (rise - fall) / (up - down)
        slope = np.where(np.isfinite(both), both, slope)
    return slope


def near(one: Array, values: Array, rows: Any = slice(None)) -> bool:
    """Whether values that were made otherwise agree with the ``rows`` of values (n, m)."""
    own = values[rows]
    allowed = ALONE * np.abs(values - values[0]).max(axis=0) + OF_NUMBER * np.abs(own)
    return bool((np.abs(one - own) <= allowed).all())


def sizes(moved: Array, *others: Array) -> Array:
    """What each state (nx,) typically moves by; where that is 0 the first of ``others`` that is not, or 1."""
    size: Array = moved
    for other in (*others, np.ones_like(moved)):
        size = np.where(size > 0.0, size, other)
    return size


def transitions(model: MixedModel, record: Any, series: Series) -> Steps:
    """The steps from all rows of a series but the last."""
    dt = series.dt if series.dt is not None else series.steps
    return Steps(model.transitions, model.na, series.u_step[:-1].T, series.t[:-1], dt, record)


def observations(model: MixedModel, record: Any, series: Series) -> Steps:
    """The outputs at all rows."""
    return Steps(model.observations, model.na, series.u.T, series.t, 0.0, record)


def tested(model: MixedModel, steps: Steps, x: Array) -> Values | None:
    """Values at x (n, nx), tested as :mod:`engine.statespace.evaluation` tests calls.

    None where the model, or one within it, does not take rows of other times in one call; that is found out
    on a few rows and remembered.
    """
    known = model.derived.setdefault("takes other times", {})
    kind = steps.function.name, np.ndim(steps.dt)
    few = min(TRIED, len(x))
    for n in (few, len(x)) if kind not in known else (len(x),):
        if known.get(kind, True):
            before, some = calls_split(), steps.rows(0, n)
            result = some.function(x[:n, : some.na], some.u, some.t, some.dt, some.record)
            known[kind] = calls_split() == before
    return _values(x, result) if known[kind] else None
