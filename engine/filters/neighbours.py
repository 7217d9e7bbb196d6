"""The moment filter at parameters next to each other, for models that take one parameter vector a call.

Derivatives by theta need the filter at theta and at both sides of it in every parameter, K parameter vectors
of which all but the first are a ten-thousandth apart. A model that does not take arrays of parameters would be
called K times at every time step. If it takes many times at once, it is called at every step for the first
vector only, and once for each of the others at all points which that filter visited; from there to the points
of the others, a ten-thousandth away, it is followed by its slopes. What is neglected is of second order in
this distance and the same on both sides, so that it drops out of central differences.

A model without nonlinear states needs no slopes: it is evaluated for each vector on the whole record, which
takes a few calls where it is affine in the inputs (:mod:`engine.statespace.affine`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.filters.sigma_point import (
    FilterSteps,
    MomentFiltered,
    Thetas,
    moment_filter,
    run_filter,
    usable,
)
from engine.kernels.moments import filter_near
from engine.statespace.model import Array, MixedModel
from engine.statespace.points import Points
from engine.statespace.refutation import repeated_if_refuted

NUMBERS = 4_000_000  # in the arrays of one block of rows, at most
STEP = 1e-4  # of the spread of a component of a, over which slopes by it are taken
NEAR = 0.1  # of that spread: further from the visited points the slopes are not to be trusted
LEAST_SPREAD = 1e-2  # of the way a component goes
FEW = 3  # parameter vectors that are not worth it
ROWS = 4  # on which it is asked what the model takes


@repeated_if_refuted
@np.errstate(all="ignore")
def filter_neighbours(model: MixedModel, thetas: Array, series: Series) -> MomentFiltered:
    """:func:`moment_filter` at ``thetas`` (K, n_theta), which are all next to the first."""
    run = FilterSteps(model, Thetas(model, thetas), series)
    if not _worth_it(run):
        return moment_filter(model, thetas, series)
    found = followed(run)
    return moment_filter(model, thetas, series) if found is None else found


def _worth_it(run: FilterSteps) -> bool:
    """Whether the model takes many times a call, or needs no slopes, but takes one parameter vector only."""
    model, series, K = run.model, run.series, run.thetas.K
    rows = np.arange(min(len(series) - 1, ROWS))
    if K <= FEW or len(rows) < ROWS:
        return False
    m, _ = run.start()
    a = np.ascontiguousarray(m[:, : model.na])
    points = Points(model, series, np.repeat(a[None, :1], len(series), axis=0))
    together, alone = run.thetas.record(1), model.record(run.thetas.thetas[0])
    times, vectors = True, True
    for function, transition in ((model.transitions, True), (model.observations, False)):
        first, u, t, dt = points.arguments(rows, transition)
        times &= function.takes(first, u, t, dt, alone)
        u_0 = (series.u_step if transition else series.u)[0]
        dt_0 = run.steps[0] if transition else 0.0
        vectors &= function.takes(a, u_0, run.times[0], dt_0, together)
    return (times or model.na == 0) and not vectors


def followed(run: FilterSteps) -> MomentFiltered | None:
    """All filters near the points of the first; None where one of them leaves their neighbourhood."""
    model, series, thetas = run.model, run.series, run.thetas.thetas
    T, K, ny, na = len(series), run.thetas.K, model.ny, model.na
    n_points = 2 * na + 1
    seen, moved = np.empty((T, n_points, na)), np.empty((T, n_points, na))
    base = run_filter(FilterSteps(model, Thetas(model, thetas[:1]), series), (seen, moved))
    if not np.isfinite(base.log_terms).all():
        return None
    spread = _spread(seen)
    innovations, S, terms = np.empty((T, K, ny)), np.empty((T, K, ny, ny)), np.empty((T, K))
    m, P = run.start()
    records = [model.record(theta) for theta in thetas]
    known = _Known(Points(model, series, seen), records, spread, False)
    ahead = _Known(Points(model, series, moved), records, spread, True)
    size = K * n_points * model.nx * max(model.nx, ny, 1)
    length = max(NUMBERS // size, 1)
    for first in range(0, T, length):
        last = min(first + length, T)
        now = known.at(np.arange(first, last))
        then = ahead.at(np.arange(first, min(last, T - 1)))
        farthest = filter_near(first, last, series.y, now, then, m, P, innovations, S, terms)
        if not (farthest <= NEAR * spread).all():
            return None
    return MomentFiltered(innovations, S, usable(terms, innovations, S, series))


def _spread(points: Array) -> Array:
    """How far the points (T, S, na) reach from their centre, usually, but at least a share of all they do."""
    if points.shape[2] == 0:
        return np.zeros(0)
    each = np.abs(points - points[:, :1]).max(axis=1)
    usual, ways = np.median(each, axis=0), np.ptp(points[:, 0], axis=0)
    sizes = np.abs(points).max(axis=(0, 1))
    whole = np.where(ways > 0.0, ways, np.where(sizes > 0.0, sizes, 1.0))
    return np.asarray(np.maximum(usual, LEAST_SPREAD * whole))


class _Known:
    """What a model returns at points (T, S, na) for each of K records, and its slopes by a for the first."""

    def __init__(self, points: Points, records: list[Any], spread: Array, transition: bool) -> None:
        self.points, self.records, self.spread = points, records, spread
        self.transition = transition

    def at(self, rows: NDArray[np.intp]) -> tuple[Array, ...]:
        """Points, values and slopes at some rows, as :func:`filter_near` wants them."""
        points, S, na = self.points, self.points.N, self.points.a.shape[2]
        each = [points.at(rows, record, self.transition) for record in self.records]
        values = [_stacked([one[i] for one in each], len(rows), S) for i in range(3)]
        slopes = [self._slopes(rows, j) for j in range(na)]
        by_a = [
            np.ascontiguousarray(np.stack([one[i] for one in slopes], axis=2))
            if na
            else np.zeros((len(rows), S, 0, *values[i].shape[2:]))
            for i in range(3)
        ]
        return (np.ascontiguousarray(points.a[rows]), *values, *by_a)

    def _slopes(self, rows: NDArray[np.intp], j: int) -> list[Array]:
        points, step = self.points, np.zeros(len(self.spread))
        step[j] = STEP * self.spread[j]
        low, high = (
            Points(points.model, points.series, points.a + sign * step).at(
                rows, self.records[0], self.transition
            )
            for sign in (-1.0, 1.0)
        )
        return [
            _stacked([(y - x) / (2.0 * step[j])], len(rows), points.N)
            for x, y in zip(low, high, strict=True)
        ]


def _stacked(each: list[Array], n: int, S: int) -> Array:
    """K arrays (n or 1, S or 1, ...) as one of (n, K S, ...)."""
    full = [np.broadcast_to(one, (n, S, *one.shape[2:])) for one in each]
    return np.ascontiguousarray(np.concatenate(full, axis=1))
