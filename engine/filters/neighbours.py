"""The moment filter at parameters next to each other: of whole records instead of step by step.

Derivatives by theta need the filter at theta and at both sides of it in every parameter, K parameter vectors
of which all but the first are a ten-thousandth apart. A model that takes many times in one call is
evaluated once for each of them at all points that the filter of the first visited, and the filters run through
what it returned; from there to their own points, a ten-thousandth away, it is followed by its slopes. What is
neglected is of second order in this distance and the same on both sides, so that it drops out of central
differences.

Where the filter was run before at another theta, its points there are the start of Newton's method for those at
this one: evaluate the model at all of them, run the filter through values and slopes, and go on from the points
that it visits until they stay. That is the filter itself, without a call at every time.

A model without nonlinear states has no points: it is evaluated on the whole record for any theta, which
takes a few calls where it is affine in the inputs (:mod:`engine.statespace.affine`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.errors import ModelError
from engine.filters.filter_steps import FilterSteps, Thetas, first_moments
from engine.filters.sigma_point import (
    MomentFiltered,
    MomentPath,
    moment_filter,
    run_filter,
    run_on_tape,
    usable,
)
from engine.kernels.moments import sigma_points
from engine.kernels.near import filter_near
from engine.statespace.model import Array, MixedModel
from engine.statespace.points import Points
from engine.statespace.refutation import repeated_if_refuted

NUMBERS = 4_000_000  # in the arrays of one block of rows, at most
STEP = 1e-4  # of the spread of a component of a, over which slopes by it are taken
NEAR = 0.1  # of that spread: further from the visited points the slopes are not to be trusted
LEAST_SPREAD = 1e-2  # of the way a component goes
FEW = 3  # parameter vectors that are not worth it
EACH = 4  # parameter vectors that are worth a filter of their own where a call takes all
ROWS = 4  # on which it is asked what the model takes
FAR = 8.0  # of the spread: from points farther away Newton's method is not tried ...
SETTLED = 1e-5  # ... and so near it has arrived
ROUNDS = 6  # of it
STATES = 2  # nonlinear ones, beyond which slopes by each cost more than calls at every time


@dataclass(eq=False)
class Visited:
    """The points (T, S, na) of y_t and of x_{t+1} at which a filter looked at its model; none at first.

    A search that moves theta step by step hands them on from each to the next.
    """

    seen: Array | None = None
    moved: Array | None = None

    def copy(self) -> Visited:
        """The same, to be brought up to date on its own."""
        return Visited(self.seen, self.moved)

    def part(self, n: int) -> Visited:
        """Of the first n times."""
        if self.seen is None or self.moved is None:
            return Visited()
        return Visited(self.seen[:n], self.moved[:n])


def visited_on(path: MomentPath, na: int) -> Visited:
    """The points of the filter that went this way."""
    seen = sigma_points(path.predicted, path.P_predicted, na)[0]
    return Visited(seen, sigma_points(path.filtered, path.P_filtered, na)[0])


@repeated_if_refuted
@np.errstate(all="ignore")
def filter_neighbours(
    model: MixedModel, thetas: Array, series: Series, visited: Visited | None = None
) -> MomentFiltered:
    """:func:`moment_filter` at ``thetas`` (K, n_theta), which are all next to the first.

    ``visited``, by a filter of this model and series at another theta, is brought up to date; but where the
    functions are on tape, whose filters need none.
    """
    if model.random_scales:
        return moment_filter(model, thetas, series)
    run = FilterSteps(model, Thetas(model, thetas), series)
    if model.na and (taped := run_on_tape(run)) is not None:
        return taped
    if not _worth_it(run, visited):
        return moment_filter(model, thetas, series)
    found = followed(run, visited)
    return moment_filter(model, thetas, series) if found is None else found


@repeated_if_refuted
@np.errstate(all="ignore")
def filter_all(
    model: MixedModel, thetas: Array, series: Series, visited: Visited | None = None
) -> MomentFiltered:
    """:func:`moment_filter` at any ``thetas`` (K, n_theta), of whole records where there are no points.

    And from the points ``visited`` at another theta, where the model takes one parameter vector a call, or
    there are few.
    """
    if model.random_scales:
        return moment_filter(model, thetas, series)
    run = FilterSteps(model, Thetas(model, thetas), series)
    if model.na == 0:
        found = followed(run)
        return moment_filter(model, thetas, series) if found is None else found
    if (taped := run_on_tape(run)) is not None:
        return taped
    if visited is not None and visited.seen is not None:
        times, vectors = _takes(run)
        if times and (not vectors or (run.thetas.K <= EACH and model.na <= STATES)):
            return _each(run, visited)
    return moment_filter(model, thetas, series)


def _each(run: FilterSteps, visited: Visited) -> MomentFiltered:
    """Each filter by Newton's method from the points visited, those that do not get there step by step."""
    model, thetas, series = run.model, run.thetas.thetas, run.series
    found: list[MomentFiltered | None] = []
    for theta in thetas:
        try:
            settled = _settled(FilterSteps(model, Thetas(model, theta), series), visited)
        except ModelError as error:
            if not error.numeric:
                raise
            return moment_filter(model, thetas, series)  # which leaves such a theta out
        found.append(None if settled is None else settled[0])
    left = [k for k, one in enumerate(found) if one is None]
    if len(left) == len(thetas):
        return moment_filter(model, thetas, series)
    if left:
        rest = moment_filter(model, thetas[left], series)
        for i, k in enumerate(left):
            found[k] = rest.of(np.array([i]))
    every = [one for one in found if one is not None]
    return MomentFiltered(
        np.concatenate([one.innovations for one in every], axis=1),
        np.concatenate([one.S for one in every], axis=1),
        np.concatenate([one.log_terms for one in every], axis=1),
    )


def _worth_it(run: FilterSteps, visited: Visited | None) -> bool:
    """Whether the model takes many times a call, and few parameter vectors, or is filtered again."""
    model, series, K = run.model, run.series, run.thetas.K
    if model.na == 0:
        return True
    again, known = visited is not None, visited is not None and visited.seen is not None
    if len(series) <= ROWS or (K <= FEW and not known):
        return False
    times, vectors = _takes(run)
    return times and (not vectors or (again and model.na <= STATES))


def _takes(run: FilterSteps) -> tuple[bool, bool]:
    """Whether the model takes many times a call, and many parameter vectors."""
    model, series, K = run.model, run.series, run.thetas.K
    rows = np.arange(min(len(series) - 1, ROWS))
    m, _ = first_moments(model, run.thetas.thetas[0])
    a = np.repeat(m[None, : model.na], K, axis=0)
    points = Points(model, series, np.repeat(a[None, :1], len(series), axis=0))
    together, alone = run.thetas.record(1), model.record(run.thetas.thetas[0])
    times, vectors = True, True
    for function, transition in ((model.transitions, True), (model.observations, False)):
        first, u, t, dt = points.arguments(rows, transition)
        times &= function.takes(first, u, t, dt, alone)
        u_0 = (series.u_step if transition else series.u)[0]
        dt_0 = run.steps[0] if transition else 0.0
        vectors &= function.takes(a, u_0, run.times[0], dt_0, together)
    return times, vectors


def followed(run: FilterSteps, visited: Visited | None = None) -> MomentFiltered | None:
    """All filters near the points of the first; None where one of them leaves their neighbourhood."""
    points = _points(run, Visited() if visited is None else visited)
    if points is None:
        return None
    seen, moved = (np.tile(each, (1, run.thetas.K, 1)) for each in points)
    spread = _spread(points[0])
    for _ in range(ROUNDS):
        near = _Near(run, seen, moved, spread)
        found, farthest = near.filtered()
        if (farthest <= NEAR * spread).all():
            return found
        if not (farthest <= FAR * spread).all():
            return None
        seen, moved = near.visited
    return None


def _points(run: FilterSteps, visited: Visited) -> tuple[Array, Array] | None:
    """The points of the first filter; None where it is lost."""
    model, series = run.model, run.series
    shape = (len(series), 2 * model.na + 1, model.na)
    if model.na == 0:
        return np.empty(shape), np.empty(shape)
    first = FilterSteps(model, Thetas(model, run.thetas.thetas[:1]), series)
    settled = _settled(first, visited)
    if settled is not None:
        points = settled[1]
    else:
        points = np.empty(shape), np.empty(shape)
        if not np.isfinite(run_filter(first, points).log_terms).all():
            return None
        points[1][-1] = points[0][-1]  # nothing is predicted from the last row
    visited.seen, visited.moved = points
    return points


def _settled(
    run: FilterSteps, visited: Visited
) -> tuple[MomentFiltered, tuple[Array, Array]] | None:
    """A filter and its points by Newton's method from those visited; None where it does not get there."""
    seen, moved = visited.seen, visited.moved
    if seen is None or moved is None:
        return None
    for _ in range(ROUNDS):
        spread = _spread(seen)
        near = _Near(run, seen, moved, spread)
        found, farthest = near.filtered()
        if not np.isfinite(found.log_terms).all() or not (farthest <= FAR * spread).all():
            return None
        seen, moved = near.visited
        if (farthest <= SETTLED * spread).all():
            return found, (seen, moved)
    return None


class _Near:
    """K filters through a model that is known near points (T, K S, na) of y_t and of x_{t+1}."""

    def __init__(self, run: FilterSteps, seen: Array, moved: Array, spread: Array) -> None:
        self.run = run
        records = [run.model.record(theta) for theta in run.thetas.thetas]
        self.known = [
            _Known(run, points, records, spread, transition)
            for points, transition in ((seen, False), (moved, True))
        ]
        self.visited = np.array(seen), np.array(moved)  # the points after ``filtered``

    def filtered(self) -> tuple[MomentFiltered, Array]:
        """The filters, and how far their points were, at most, from those the model is known at (na,)."""
        run, model, series = self.run, self.run.model, self.run.series
        T, K, ny, S = len(series), run.thetas.K, model.ny, 2 * model.na + 1
        innovations, covs, terms = np.empty((T, K, ny)), np.empty((T, K, ny, ny)), np.empty((T, K))
        m, P = run.start()
        length = max(NUMBERS // (K * S * model.nx * max(model.nx, ny, 1)), 1)
        farthest = np.zeros(model.na)
        for first in range(0, T, length):
            last = min(first + length, T)
            now = self.known[0].at(np.arange(first, last))
            then = self.known[1].at(np.arange(first, min(last, T - 1)))
            far = filter_near(first, last, series.y, now, then, m, P, innovations, covs, terms)
            farthest = np.maximum(farthest, far)
            for points, part in zip(self.visited, (now, then), strict=True):
                points[first : first + len(part[0])] = part[0]
        return MomentFiltered(innovations, covs, usable(terms, innovations, covs, series)), farthest


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
    """What a model returns for each of K records at its points (T, K S, na), and slopes by a for the first.

    NaN for a record but the first with which a calculation fails.
    """

    def __init__(
        self, run: FilterSteps, a: Array, records: list[Any], spread: Array, transition: bool
    ) -> None:
        self.a, self.records, self.transition = a, records, transition
        self.S, self.steps = a.shape[1] // len(records), STEP * spread
        first, *others = np.split(a, len(records), axis=1)
        # beside the points those to either side of them in each component, all in one call
        sides = [first + sign * step for step in np.diag(self.steps) for sign in (-1.0, 1.0)]
        first = np.concatenate([first, *sides], axis=1)
        self.each = [Points(run.model, run.series, own) for own in (first, *others)]

    def at(self, rows: NDArray[np.intp]) -> tuple[Array, ...]:
        """Points, values and slopes at some rows, as :func:`filter_near` wants them."""
        pairs = zip(self.each, self.records, strict=True)
        each: list[tuple[Array, ...]] = []
        for points, record in pairs:
            try:
                each.append(points.at(rows, record, self.transition))
            except ModelError as error:
                if not (each and error.numeric):
                    raise
                each.append(tuple(np.full_like(own[:, : self.S], np.nan) for own in each[0]))
        (f, slopes), *matrices = (self._split(part) for part in each[0])
        return (
            self.a[rows],
            np.concatenate([f, *(one[0] for one in each[1:])], axis=1),
            *(
                _compact([own, *(one[i] for one in each[1:])])
                for i, (own, _) in enumerate(matrices, 1)
            ),
            slopes,
            *(_none_if_zero(by_a) for _, by_a in matrices),
        )

    def _split(self, values: Array) -> tuple[Array, Array]:
        """At the first record's points (n, S, ...), and slopes by a (n, S, na, ...); S is 1 where common."""
        n, na, shape = len(values), len(self.steps), values.shape[2:]
        if values.shape[1] == 1 < self.S * (1 + 2 * na):
            return values, np.zeros((n, 1, na, *shape))
        sides = values[:, self.S :].reshape(n, na, 2, self.S, *shape)
        width = (2.0 * self.steps).reshape(na, *[1] * (1 + len(shape)))
        slopes = (sides[:, :, 1] - sides[:, :, 0]) / width
        return values[:, : self.S], np.ascontiguousarray(np.swapaxes(slopes, 1, 2))


def _compact(each: Sequence[Array]) -> Array:
    """K matrices (n or 1, S or 1, ., .) as one of (n or 1, 1 or K or K S, ., .), no larger than it must be."""
    first = each[0]
    alike = all(one.shape == first.shape and (one == first).all() for one in each[1:])
    if alike and (first.shape[1] == 1 or len(each) == 1):
        return np.ascontiguousarray(first)
    times = max(one.shape[0] for one in each)
    points = max(one.shape[1] for one in each)
    return np.concatenate(
        [np.broadcast_to(one, (times, points, *one.shape[2:])) for one in each], axis=1
    )


def _none_if_zero(slopes: Array) -> Array:
    """Slopes of matrices (n or 1, S or 1, na, ., .); with na = 0 where all are zero."""
    return slopes if slopes.any() else np.zeros((1, 1, 0, *slopes.shape[3:]))
