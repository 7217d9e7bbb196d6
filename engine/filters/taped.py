"""The moment filter of a model whose functions are on tape: all time steps in one call of a kernel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.filters.filter_steps import FilterSteps
from engine.kernels.moments import points_of
from engine.kernels.taped import filter_taped
from engine.statespace.kept_tape import OfRecord
from engine.statespace.model import Array
from engine.statespace.on_tape import SHORTEST, OnTape, on_tape

LEAST = -1e12  # nats of a row: a filter that predicts it worse is lost, even if still finite


@dataclass
class Tapes:
    """Both functions on tape, for a filter of ``series``: what each ``reading`` says, and what a step moves."""

    series: Series
    reading: OnTape
    moving: OnTape

    @property
    def arguments(self) -> tuple[Any, Any, Any]:
        """The first three of the kernels: both tapes, and the record."""
        series, moving = self.series, self.moving
        begins = np.zeros(len(series), dtype=np.bool_)
        begins[list(series.begins)] = True
        record = self.reading.u, moving.u, moving.t, moving.dt, begins
        return self.reading.arguments, moving.arguments, record

    def learn(self) -> bool:
        """Whether one of them was left for another way, and has it now."""
        learned = [function.learns() for function in (self.reading, self.moving)]
        return any(learned)

    def hold(self, done: bool, terms: Array) -> bool:
        """Whether they were gone through to the end (``done``), and are there what calls say.

        Not of filters that are lost by their ``terms`` (T,) or (T, K).
        """
        both, series = (self.reading, self.moving), self.series
        T = len(series)
        if not done:
            for function in both:
                function.note(done)
            return False
        if any(function.lines.raises for function in both) and not np.isfinite(terms).all():
            return False  # of parameters that lose the filter calls tell why
        lost = np.asarray(~(terms.reshape(T, -1) > LEAST).all(axis=0))
        if not (
            self.reading.agrees(T - 1, lost=lost)
            and (T - 1 in series.begins or self.moving.agrees(T - 2, lost=lost))
        ):
            return False
        for function in both:
            function.note(done)
        return True


def filter_by_tape(
    run: FilterSteps,
    visited: tuple[Array, Array] | None,
    moments: Sequence[Array] = (),
    gains: Sequence[Array] = (),
) -> tuple[Array, Array, Array] | None:
    """innovations (T, K, ny), S (T, K, ny, ny) and terms (T, K) of all filters; None where calls are needed.

    ``visited`` as in :func:`engine.filters.sigma_point.run_filter`; ``moments`` and ``gains`` are filled, as
    :func:`engine.kernels.taped.filter_taped` has them.
    """
    model, series = run.model, run.series
    T, K, nx, ny, na = len(series), run.thetas.K, model.nx, model.ny, model.na
    if T < SHORTEST:
        return None
    m, P = run.start_beside()
    rows, beside = points_of(m, P, na)
    tapes = tapes_of(run, rows)
    if tapes is None:
        return None
    found = np.empty((T, K, ny)), np.empty((T, K, ny, ny)), np.empty((T, K))
    nowhere = np.empty((0, 2 * na + 1, na))
    if not moments:
        moments = [np.empty((0, nx)), np.empty((0, nx, nx))] * 2
        gains = np.empty((0, ny, nx)), np.empty((0, nx, ny)), np.empty((0, nx, nx))
    done = filter_taped(
        *tapes.arguments,
        run.start_beside(),
        (rows, beside, m, P),
        series.y,
        found,
        (nowhere, nowhere) if visited is None else visited,
        tuple(moments),
        tuple(gains),
    )
    if not done and tapes.learn():
        return filter_by_tape(run, visited, moments, gains)
    return found if tapes.hold(done, found[2]) else None


def tapes_of(run: FilterSteps, a: Array) -> Tapes | None:
    """What is gone through at states such as a (K S, na); None where calls are needed."""
    reading = reading_on_tape(run, a)
    moving = None if reading is None else moving_on_tape(run, a)
    if reading is None or moving is None:
        return None
    first = a.copy()
    if reading.begins_well(first) and (1 in run.series.begins or moving.begins_well(first)):
        return Tapes(run.series, reading, moving)
    return None


def reading_on_tape(run: FilterSteps, a: Array) -> OnTape | None:
    """The measurement at states such as a (K S, na)."""
    every = np.ones(len(run.series), dtype=np.bool_)
    return _on_tape(run, run.model.observations, FilterSteps.observation, run.series.u, every, a)


def moving_on_tape(run: FilterSteps, a: Array) -> OnTape | None:
    """The dynamics at states such as a (K S, na)."""
    goes_on = np.append(np.ones(len(run.series) - 1, dtype=np.bool_), False)
    goes_on[[row - 1 for row in run.series.begins]] = False
    return _on_tape(
        run, run.model.transitions, FilterSteps.transition, run.series.u_step, goes_on, a
    )


def _on_tape(
    run: FilterSteps, function: Any, call: Any, u: Array, called: NDArray[np.bool_], a: Array
) -> OnTape | None:
    # inputs of one kind, whoever made them: a kernel is compiled for each
    u, t, dt = np.array(u, dtype=float, order="C"), np.array(run.times), np.array([*run.steps, 0.0])
    theta = run.model.record(run.thetas.thetas[0])
    rows, differences = OfRecord(u, t, dt, called), run.model.continuous
    return on_tape(function, partial(call, run), rows, a, run.thetas.thetas, theta, differences)
