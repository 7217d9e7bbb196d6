"""A model's functions on tape, for what goes through a whole record: filters and free runs.

At the end of each pass, and at its beginning while a tape is new, the function is called as well and compared:
where it says something else its tape is given up, and the work is done by calls.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from engine.kernels.tape import evaluate
from engine.statespace.evaluation import ModelFunction
from engine.statespace.rows import Array
from engine.statespace.tape import LeftError, Lines, Tape, lines_of, record_tape

SHORTEST = 40  # rows of a record, below which recording takes longer than it saves
WAYS = 4  # through a function, by what its parameters are
MOST_LEFT = 2  # times that a tape is left before it was gone through as often
NEW = 3  # passes of a tape, which are looked at from their beginning, too
SAME = 1e-9  # of the largest entry of its kind
SLOPES = 1e-7  # of it, where slopes may be differences
AT_REST = 1e-3  # of it, where these may be beside states at rest


@dataclass
class _Kept:
    """The ``tapes`` of a function, one for each way that its parameters take through it.

    So many ``ways`` were recorded; how often they were gone through, and left. From so many passes on they are
    ``known``. It is called where ``over``, and at uneven steps where it is ``even_only``.
    """

    tapes: list[Tape] = field(default_factory=list)
    ways: int = 0
    over: bool = False
    even_only: bool = False
    passes: int = 0
    known: int = 0
    left: int = 0

    def has_any(self, dt: float | None) -> bool:
        """Whether there may be a tape for steps of ``dt``, or for uneven ones."""
        return not (self.over or (dt is None and self.even_only))

    def lines(
        self, thetas: Array, copies: int, dt: float | None, record: tuple[Array, Array, Array]
    ) -> Lines | None:
        """The lines of the tape whose way these parameters take, None where there is none."""
        for tape in self.tapes:
            try:
                found = lines_of(tape, thetas, copies, dt, record)
            except LeftError:
                continue
            if found is None:  # something that no kernel does
                self.even_only, self.over = True, dt is not None
            return found
        return None


_KEPT: WeakKeyDictionary[ModelFunction, _Kept] = WeakKeyDictionary()


@dataclass
class OnTape:
    """A model's function on tape, for some rows; its ``call``, and inputs, times and steps of a record.

    ``moves``: it is the dynamics, whose first result are the states of the next row. ``differences``: a call
    may take its slopes by the states from differences, as a step of differential equations does.
    """

    kept: _Kept
    lines: Lines
    call: Callable[[int, Array], tuple[Array, Array, Array]]
    u: Array
    t: Array
    dt: Array
    shapes: Sequence[tuple[int, ...]]
    moves: bool
    differences: bool

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


def on_tape(
    function: ModelFunction,
    call: Callable[[int, Array], tuple[Array, Array, Array]],
    record: tuple[Array, Array, Array],
    a: Array,
    thetas: Array,
    theta: Any,
    differences: bool,
) -> OnTape | None:
    """A function at states such as a (K S, na), S rows for each of ``thetas`` (K, n); recorded the first time.

    ``record`` are its inputs (T, nu), the times (T,) and steps (T,) of a series, the last of no meaning;
    ``call(t, a)`` calls it at row t, and ``theta`` is a record of the first parameters; ``differences`` as
    :class:`OnTape` has it. None where it must be called.
    """
    u, t, dt = record
    kept, copies = _KEPT.setdefault(function, _Kept()), len(a) // len(thetas)
    first = u[0], float(t[0]), float(dt[0])
    step = first[2] if (dt[:-1] == dt[0]).all() else None
    lines = kept.lines(thetas, copies, step, record) if kept.has_any(step) else None
    if lines is None and kept.has_any(step) and kept.ways < WAYS:
        kept.ways += 1
        tape = record_tape(function, a[0], *first, theta)
        if tape is None:
            kept.over = not kept.tapes
        else:
            kept.tapes.append(tape)
            kept.known = kept.passes + NEW
            lines = kept.lines(thetas, copies, step, record)
    if lines is None:
        return None
    if lines.columns.size:
        u = np.array(np.concatenate([u, lines.columns], axis=1), order="C")
    moves = function.name == "dynamics"
    return OnTape(kept, lines, call, u, t, dt, function.shapes, moves, differences and moves)
