"""The arguments of a model's function, with what differs from row to row.

Row i of a (M, na) has its own time where ``u`` is (nu, M) or ``t``, ``dt`` are (M,), and its own
parameters where fields of the record ``theta`` are arrays (M,); whatever is not such an array is
common to all rows.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from engine.arrays import Array as Array

Indices: TypeAlias = NDArray[np.intp]

PERTURBATION = 4e-12  # relative: models may round their arguments to twelve digits


class Kind(NamedTuple):
    """Which arguments differ from row to row; ``fields`` are indices into the record.

    ``many``: so many time steps or parameter vectors that a call for each takes long.
    """

    u: bool
    t: bool
    dt: bool
    fields: tuple[int, ...]
    many: bool = False

    @property
    def times(self) -> bool:
        """Whether rows have times of their own."""
        return self.u or self.t or self.dt


def is_rows(value: Any) -> bool:
    """Whether a value is an array with an entry for each row."""
    return isinstance(value, np.ndarray) and value.ndim > 0


def regular_input(u: Any, M: int) -> Any:
    """u as (nu,), or (nu, M) where an entry of the sequence is an array; None stays."""
    if isinstance(u, (list, tuple)):
        if any(map(is_rows, u)):
            return np.array([np.broadcast_to(entry, (M,)) for entry in u], dtype=float)
        return np.array(u, dtype=float)
    return u


def with_input(u: Any, index: int, value: Any) -> Any:
    """The inputs u, (nu,) or (nu, M) or a sequence, with a value of one of them, a number or (M,), changed."""
    fits = isinstance(u, np.ndarray) and np.ndim(value) < u.ndim
    changed: Any = u.astype(float) if fits else list(u)
    changed[index] = value
    return changed


class Rows(NamedTuple):
    """a (M, na) with u, t, dt and the record theta of each row or of all."""

    a: Array
    u: Any
    t: Any
    dt: Any
    theta: Any

    def kind(self) -> Kind | None:
        """What differs from row to row; None where nothing does. Raises ValueError for other lengths."""
        M = len(self.a)
        own = [is_rows(self.t), is_rows(self.dt)]
        u = isinstance(self.u, np.ndarray) and self.u.ndim > 1
        fields = []
        for i, value in enumerate(self.theta):
            if value.__class__ is not float and is_rows(value):
                if len(value) != M:
                    raise ValueError(
                        f"{self.theta._fields[i]} has {len(value)} entries for {M} rows of a"
                    )
                fields.append(i)
        if not (u or fields or any(own)):
            return None
        for name, there, value in zip(("t", "dt"), own, (self.t, self.dt), strict=True):
            if there and len(value) != M:
                raise ValueError(f"{name} has {len(value)} entries for {M} rows of a")
        if u and self.u.shape[1] != M:
            raise ValueError(f"u has {self.u.shape[1]} columns for {M} rows of a")
        return Kind(u, own[0], own[1], tuple(fields))

    def fresh(self) -> Rows:
        """The same for a function that may write into what it is given."""
        return self._replace(a=self.a.copy())

    def frozen(self) -> Rows:
        """The same with read-only u, t and dt, as a series has them."""
        return self._replace(
            **{
                name: frozen(value.view())
                for name, value in (("u", self.u), ("t", self.t), ("dt", self.dt))
                if isinstance(value, np.ndarray)
            }
        )

    def take(self, kind: Kind | None, at: Indices) -> Rows:
        """The rows ``at``, each still with its own arguments."""
        if kind is None:
            return self._replace(a=self.a[at])
        return Rows(
            self.a[at],
            frozen(self.u[:, at]) if kind.u else self.u,
            frozen(self.t[at]) if kind.t else self.t,
            frozen(self.dt[at]) if kind.dt else self.dt,
            self._with(kind.fields, [frozen(self.theta[i][at]) for i in kind.fields]),
        )

    def alone(self, kind: Kind | None, at: Indices, whole: Kind | None = None) -> Rows:
        """The rows ``at``, which have all arguments in ``kind`` alike, with those as plain numbers.

        ``whole`` is the kind of all rows where ``kind`` is a part of it.
        """
        if kind is None:
            return self._replace(a=self.a[at])
        rows, i = self.take(whole or kind, at), at[0]
        return Rows(
            rows.a,
            frozen(self.u[:, i].copy()) if kind.u else rows.u,
            float(self.t[i]) if kind.t else rows.t,
            float(self.dt[i]) if kind.dt else rows.dt,
            rows._with(kind.fields, [float(self.theta[k][i]) for k in kind.fields]),
        )

    def groups(self, kind: Kind) -> Iterator[Indices]:
        """Indices of the rows that have all arguments in ``kind`` alike, group by group."""
        columns = self.columns(kind)
        if not columns:  # u has no entries
            yield np.arange(len(self.a))
            return
        table = np.array(columns, dtype=float).T.copy()
        edges = np.flatnonzero((table[1:] != table[:-1]).any(axis=1)) + 1
        found: dict[bytes, list[Indices]] = {}
        for run in np.split(np.arange(len(table)), edges):
            found.setdefault(table[run[0]].tobytes(), []).append(run)
        for runs in found.values():
            yield runs[0] if len(runs) == 1 else np.concatenate(runs)

    def extremes(self, kind: Kind | None, rng: np.random.Generator) -> Indices:
        """Rows where what differs is least and largest: a condition on it shows there first.

        Of times all is looked at, of states and parameters one.
        """
        columns = list(self.a.T) if kind is None else []
        if kind is not None:
            columns = (
                [self.theta[kind.fields[rng.integers(len(kind.fields))]]] if kind.fields else []
            )
            columns += self.columns(kind._replace(fields=()))
            if kind.u and len(self.u) > 1:
                columns += [self.u.max(axis=0), self.u.min(axis=0)]
        elif columns:
            columns = [columns[rng.integers(len(columns))]]
        ends = {int(end(column)) for column in columns for end in (np.argmin, np.argmax)}
        return np.array(sorted(ends or {0}), dtype=np.intp)

    def spread(
        self,
        kind: Kind | None,
        n: int,
        bounds: tuple[Array, Array],
        share: float,
        rng: np.random.Generator,
    ) -> Rows:
        """n rows drawn from these, states and parameters scattered between them.

        Parameters by the ``share`` of their size, within their bounds; states by their standard
        deviation, or where all rows are alike by the ``share`` of their size.
        """
        drawn = self.take(kind, rng.integers(0, len(self.a), n))
        with np.errstate(all="ignore"):
            known = np.nan_to_num(self.a, nan=0.0, posinf=0.0, neginf=0.0)  # a state may be lost
            width = np.maximum(known.std(axis=0), share * np.abs(drawn.a))
        a = drawn.a + np.where(np.isfinite(width), width, 0.0) * rng.uniform(
            -1.0, 1.0, drawn.a.shape
        )
        values = []
        for i in kind.fields if kind else ():
            value, low, high = drawn.theta[i], bounds[0][i], bounds[1][i]
            size = np.where(value != 0.0, np.abs(value), min(high - low, 1.0))
            moved = np.clip(value + share * size * rng.uniform(-1.0, 1.0, n), low, high)
            values.append(frozen(moved))
        return drawn._replace(a=a, theta=drawn._with(kind.fields if kind else (), values))

    def nudged(self, sign: float) -> Rows:
        """The same with states, inputs, time steps and parameters changed in the twelfth digit."""
        factor = 1.0 + sign * PERTURBATION
        fields = [i for i, value in enumerate(self.theta) if isinstance(value, float)]
        return self._replace(
            a=self.a * factor,
            u=self.u if self.u is None else np.asarray(self.u) * factor,
            dt=self.dt * factor,
            theta=self._with(tuple(fields), [self.theta[i] * factor for i in fields]),
        )

    def place(self) -> str:
        """Time and shapes in words, for an error."""
        t = np.asarray(self.t, dtype=float).ravel()
        when = f"{t[0]:g}" if len(t) == 1 else f"{t.min():g} ... {t.max():g}" if len(t) else "?"
        return f"called at t = {when} with a {np.shape(self.a)}, u {np.shape(self.u)}"

    def columns(self, kind: Kind) -> list[Array]:
        """All that differs from row to row but a, each (M,)."""
        columns = [self.theta[i] for i in kind.fields]
        columns += list(self.u) if kind.u else []
        columns += [self.t] if kind.t else []
        columns += [self.dt] if kind.dt else []
        return columns

    def _with(self, fields: tuple[int, ...], values: list[Any]) -> Any:
        """The record with some fields replaced."""
        if not fields:
            return self.theta
        out = list(self.theta)
        for i, value in zip(fields, values, strict=True):
            out[i] = value
        return self.theta._make(out)


def frozen(array: Array) -> Array:
    """Read-only, so that a model may remember what belongs to it."""
    array.setflags(write=False)
    return array
