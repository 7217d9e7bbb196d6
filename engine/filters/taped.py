"""The moment filter of a model whose functions are on tape: all time steps in one call of a kernel.

At its end, and at its beginning while a tape is new, both functions are called as well and compared: where they
say something else the tape is given up, and the filter goes on by calls.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from engine.filters.filter_steps import FilterSteps
from engine.kernels.moments import sigma_points
from engine.kernels.tape import evaluate, filter_taped
from engine.statespace.evaluation import ModelFunction
from engine.statespace.model import Array
from engine.statespace.tape import LeftError, Lines, Tape, lines_of, record_tape

SHORTEST = 40  # rows of a record, below which recording takes longer than it saves
MOST_LEFT = 2  # times that a tape is left before it was gone through as often
NEW = 3  # passes of a tape, which are looked at from their beginning, too
SAME = 1e-9  # of the largest entry of its kind


@dataclass
class _Kept:
    """The ``tape`` of a function, None where it has none; how often it was gone through, and left."""

    tape: Tape | None
    passes: int = 0
    left: int = 0

    def leave(self) -> None:
        """Take it no more where most records leave it."""
        self.left += 1
        if self.left > max(MOST_LEFT, self.passes):
            self.tape = None


_TAPES: WeakKeyDictionary[ModelFunction, _Kept] = WeakKeyDictionary()


@dataclass
class _Function:
    """A function of a model on tape, for the rows of one filter; its ``call``; inputs and steps of a record."""

    kept: _Kept
    lines: Lines
    call: Callable[[int, Array], tuple[Array, Array, Array]]
    u: Array
    t: Array
    dt: Array
    shapes: tuple[tuple[int, ...], ...]

    @property
    def results(self) -> tuple[Array, ...]:
        """The three results at the last call, in their shapes."""
        pairs = zip(self.lines.results, self.shapes, strict=True)
        return tuple(flat.reshape(len(flat), *shape) for flat, shape in pairs)

    @property
    def arguments(self) -> tuple[Any, ...]:
        """As :func:`engine.kernels.tape.filter_taped` takes it."""
        lines = self.lines
        return lines.codes, lines.links, lines.space, lines.places, lines.results, self.results

    def agrees(self, t: int, a: Array | None = None) -> bool:
        """Whether a call at row t says the same, at states a (K S, na) or the last; else there is no tape."""
        lines = self.lines
        if a is None:
            a = lines.points
        else:
            given = (*self.arguments[:-1], a, self.u[t], float(self.t[t]), float(self.dt[t]))
            if not evaluate(*given):
                return True  # nothing is made of it
        there = np.asarray(np.isfinite(a).all(axis=1))  # nothing is made of what others say
        pairs = zip(self.results, self.call(t, a), strict=True)
        if not all(_same(taped, called, there) for taped, called in pairs):
            self.kept.tape = None
        return self.kept.tape is not None


def _same(taped: Array, called: Array, there: NDArray[np.bool_]) -> bool:
    """Whether results (1 or M, ...) are the same in the rows ``there`` (M,), each entry by its size over all."""
    taped, called = (x[there] if len(x) > 1 else x for x in (taped, called))
    finite = np.isfinite(called)
    sizes = np.abs(np.where(finite, called, 0.0)).max(axis=0, keepdims=True, initial=0.0)
    neither = ~(finite | np.isfinite(taped))
    return bool(np.all((np.abs(taped - called) <= SAME * sizes) | (taped == called) | neither))


@dataclass
class Tapes:
    """Both functions on tape, for one filter ``run``: what happens at each ``reading``, what at each step."""

    run: FilterSteps
    reading: _Function
    moving: _Function

    @property
    def arguments(self) -> tuple[Any, Any, Any]:
        """The first three of the kernels: both tapes, and the record."""
        series, moving = self.run.series, self.moving
        begins = np.zeros(len(series), dtype=np.bool_)
        begins[list(series.begins)] = True
        record = self.reading.u, moving.u, moving.t, moving.dt, begins
        return self.reading.arguments, moving.arguments, record

    def begin(self, a: Array) -> bool:
        """Whether they are what calls say at the first row, at states a (K S, na); well known ones are."""
        reading, moving = self.reading, self.moving
        return min(reading.kept.passes, moving.kept.passes) >= NEW or (
            reading.agrees(0, a) and (1 in self.run.series.begins or moving.agrees(0, a))
        )

    def hold(self, done: bool, terms: Array) -> bool:
        """Whether they were gone through to the end (``done``), and are there what calls say."""
        both, series = (self.reading, self.moving), self.run.series
        T = len(series)
        if not done:
            for function in both:
                function.kept.leave()
            return False
        if any(function.lines.raises for function in both) and not np.isfinite(terms).all():
            return False  # of parameters that lose the filter calls tell why
        if not (
            self.reading.agrees(T - 1) and (T - 1 in series.begins or self.moving.agrees(T - 2))
        ):
            return False
        for function in both:
            function.kept.passes += 1
        return True


def filter_by_tape(
    run: FilterSteps,
    visited: tuple[Array, Array] | None,
    moments: Sequence[Array] = (),
    gains: Sequence[Array] = (),
) -> tuple[Array, Array, Array] | None:
    """innovations (T, K, ny), S (T, K, ny, ny) and terms (T, K) of all filters; None where calls are needed.

    ``visited`` as in :func:`engine.filters.sigma_point.run_filter`; ``moments`` and ``gains`` are filled, as
    :func:`engine.kernels.tape.filter_taped` has them.
    """
    model, series = run.model, run.series
    T, K, nx, ny, na = len(series), run.thetas.K, model.nx, model.ny, model.na
    if T < SHORTEST:
        return None
    m, P = run.start()
    a, z, V, offsets = sigma_points(m, P, na)
    tapes = on_tape(run, a.reshape(K * a.shape[1], na))
    if tapes is None:
        return None
    found = np.empty((T, K, ny)), np.empty((T, K, ny, ny)), np.empty((T, K))
    nowhere = np.empty((0, a.shape[1], na))
    if not moments:
        moments = [np.empty((0, nx)), np.empty((0, nx, nx))] * 2
        gains = np.empty((0, ny, nx)), np.empty((0, nx, ny)), np.empty((0, nx, nx))
    done = filter_taped(
        *tapes.arguments,
        run.start(),
        (a, z, V, offsets, m, P),
        series.y,
        found,
        (nowhere, nowhere) if visited is None else visited,
        tuple(moments),
        tuple(gains),
    )
    return found if tapes.hold(done, found[2]) else None


def on_tape(run: FilterSteps, a: Array) -> Tapes | None:
    """What is gone through at states such as a (K S, na); recorded at the first of them, the first time."""
    model, series = run.model, run.series
    nx, ny, nz = model.nx, model.ny, model.nz
    times, steps = np.array(run.times), np.array([*run.steps, 0.0])
    even = bool((steps[:-1] == steps[0]).all())
    record = model.record(run.thetas.thetas[0])
    found = []
    for function, call, u, shapes in (
        (model.observations, FilterSteps.observation, series.u, ((ny,), (ny, nz), (ny, ny))),
        (model.transitions, FilterSteps.transition, series.u_step, ((nx,), (nx, nz), (nx, nx))),
    ):
        u = np.ascontiguousarray(u, dtype=float)
        if function not in _TAPES:
            _TAPES[function] = _Kept(
                record_tape(function, a[0], u[0], run.times[0], run.steps[0], record)
            )
        kept = _TAPES[function]
        if kept.tape is None:
            return None
        copies, step = len(a) // run.thetas.K, run.steps[0] if even else None
        try:
            lines = lines_of(kept.tape, run.thetas.thetas, copies, step)
        except LeftError:
            return None
        if lines is None:
            kept.tape = None
            return None
        found.append(_Function(kept, lines, partial(call, run), u, times, steps, shapes))
    tapes = Tapes(run, *found)
    return tapes if tapes.begin(a.copy()) else None
