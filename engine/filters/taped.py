"""The moment filter of a model whose functions are on tape: all time steps in one call of a kernel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from engine.filters.filter_steps import FilterSteps
from engine.kernels.moments import sigma_points
from engine.kernels.taped import filter_taped
from engine.statespace.model import Array
from engine.statespace.on_tape import SHORTEST, OnTape, on_tape


@dataclass
class Tapes:
    """Both functions on tape, for one filter ``run``: what happens at each ``reading``, what at each step."""

    run: FilterSteps
    reading: OnTape
    moving: OnTape

    @property
    def arguments(self) -> tuple[Any, Any, Any]:
        """The first three of the kernels: both tapes, and the record."""
        series, moving = self.run.series, self.moving
        begins = np.zeros(len(series), dtype=np.bool_)
        begins[list(series.begins)] = True
        record = self.reading.u, moving.u, moving.t, moving.dt, begins
        return self.reading.arguments, moving.arguments, record

    def hold(self, done: bool, terms: Array) -> bool:
        """Whether they were gone through to the end (``done``), and are there what calls say."""
        both, series = (self.reading, self.moving), self.run.series
        T = len(series)
        if not done:
            for function in both:
                function.note(done)
            return False
        if any(function.lines.raises for function in both) and not np.isfinite(terms).all():
            return False  # of parameters that lose the filter calls tell why
        if not (
            self.reading.agrees(T - 1) and (T - 1 in series.begins or self.moving.agrees(T - 2))
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
    m, P = run.start()
    a, z, V, offsets = sigma_points(m, P, na)
    tapes = tapes_of(run, a.reshape(K * a.shape[1], na))
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


def tapes_of(run: FilterSteps, a: Array) -> Tapes | None:
    """What is gone through at states such as a (K S, na); None where calls are needed."""
    model, series = run.model, run.series
    times, steps = np.array(run.times), np.array([*run.steps, 0.0])
    record, thetas = model.record(run.thetas.thetas[0]), run.thetas.thetas
    found = []
    for function, call, u in (
        (model.observations, FilterSteps.observation, series.u),
        (model.transitions, FilterSteps.transition, series.u_step),
    ):
        inputs = np.ascontiguousarray(u, dtype=float)
        rows = inputs, times, steps
        one = on_tape(function, partial(call, run), rows, a, thetas, record)
        if one is None:
            return None
        found.append(one)
    reading, moving = found
    first = a.copy()
    if reading.begins_well(first) and (1 in series.begins or moving.begins_well(first)):
        return Tapes(run, reading, moving)
    return None
