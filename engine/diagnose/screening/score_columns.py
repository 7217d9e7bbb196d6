"""Derivatives of the one-step predictions by an effect's size: the columns of the score tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary, ref

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.estimation.differences import alive, neighbours
from engine.estimation.jumps import sides
from engine.estimation.quasi_ml import whitening
from engine.filters.filter_steps import first_moments
from engine.filters.neighbours import Visited, filter_all, filter_neighbours, visited_on
from engine.filters.sigma_point import KNOWN_SHARE, MomentFiltered, MomentPath
from engine.kernels.moments import sigma_points, transform
from engine.kernels.sensitivities import sensitivities
from engine.statespace.model import Array, MixedModel
from engine.statespace.points import Points
from engine.statespace.reads import ignores
from engine.ties import FLAT

# A probe's size in its own standard errors: a slope, also of what few data tell.
REACH_ERRORS = 0.005
NEAR_SHARE = 0.9  # share of it that is near enough


# of its own scatter, by which a prediction moves where a slope is taken: aimed at, and accepted
AIMED_SHARE, SLIGHT_SHARES = 1e-4, (1e-7, 1e-2)
TRIALS = 12  # steps tried: units may be far apart

ATTEMPTS = 12  # at a step
POWERS = (0.5, 2.0)  # of a size, to which predictions answer

_KEPT: WeakKeyDictionary[MomentPath, tuple[ref[Series], tuple[Array, Array, Array, Array]]] = (
    WeakKeyDictionary()
)
_SCATTERS: WeakKeyDictionary[MomentPath, list[Array]] = WeakKeyDictionary()

UNTESTABLE = 1e-4  # rho below this: the parameters take up all an effect could show


@dataclass(frozen=True, eq=False)
class Column:
    """One direction in which the model might be wrong: contributions s (T,) and vector v.

    Of v the means' part may be all, where covariances stay as they are.
    """

    s: Array
    v: Array


class Projection:
    """Takes the fitted parameters' directions out of columns: ``axes`` (r, .), orthonormal; scores (r, T)."""

    def __init__(self, nuisance: Sequence[Column]) -> None:
        self.axes, self.scores = np.empty((0, 0)), np.empty((0, 0))
        # of a parameter beside which the filter is lost nothing is known
        nuisance = [c for c in nuisance if np.isfinite(c.s).all() and np.isfinite(c.v).all()]
        if not nuisance:
            return
        V = np.array([c.v for c in nuisance])
        size = np.linalg.norm(V, axis=1, keepdims=True)
        size[size == 0.0] = 1.0
        turned, stretched, axes = np.linalg.svd(V / size, full_matrices=False)
        # a direction that parameters leave open holds what differences leave of it, and no information: at a
        # bound, on one side of it, more than rounding
        known = stretched > FLAT * stretched[0]
        s = np.array([c.s for c in nuisance]) / size
        self.axes = axes[known]
        self.scores = (turned[:, known] / stretched[known]).T @ s

    def __call__(self, s: Array, v: Array) -> tuple[Array, Array]:
        """Projected s (n, T) and v (n, .)."""
        along, s = self.along(s, v)
        return s, self.apart(v, along)

    def along(self, s: Array, v: Array) -> tuple[Array, Array]:
        """How far v (n, .) go along the axes, (n, r), and projected s (n, T)."""
        along = v @ self.axes[:, : v.shape[1]].T if len(self.axes) else np.empty((len(v), 0))
        return along, s - along @ self.scores if len(self.axes) else s

    def apart(self, v: Array, along: Array) -> Array:
        """v (n, .) without what goes so far along the axes."""
        if not len(self.axes):
            return v
        out = -along @ self.axes
        out[:, : v.shape[1]] += v
        return np.asarray(out)


def innovation_columns(
    base: MomentFiltered, observed: NDArray[np.bool_], pairs: Sequence[tuple[int, int, float]]
) -> list[Column]:
    """Columns from pairs (low, high, distance) of filters in one batch; row 0 is the base."""
    root = whitening(base.S[:, 0], observed)
    columns = []
    for low, high, distance in pairs:
        d_nu = np.nan_to_num(base.innovations[:, high] - base.innovations[:, low]) / distance
        d_S = (base.S[:, high] - base.S[:, low]) / distance
        z = np.einsum("tij,tj->ti", root, d_nu)
        E = root @ d_S @ np.swapaxes(root, -1, -2) / np.sqrt(2.0)
        s = (base.log_terms[:, high] - base.log_terms[:, low]) / distance
        columns.append(Column(s, np.concatenate([z.ravel(), E.ravel()])))
    return columns


def parameter_columns(
    model: MixedModel, theta: Array, indices: NDArray[np.intp], series: Series
) -> list[Column]:
    """The directions of the estimated parameters; none of one on whose both sides the model cannot be had."""
    if not len(indices):
        return []
    thetas = neighbours(model, theta, indices)
    filtered, ends = alive(filter_neighbours(model, thetas, series), thetas)
    distances = sides(ends, indices)[2]
    pairs = [(1 + 2 * i, 2 + 2 * i, float(d) or 1.0) for i, d in enumerate(distances)]
    return innovation_columns(filtered, series.observed, pairs)


def whitened(path: MomentPath, series: Series) -> tuple[Array, Array, Array, Array]:
    """S_t^{-1/2} and S_t^{-1} (T, ny, ny), innovations and whitened ones (T, ny); zero where missing.

    Kept with the way, as all columns along it share them.
    """
    known = _KEPT.get(path)
    if known is not None and known[0]() is series:
        return known[1]
    root = whitening(path.S, series.observed)
    nu = np.nan_to_num(path.innovations)
    out = root, np.swapaxes(root, -1, -2) @ root, nu, np.einsum("tij,tj->ti", root, nu)
    _KEPT[path] = ref(series), out
    return out


@np.errstate(all="ignore")  # sizes are tried that are far too large
def effect_columns(
    effect: Effect, model: MixedModel, theta: Array, series: Series, path: MomentPath
) -> list[tuple[tuple[float, ...], Column]]:
    """One column per probe of an effect; none where its filter is lost.

    An effect without states of its own changes the model's functions along the base filter's path;
    one with such states needs filters of its own.
    """
    extended = effect.apply(model)
    at = np.array([np.concatenate([theta, [0.0], probe]) for probe in effect.probes])
    columns: Sequence[Column | None]
    if extended.nx == model.nx:
        columns = [
            static_column(effect, extended, row, len(theta), model, series, path) for row in at
        ]
    else:
        known = extended.nonlinear == model.nonlinear  # at size zero its filter goes the base's way
        visited = visited_on(path, model.na) if known else None
        columns = _dynamic_columns(effect, extended, at, len(theta), series, visited)
    return [
        (probe, column)
        for probe, column in zip(effect.probes, columns, strict=True)
        if column is not None and np.isfinite(column.s).all() and np.isfinite(column.v).all()
    ]


def static_column(
    effect: Effect,
    extended: MixedModel,
    at: Array,
    k: int,
    model: MixedModel,
    series: Series,
    path: MomentPath,
) -> Column:
    """The column of parameter k of ``extended`` at ``at``, along the path of the base model."""
    b, dQ, e, dR, dX, dm, dV = _slopes(extended, at, k, model, series, path)
    root, precision, nu, z = whitened(path, series)
    g, dS = sensitivities(path.F, path.H, path.K, precision, nu, b, e, dQ, dR, dX, dm, dV)
    Z = -np.einsum("tij,tj->ti", root, g)
    E = root @ dS @ np.swapaxes(root, -1, -2)
    s = -(Z * z).sum(axis=1) + 0.5 * (
        np.einsum("ti,tij,tj->t", z, E, z) - np.trace(E, axis1=1, axis2=2)
    )
    return Column(s, np.concatenate([Z.ravel(), E.ravel() / np.sqrt(2.0)]))


def _slopes(
    extended: MixedModel, at: Array, k: int, model: MixedModel, series: Series, path: MomentPath
) -> list[Array]:
    """Differences of what :func:`along_path` returns by parameter k.

    By a step that changes predictions by a small share of their own scatter, whatever the units are.
    """
    if path not in _SCATTERS:  # the same for all effects
        _SCATTERS[path] = _scatter(path)
    sizes = _SCATTERS[path]
    lower, upper = extended.lower[k], extended.upper[k]
    step = 1e-5 * (upper if np.isfinite(upper) and upper > 0.0 else 1.0)
    for _ in range(TRIALS):
        low, high = at.copy(), at.copy()
        low[k], high[k] = max(at[k] - step, lower), min(at[k] + step, upper)
        ends = [along_path(extended, point, model, series, path, k) for point in (low, high)]
        changes = [y - x for x, y in zip(*ends, strict=True)]
        felt = max(
            float(np.abs(change / size).max(initial=0.0))
            for change, size in zip(changes, sizes, strict=True)
        )
        if SLIGHT_SHARES[0] <= felt <= SLIGHT_SHARES[1]:
            break
        if not np.isfinite(felt):  # so far off that it runs away, in the units of this model
            step *= 1e-8
            continue
        factor = AIMED_SHARE / felt if felt > 0.0 else 1e4
        if factor > 1.0 and step * factor > 0.5 * (upper - lower):
            break
        step *= float(np.clip(factor, 1e-8, 1e8))
    # in rows, whatever order a model's arrays have: a kernel is compiled for one order
    return [np.ascontiguousarray(change / (high[k] - low[k])) for change in changes]


def _scatter(path: MomentPath) -> list[Array]:
    """Standard deviations and variances of what :func:`along_path` returns, 1 where there are none.

    Of each row, but not below the usual ones: at the first the model may know next to nothing, and a step that
    is small there would be lost in rounding at all others. Nor so far below what a state does that changes of
    that size would be rounding: of one without noise that forgets its beginning next to nothing is left.
    """
    x = np.sqrt(np.diagonal(path.P_predicted, axis1=1, axis2=2))
    y = np.sqrt(np.diagonal(path.S, axis1=1, axis2=2))
    usual, spread = np.median(x, axis=0), np.std(path.predicted, axis=0)
    usual = np.maximum(usual, KNOWN_SHARE * spread)
    usual = np.where(usual > 0.0, usual, 1.0)
    x, least = np.maximum(x, usual), np.median(y, axis=0)
    y = np.maximum(y, np.where(least > 0.0, least, 1.0))
    after, first = x[1:], x[0]
    return [
        after,
        _outer(after, after),
        y,
        _outer(y, y),
        _outer(x, y),
        first,
        np.outer(first, first),
    ]


def _outer(one: Array, other: Array) -> Array:
    """Products (T, n, m) of each row's (T, n) and (T, m)."""
    return one[:, :, None] * other[:, None, :]


def along_path(
    extended: MixedModel,
    theta: Array,
    model: MixedModel,
    series: Series,
    path: MomentPath,
    by: int = -1,
) -> tuple[Array, ...]:
    """One step of ``extended`` from each of the moments on the path of ``model``, and where it begins.

    Mean and covariance of x_{t+1}, (T-1, nx) and (T-1, nx, nx); mean and covariance of y_t, (T, ny) and
    (T, ny, ny); Cov(x_t, y_t) (T, nx, ny); mean (nx,) and covariance (nx, nx) of x_1; all in the base model's
    order of states. Zero where a function ignores parameter ``by``, whose differences are asked for.
    """
    T, nx, ny = len(series), model.nx, model.ny
    states = [*model.nonlinear, *model.linear]
    order = [states.index(name) for name in [*extended.nonlinear, *extended.linear]]
    back = np.argsort(order)
    record = extended.record(theta)
    out = []
    for transition, function in ((True, extended.dynamics), (False, extended.measurement)):
        begun = transition and series.begins and not ignores(extended.initial, by)
        if by >= 0 and ignores(function, by) and not begun:
            shape = (T - 1, nx) if transition else (T, ny)
            out.append((np.zeros(shape), np.zeros((*shape, shape[1])), np.zeros((*shape, nx))))
            continue
        if transition:
            m, P = path.filtered[:-1], path.P_filtered[:-1]
        else:
            m, P = path.predicted, path.P_predicted
        m = np.ascontiguousarray(m[:, order])
        P = np.ascontiguousarray(P[:, order][:, :, order])
        a, z, V, offsets = sigma_points(m, P, extended.na)
        n, S = a.shape[:2]
        f, A, Q = Points(extended, series, a).at(np.arange(n), record, transition)
        out.append(
            transform(
                f.reshape(n * S, -1), _rows(A, n, S), _rows(Q, n, S), z, V, offsets, extended.na
            )
        )
    (x_mean, x_cov, _), (y_mean, y_cov, cross) = out
    first, first_cov = np.zeros(nx), np.zeros((nx, nx))
    if by < 0 or not ignores(extended.initial, by):
        first, first_cov = first_moments(extended, theta)
    return (
        x_mean[:, back],
        x_cov[:, back][:, :, back],
        y_mean,
        y_cov,
        np.ascontiguousarray(np.swapaxes(cross[:, :, back], 1, 2)),
        first[back],
        np.ascontiguousarray(first_cov[back][:, back]),
    )


def _rows(matrix: Array, n: int, S: int) -> Array:
    """(1, ., .) where common to all points, else (n S, ., .).

    Of one kind, whoever made them: a kernel is compiled anew for what may not be written into.
    """
    shape = matrix.shape[2:]
    if matrix.shape[:2] == (1, 1):
        return np.require(matrix[0], requirements=["C", "W"])
    if matrix.shape[:2] != (n, S):
        matrix = np.broadcast_to(matrix, (n, S, *shape))
    return np.require(matrix, requirements=["C", "W"]).reshape(n * S, *shape)


def _dynamic_columns(
    effect: Effect,
    extended: MixedModel,
    at: Array,
    k: int,
    series: Series,
    visited: Visited | None,
) -> list[Column | None]:
    """One column for each row of ``at`` (n, n_theta), from one pass of the filter for all of them."""
    steps = _steps(extended, at, k, series, visited)
    use = np.flatnonzero(np.isfinite(steps))
    columns: list[Column | None] = [None] * len(at)
    if not use.size:
        return columns
    high = at[use].copy()
    high[:, k] = steps[use]
    low = high.copy()
    low[:, k] *= -1.0
    sides = high if effect.one_sided else np.concatenate([high, low])
    filtered = _filters(extended, np.concatenate([at[:1], sides]), series, visited)
    n, reach = len(use), 1.0 if effect.one_sided else 2.0
    pairs = [
        (0 if effect.one_sided else 1 + n + place, 1 + place, reach * float(step))
        for place, step in enumerate(steps[use])
    ]
    for i, column in zip(use, innovation_columns(filtered, series.observed, pairs), strict=True):
        columns[i] = column
    return columns


def _filters(
    extended: MixedModel, thetas: Array, series: Series, visited: Visited | None
) -> MomentFiltered:
    if visited is None:
        return filter_all(extended, thetas, series)
    return filter_neighbours(extended, thetas, series, visited.part(len(series)))


def _steps(
    extended: MixedModel, at: Array, k: int, series: Series, visited: Visited | None
) -> Array:
    """Sizes (n,) of about REACH_ERRORS standard errors, found on the first part of the series; NaN for none."""
    first = 100 * series.substeps
    part = series if len(series) <= first else series.part(0, first)
    longer = np.sqrt(len(series) / len(part))
    steps = np.full(len(at), 1e-3 * max(min(float(extended.upper[k]), 1.0), 1e-300))
    open_, found = np.ones(len(at), dtype=bool), np.full(len(at), np.nan)
    before: list[tuple[float, float] | None] = [None] * len(at)  # step and what it reached
    for _ in range(ATTEMPTS):
        rows = np.flatnonzero(open_)
        if not rows.size:
            break
        thetas = at[rows].copy()
        thetas[:, k] = steps[rows]
        filtered = _filters(extended, np.concatenate([at[:1], thetas]), part, visited)
        pairs = [(0, 1 + n, 1.0) for n in range(len(rows))]
        columns = innovation_columns(filtered, part.observed, pairs)
        for i, column in zip(rows, columns, strict=True):
            now = float(steps[i]), float(np.linalg.norm(column.v)) * longer
            if NEAR_SHARE * REACH_ERRORS <= now[1] <= REACH_ERRORS / NEAR_SHARE:
                found[i], open_[i] = now[0], False
                continue
            steps[i], before[i] = _next_step(now, before[i]), now
            if not 1e-250 < steps[i] < 1e250:
                open_[i] = False
    return found


def _next_step(now: tuple[float, float], before: tuple[float, float] | None) -> float:
    """The step that should reach REACH_ERRORS, from what one or two steps reached: by a power law.

    Most answer to a size in proportion, a variance to its square.
    """
    step, reach = now
    if not np.isfinite(reach):
        return step * 1e-2
    if reach == 0.0:
        return step * 1e2
    power = 1.0
    if before is not None and before[0] != step and 0.0 < before[1] < np.inf:
        power = float(np.log(reach / before[1]) / np.log(step / before[0]))
        power = float(np.clip(power, *POWERS)) if np.isfinite(power) else 1.0
    return step * float(np.clip((REACH_ERRORS / reach) ** (1.0 / power), 1e-4, 1e4))
