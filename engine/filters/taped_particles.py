"""The RBPF of a model whose functions are on tape: all time steps after the first reading in one call."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from engine.data.series import Series
from engine.filters.filter_steps import FilterSteps, Thetas
from engine.filters.proposals import DEFENSIVE, INFLATION, Proposal, adapted, bootstrap
from engine.filters.taped import reading_on_tape, tapes_of
from engine.kernels.taped_particles import SCHEMES, filter_particles_taped
from engine.statespace.model import Array, MixedModel
from engine.statespace.on_tape import SHORTEST


def rows_by_tape(
    model: MixedModel,
    theta: Array,
    series: Series,
    first: Sequence[Any],
    draw: Proposal,
    resampling: str,
    ess_threshold: float,
    rng: np.random.Generator,
) -> tuple[Sequence[Any], Sequence[Any]] | None:
    """The fields of all rows (T, ...) and of all predictions (T - 1, ...); None where calls are needed.

    ``first`` are the fields of the first row, as :func:`engine.filters.rbpf.rbpf` has them. Where None is
    returned ``rng`` is as it was.
    """
    T = len(series)
    own_draw = draw not in (adapted, bootstrap) or (draw is adapted and model.random_scales)
    if T < SHORTEST or model.na == 0 or own_draw:
        return None
    a, z, Z, w, log_w, _, ess, _ = first
    a = np.array(a, order="C")  # however it was drawn: a kernel is compiled for each layout
    run = FilterSteps(model, Thetas(model, theta), series)
    tapes = tapes_of(run, a)
    spread = None if tapes is None else tapes.reading
    if draw is adapted:
        spread = reading_on_tape(run, np.tile(a, (1 + 2 * model.na, 1)))
    if tapes is None or spread is None:
        return None
    M, nx, nz = len(a), model.nx, model.nz
    matrices = Z, *tapes.reading.results[1:], *tapes.moving.results[1:]
    each = max(map(len, matrices))  # 1 where all are common to all particles
    updated = [np.empty((T, *x.shape)) for x in (a, z, np.empty((each, nz, nz)), w, log_w)]
    updated += [np.empty(T), np.empty(T), np.empty((T, M), dtype=np.int64)]
    for rows, value in zip(updated, first, strict=True):
        rows[0] = value
    shapes = (M, nx), (each, nx, nx), (each, nz, nx), (each, nz, nz)
    predicted = [np.empty((T - 1, *shape)) for shape in shapes]
    nowhere = np.zeros((1, nx)), np.zeros((1, nx, nx))
    mean, cov = run.start() if series.begins else nowhere
    options = float(ess_threshold), SCHEMES.index(resampling), draw is adapted, DEFENSIVE, INFLATION
    before = rng.bit_generator.state
    reading, moving, record = tapes.arguments
    done = filter_particles_taped(
        reading,
        spread.arguments,
        moving,
        record,
        (np.repeat(mean, M, axis=0), cov),
        np.array(series.y, order="C"),
        (a, z, Z, w, log_w, ess),
        options,
        rng,
        tuple(map(_flat, updated)),
        tuple(map(_flat, predicted)),
    )
    if done and tapes.hold(done, updated[5]):
        return updated, predicted
    rng.bit_generator.state = before
    if not done and (tapes.learn() or spread.learns()):
        return rows_by_tape(model, theta, series, first, draw, resampling, ess_threshold, rng)
    if not done:
        tapes.hold(done, updated[5])
    return None


def _flat(rows: Array) -> Array:
    """Rows (T, ...) as (T, .), in the same memory."""
    return rows.reshape(len(rows), math.prod(rows.shape[1:]))
