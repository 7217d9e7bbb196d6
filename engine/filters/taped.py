"""The moment filter of a model whose functions are on tape: all time steps in one call of a kernel.

At its end, and at its beginning while a tape is new, both functions are called as well and compared: where they
say something else the tape is given up, and the filter goes on by calls.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

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
        pairs = zip(self.results, self.call(t, a), strict=True)
        if not all(_same(taped, called) for taped, called in pairs):
            self.kept.tape = None
        return self.kept.tape is not None


def _same(taped: Array, called: Array) -> bool:
    """Whether results (1 or M, ...) are the same, each entry by its size over all rows."""
    apart = np.abs(taped - called)
    sizes = np.abs(called).max(axis=0, keepdims=True, initial=0.0)
    neither = ~(np.isfinite(called) | np.isfinite(taped))
    return bool(np.all((apart <= SAME * sizes) | (taped == called) | neither))


def filter_by_tape(
    run: FilterSteps, visited: tuple[Array, Array] | None
) -> tuple[Array, Array, Array] | None:
    """innovations (T, K, ny), S (T, K, ny, ny) and terms (T, K) of all filters; None where calls are needed.

    ``visited`` as in :func:`engine.filters.sigma_point.run_filter`.
    """
    model, series = run.model, run.series
    T, K, ny, na = len(series), run.thetas.K, model.ny, model.na
    if T < SHORTEST:
        return None
    m, P = run.start()
    a, z, V, offsets = sigma_points(m, P, na)
    both = _on_tape(run, a[0, 0], a.shape[1])
    if both is None:
        return None
    reading, moving = both
    first = np.array(a.reshape(K * a.shape[1], na))
    if min(reading.kept.passes, moving.kept.passes) < NEW and not (
        reading.agrees(0, first) and (1 in series.begins or moving.agrees(0, first))
    ):
        return None
    innovations, S, terms = np.empty((T, K, ny)), np.empty((T, K, ny, ny)), np.empty((T, K))
    begins = np.zeros(T, dtype=np.bool_)
    begins[list(series.begins)] = True
    nowhere = np.empty((0, a.shape[1], na))
    done = filter_taped(
        reading.arguments,
        moving.arguments,
        reading.u,
        moving.u,
        moving.t,
        moving.dt,
        begins,
        run.start(),
        (a, z, V, offsets, m, P),
        series.y,
        (innovations, S, terms),
        (nowhere, nowhere) if visited is None else visited,
    )
    raises = any(function.lines.raises for function in both)
    if not done:
        for function in both:
            function.kept.leave()
        return None
    if raises and not np.isfinite(terms).all():
        return None  # of parameters that lose the filter calls tell why
    if not (reading.agrees(T - 1) and (T - 1 in series.begins or moving.agrees(T - 2))):
        return None
    for function in both:
        function.kept.passes += 1
    return innovations, S, terms


def _on_tape(run: FilterSteps, a: Array, copies: int) -> tuple[_Function, _Function] | None:
    """What is gone through at each reading and at each step; recorded at states a (na,), the first time."""
    model, series = run.model, run.series
    nx, ny, nz = model.nx, model.ny, model.nz
    times, steps = np.array(run.times), np.array([*run.steps, 0.0])
    even = bool((steps[:-1] == steps[0]).all())
    record = model.record(run.thetas.thetas[0])
    found = []
    for function, call, u, shapes in (
        (model.observations, run.observation, series.u, ((ny,), (ny, nz), (ny, ny))),
        (model.transitions, run.transition, series.u_step, ((nx,), (nx, nz), (nx, nx))),
    ):
        u = np.ascontiguousarray(u, dtype=float)
        if function not in _TAPES:
            _TAPES[function] = _Kept(
                record_tape(function, a, u[0], run.times[0], run.steps[0], record)
            )
        kept = _TAPES[function]
        if kept.tape is None:
            return None
        try:
            lines = lines_of(kept.tape, run.thetas.thetas, copies, run.steps[0] if even else None)
        except LeftError:
            return None
        if lines is None:
            kept.tape = None
            return None
        found.append(_Function(kept, lines, call, u, times, steps, shapes))
    return found[0], found[1]
