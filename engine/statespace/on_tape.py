"""A model's functions on tape, for what goes through a whole record: filters and free runs.

At the end of each pass, and at its beginning while a tape is new, the function is called as well and compared:
where it says something else its tape is given up, and the work is done by calls. A pass that meets a way
through the function that the tape does not have begins anew with one that has it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from engine.kernels.tape import evaluate
from engine.statespace.evaluation import ModelFunction
from engine.statespace.kept_tape import KeptTape, OfRecord, rows_of
from engine.statespace.rows import Array
from engine.statespace.tape import LeftError, Lines
from engine.words import enumerated

SHORTEST = 40  # rows of a record, below which recording takes longer than it saves
MOST_LEFT = 2  # times that a tape is left before it was gone through as often
SAME = 1e-9  # of the largest entry of its kind
SLOPES = 1e-7  # of it, where slopes may be differences
AT_REST = 1e-3  # of it, where these may be beside states at rest


_KEPT: WeakKeyDictionary[ModelFunction, KeptTape] = WeakKeyDictionary()


@dataclass
class OnTape:
    """A model's function on tape, for rows of ``thetas``, and its ``call``.

    ``theta`` is a record of parameters. ``differences``: a call may take its slopes by the states from
    differences, as a step of differential equations does.
    """

    kept: KeptTape
    function: ModelFunction
    lines: Lines
    call: Callable[[int, Array], tuple[Array, Array, Array]]
    record: OfRecord
    thetas: Array
    theta: Any
    differences: bool

    @cached_property
    def u(self) -> Array:
        """The inputs (T, .), with what else the tape takes of them and the times."""
        u, columns = self.record.u, self.lines.columns
        return np.array(np.concatenate([u, columns], axis=1), order="C") if columns.size else u

    @property
    def t(self) -> Array:
        """The times (T,)."""
        return self.record.t

    @property
    def dt(self) -> Array:
        """The steps (T,)."""
        return self.record.dt

    @property
    def shapes(self) -> Sequence[tuple[int, ...]]:
        """Those of the results."""
        return self.function.shapes

    @property
    def moves(self) -> bool:
        """Whether it is the dynamics, whose first result are the states of the next row."""
        return self.function.name == "dynamics"

    @property
    def results(self) -> tuple[Array, ...]:
        """The three results at the last call, in their shapes."""
        pairs = zip(self.lines.results, self.shapes, strict=True)
        return tuple(flat.reshape(len(flat), *shape) for flat, shape in pairs)

    @property
    def arguments(self) -> tuple[Any, ...]:
        """As the kernels of :mod:`engine.kernels.taped` take it."""
        lines = self.lines
        return lines.codes, lines.links, lines.space, lines.places, lines.results, self.results

    def agrees(
        self,
        t: int,
        a: Array | None = None,
        share: float = SAME,
        lost: NDArray[np.bool_] | None = None,
    ) -> bool:
        """Whether a call at row t says the same, at states a (K S, na) or the last; else no tape is used.

        But for a ``share`` of each entry's size, or for what differences over small ways round away in a step's
        matrices: where a run is ``lost`` (K,), so far off that this is all there is.
        """
        lines = self.lines
        if a is None:
            a = lines.points
        else:
            given = (*self.arguments[:-1], a, self.u[t], float(self.t[t]), float(self.dt[t]))
            if not evaluate(*given):
                return True  # nothing is made of it
        there = np.asarray(np.isfinite(a).all(axis=1))  # nothing is made of what others say
        if lost is not None:
            there &= ~np.repeat(lost, len(a) // len(lost))
        # what stops a state exactly, in one order of its sums, leaves rounding of where it was in another
        least = [np.zeros(shape) for shape in self.shapes]
        if self.moves:
            least[0][: a.shape[1]] = np.abs(a[there]).max(axis=0, initial=0.0)
        called = self.call(t, a)
        # of a covariance an entry is small or large beside both deviations
        deviations = np.sqrt(_sizes(called[2], there).diagonal())
        least[2] = np.outer(deviations, deviations)
        of_slopes = max(share, SLOPES) if self.differences else share
        shares = share, of_slopes, of_slopes
        both = zip(self.results, called, least, shares, strict=True)
        if not all(_same(taped, own, there, size, of) for taped, own, size, of in both):
            self.kept.over = True
        return not self.kept.over

    def begins_well(self, a: Array) -> bool:
        """Whether it is what a call says at the first row, at states a (K S, na); asked while it is new.

        A record often starts at rest, where a call's differences over small ways are little more than rounding.
        """
        known = self.kept.passes >= self.kept.known
        return known or self.agrees(0, a, AT_REST if self.differences else SAME)

    def learns(self) -> bool:
        """Whether the tape was left for another way, and there is one that has it: the pass begins anew.

        Where a call says something else there no tape is used.
        """
        lines, (u, t, _, called) = self.lines, self.record
        there = np.asarray(np.isfinite(lines.points).all(axis=1))
        if not there.any():
            return False
        a, heads = lines.points[there], lines.space[lines.na :, 0]
        now, clock = heads[: u.shape[1]], heads[u.shape[1] + lines.more :][:2]
        each = np.repeat(self.thetas, len(there) // len(self.thetas), axis=0)[there]
        rows = a, np.tile(now, (len(a), 1)), np.tile(clock, (len(a), 1)), each
        if not self.kept.learn_all(self.function, rows, self.theta):
            return False
        self.kept.learn_all(self.function, rows_of(self.record, a[0], each[0]), self.theta)
        own = self.function, self.call, self.record
        again = on_tape(*own, lines.points, self.thetas, self.theta, self.differences)
        row = int(np.argmax(called & (t == clock[0]) & (u == now).all(axis=1)))
        return again is not None and again.agrees(row, lines.points)

    def note(self, done: bool) -> None:
        """Note whether it was gone through to the end; it is taken no more where most records leave it."""
        if done:
            self.kept.passes += 1
        else:
            self.kept.left += 1
            if self.kept.left > max(MOST_LEFT, self.kept.passes):
                self.kept.over = True


def _same(
    taped: Array, called: Array, there: NDArray[np.bool_], least: Array, share: float
) -> bool:
    """Whether results (1 or M, ...) are the same in rows ``there`` (M,).

    But for a ``share`` of each entry's size over all rows; ``least`` (...) are sizes that it has at least.
    """
    if (taped == called).all():  # as most are
        return True
    sizes = np.maximum(_sizes(called, there), least)
    taped, called = (x[there] if len(x) > 1 else x for x in (taped, called))
    neither = ~(np.isfinite(called) | np.isfinite(taped))
    return bool(np.all((np.abs(taped - called) <= share * sizes) | (taped == called) | neither))


def _sizes(of: Array, there: NDArray[np.bool_]) -> Array:
    """The largest finite size of each entry (1 or M, ...) in rows ``there`` (M,)."""
    rows = of[there] if len(of) > 1 else of
    return np.asarray(np.abs(np.where(np.isfinite(rows), rows, 0.0)).max(axis=0, initial=0.0))


def about_calls(functions: Sequence[ModelFunction]) -> str:
    """A sentence on functions of a model, asked for a tape before, that had to be called, else ""."""
    called = [
        (each.name, _KEPT[each].where) for each in functions if each in _KEPT and _KEPT[each].over
    ]
    if not called:
        return ""
    which = enumerated(
        [f"{name} ({where.rstrip('; ')})" if where else name for name, where in called]
    )
    return (
        f"Compiled filters could not be used for {which}, and calls take many times as long. Compiled are "
        "formulas of NumPy and of math, curves of scipy.interpolate, solve_ivp and engine.discretize."
    )


def on_tape(
    function: ModelFunction,
    call: Callable[[int, Array], tuple[Array, Array, Array]],
    record: OfRecord,
    a: Array,
    thetas: Array,
    theta: Any,
    differences: bool,
) -> OnTape | None:
    """A function at states such as a (K S, na), S rows for each of ``thetas`` (K, n); recorded the first time.

    ``call(t, a)`` calls it at row t of the ``record``, and ``theta`` is a record of the first parameters;
    ``differences`` as :class:`OnTape` has it. None where it must be called.
    """
    kept, dt = _KEPT.setdefault(function, KeptTape()), record.dt
    step = float(dt[0]) if (dt[:-1] == dt[0]).all() else None
    met: list[int] = []
    if kept.has_any(step) and kept.tape is None:
        met = kept.learn_all(function, rows_of(record, a[0], thetas[0]), theta)
        kept.over = kept.tape is None
    if not kept.has_any(step):
        return None
    try:
        lines = kept.lines(thetas, len(a) // len(thetas), step, record)
    except LeftError:
        first = a[0], record.u[0], np.array([record.t[0], dt[0]])
        states, inputs, clock = (np.tile(x, (len(thetas), 1)) for x in first)
        if not kept.learn_all(function, (states, inputs, clock, thetas), theta):
            return None
        return on_tape(function, call, record, a, thetas, theta, differences)
    if lines is None:
        return None
    own = OnTape(kept, function, lines, call, record, thetas, theta, differences)
    # of what the record alone decides each way is looked at
    rows = np.flatnonzero(record.called)[met[1:]].tolist()
    return own if all(own.agrees(t, a) for t in rows) else None
