"""A deterministic Gaussian filter for the mixed model, run for many parameter vectors at once.

It propagates mean and covariance of x = (a, z) by sigma points in a and exactly in z. Its
log-likelihood is smooth in theta and free of Monte Carlo noise, which makes it the instrument for
comparing many extended models quickly; on linear Gaussian models it is the Kalman filter. It is an
approximation where the density of a is far from Gaussian: there the particle filter has the last
word (see :mod:`engine.diagnose`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.errors import ModelError
from engine.kernels.gaussian import psd_cholesky_many
from engine.kernels.moments import (
    gaussian_update,
    observe,
    predict,
    sigma_points,
    slopes,
    transform,
)
from engine.statespace.first_state import moments_of_first
from engine.statespace.model import Array, MixedModel, stacked
from engine.statespace.refutation import refutations, repeated_if_refuted
from engine.views import Shown

NEAR_SHARE = 1e-4  # of a state's size: over this, slopes are taken where the state has no variance
PATHS = 2  # of a series, the last ones, are kept: several steps of a diagnosis ask for the same


@dataclass(frozen=True, eq=False)
class MomentFiltered(Shown):
    """One-step predictions of K filters: ``innovations`` (T, K, ny), their covariance ``S``, ...

    ``log_likelihood`` (K,) is -inf where a filter was lost; missing values are NaN in
    ``innovations``. ``log_terms`` (T, K) are its summands.
    """

    innovations: Array
    S: Array
    log_terms: Array

    @property
    def log_likelihood(self) -> Array:
        """Sum of the terms (K,), -inf where not finite."""
        total = self.log_terms.sum(axis=0)
        return np.where(np.isfinite(total), total, -np.inf)


@dataclass(frozen=True, eq=False)
class MomentPath:
    """What one filter saw: moments and slopes along its way, for footprints of small changes.

    ``predicted``, ``filtered`` (T, nx) means of x with covariances ``P_predicted``, ``P_filtered``;
    ``innovations`` (T, ny), ``S`` (T, ny, ny); gains ``K`` (T, nx, ny) = Cov(x_t, y_t) S^{-1}, zero for missing
    channels; slopes ``H`` (T, ny, nx) of y_t and ``F`` (T-1, nx, nx) of x_{t+1} along x_t.
    """

    predicted: Array
    P_predicted: Array
    filtered: Array
    P_filtered: Array
    innovations: Array
    S: Array
    K: Array
    H: Array
    F: Array
    log_likelihood: float


_Kept: TypeAlias = tuple[MixedModel, bytes, int, MomentPath]
_KEPT: WeakKeyDictionary[Series, tuple[_Kept, ...]] = WeakKeyDictionary()


class Thetas:
    """K parameter vectors (K, n_theta) and their records."""

    def __init__(self, model: MixedModel, thetas: Array) -> None:
        self.model = model
        self.thetas = np.atleast_2d(np.asarray(thetas, dtype=float))
        self.K = len(self.thetas)
        self._records: dict[int, Any] = {}

    def record(self, copies: int) -> Any:
        """The record of K ``copies`` rows, ``copies`` for each parameter vector in turn."""
        if copies not in self._records:  # the same at every time step
            self._records[copies] = self.model.records(self.thetas, copies)
        return self._records[copies]


@repeated_if_refuted
@np.errstate(all="ignore")
def moment_filter(model: MixedModel, thetas: Array, series: Series) -> MomentFiltered:
    """Filter a series with each of the parameter vectors ``thetas`` (K, n_theta)."""
    return run_filter(FilterSteps(model, Thetas(model, thetas), series))


def run_filter(run: FilterSteps, visited: tuple[Array, Array] | None = None) -> MomentFiltered:
    """All steps of the filter; ``visited``, each (T, S, na), are filled with the points of the first copy.

    With those at which y_t, and those at which x_{t+1} is predicted.
    """
    model, series = run.model, run.series
    T, K, ny = len(series), run.thetas.K, model.ny
    innovations, S, terms = np.empty((T, K, ny)), np.empty((T, K, ny, ny)), np.empty((T, K))
    m, P = run.start()
    a, z, V, offsets = sigma_points(m, P, model.na)
    rows = a.reshape(K * a.shape[1], model.na)  # the kernels overwrite the points in place
    for t in range(T):
        if visited is not None:
            visited[0][t] = a[0]
        observe(
            t, *run.observation(t, rows), a, z, V, offsets, m, P, series.y, innovations, S, terms
        )
        if visited is not None:
            visited[1][t] = a[0]
        if t < T - 1:
            predict(*run.transition(t, rows), a, z, V, offsets, m, P)
    return MomentFiltered(innovations, S, usable(terms, innovations, S, series))


def usable(terms: Array, innovations: Array, S: Array, series: Series) -> Array:
    """The terms (T, K) of the log-likelihood, NaN where a filter has no prediction: it must not gain by it."""
    there = series.observed[:, None]
    lost = ~(np.isfinite(innovations) | ~there).all(axis=2) | ~np.isfinite(S).all(axis=(2, 3))
    terms[lost] = np.nan
    return terms


def moment_path(model: MixedModel, theta: Array, series: Series) -> MomentPath:
    """Filter a series with one parameter vector and keep the moments and slopes.

    The last ones of a series are kept and not to be written into; none from before a function was found not
    to take rows. Raises ModelError naming the row at which the filter was lost.
    """
    own = np.asarray(theta, dtype=float).tobytes()
    known = _KEPT.get(series, ())
    for one, at, refuted, path in known:
        if one is model and at == own and refuted == refutations():
            return path
    path = _path(model, theta, series)
    _KEPT[series] = ((model, own, refutations(), path), *known)[:PATHS]
    return path


@repeated_if_refuted
@np.errstate(all="ignore")
def _path(model: MixedModel, theta: Array, series: Series) -> MomentPath:
    run = FilterSteps(model, Thetas(model, theta), series)
    T, nx, ny = len(series), model.nx, model.ny
    kept: dict[str, Array] = {
        "predicted": np.empty((T, nx)),
        "P_predicted": np.empty((T, nx, nx)),
        "filtered": np.empty((T, nx)),
        "P_filtered": np.empty((T, nx, nx)),
        "innovations": np.empty((T, ny)),
        "S": np.empty((T, ny, ny)),
        "K": np.zeros((T, nx, ny)),
        "H": np.empty((T, ny, nx)),
        "F": np.empty((T - 1, nx, nx)),
    }
    total = 0.0
    m, P = run.start()
    for t in range(T):
        y_mean, S, cross = run.through(run.observation, t, m, P)
        kept["predicted"][t], kept["P_predicted"][t] = m[0], P[0]
        kept["innovations"][t], kept["S"][t] = series.y[t] - y_mean[0], S[0]
        kept["H"][t] = slopes(cross[0], P[0])
        there = np.flatnonzero(series.observed[t])
        if there.size:
            gain = np.linalg.solve(S[0][np.ix_(there, there)], cross[0][there])
            kept["K"][t][:, there] = gain.T
        m, P, term = gaussian_update(m, P, y_mean, S, cross, series.y[t])
        kept["filtered"][t], kept["P_filtered"][t] = m[0], P[0]
        total += float(term[0])
        if not (np.isfinite(m).all() and np.isfinite(total)):
            raise ModelError(
                f"model '{model.name}': the filter is lost at row {t} (t = {series.t[t]:g}); its "
                "mean or likelihood is not finite. Check theta and the first state's density"
            )
        if t < T - 1:
            before = P
            m, P, cross = run.through(run.transition, t, m, P)
            kept["F"][t] = slopes(cross[0], before[0])
    _slopes_without_variance(run, kept)
    return MomentPath(**kept, log_likelihood=total)


def _slopes_without_variance(run: FilterSteps, kept: dict[str, Array]) -> None:
    """Fill in H and F where a direction of x has no variance, from which nothing can be regressed.

    There they are slopes over a small share of what each state is at most on the way, in its unit.
    """
    predicted, P = kept["predicted"], kept["P_predicted"]
    variance = np.diagonal(P, axis1=1, axis2=2)
    sizes = np.maximum(np.abs(predicted), np.sqrt(np.maximum(variance, 0.0))).max(axis=0)
    # 1: it never leaves zero
    least = np.diag((NEAR_SHARE * np.where(sizes > 0.0, sizes, 1.0)) ** 2)
    for name, function, means, covs in (
        ("H", run.observation, predicted, P),
        ("F", run.transition, kept["filtered"][:-1], kept["P_filtered"][:-1]),
    ):
        pivots = np.diagonal(psd_cholesky_many(np.ascontiguousarray(covs)), axis1=1, axis2=2)
        for t in np.flatnonzero(~(pivots > 0.0).all(axis=1)):
            wide = covs[t] + least
            _, _, cross = run.through(function, int(t), means[t][None], wide[None])
            kept[name][t] = slopes(cross[0], wide)


class FilterSteps:
    """The model's part of each step, for K copies of the filter."""

    def __init__(self, model: MixedModel, thetas: Thetas, series: Series) -> None:
        series.check(model)
        self.model, self.thetas, self.series = model, thetas, series
        self.times, self.steps = series.t.tolist(), series.steps.tolist()
        model.transitions.look_again(series.u_step)
        model.observations.look_again(series.u)

    def start(self) -> tuple[Array, Array]:
        """Mean (K, nx) and covariance (K, nx, nx) of x_1 before any measurement."""
        means, covs = self._first
        return means.copy(), covs.copy()

    @cached_property
    def _first(self) -> tuple[Array, Array]:
        starts = [first_moments(self.model, theta) for theta in self.thetas.thetas]
        return np.array([m for m, _ in starts]), np.array([P for _, P in starts])

    def observation(self, t: int, a: Array) -> tuple[Array, Array, Array]:
        """h (K S, ny), C and R (1 or K S, ., .) at the points a (K S, na)."""
        record = self.thetas.record(len(a) // self.thetas.K)
        h, C, R = self.model.observation(a, self.series.u[t], self.times[t], record)
        return h, stacked(C), stacked(R)

    def transition(self, t: int, a: Array) -> tuple[Array, Array, Array]:
        """f (K S, nx), A and Q (1 or K S, ., .) at the points a (K S, na); x_1 where a record begins next."""
        if t + 1 in self.series.begins:
            return self._begin_again(len(a) // self.thetas.K)
        record = self.thetas.record(len(a) // self.thetas.K)
        f, A, Q = self.model.transition(
            a, self.series.u_step[t], self.times[t], self.steps[t], record
        )
        return f, stacked(A), stacked(Q)

    def _begin_again(self, copies: int) -> tuple[Array, Array, Array]:
        m, P = self._first
        model, each = self.model, copies if self.thetas.K > 1 else 1
        nothing = np.zeros((1, model.nx, model.nz))
        return np.repeat(m, copies, axis=0), nothing, np.repeat(P, each, axis=0)

    def through(self, function: Any, t: int, m: Array, P: Array) -> tuple[Array, Array, Array]:
        """Mean, covariance and cross-covariance with x of a function of x ~ N(m, P)."""
        na = self.model.na
        a, z, V, offsets = sigma_points(m, P, na)
        rows = a.reshape(a.shape[0] * a.shape[1], na)
        f, A, Q = function(t, rows)
        mean, cov, cross = transform(f, A, Q, z, V, offsets, na)
        return mean, cov, cross


def first_moments(model: MixedModel, theta: Array) -> tuple[Array, Array]:
    """Mean (nx,) and covariance (nx, nx) of x_1 at theta."""
    return moments_of_first(model, model.record(theta))


def free_thetas(theta: Array, indices: NDArray[np.intp], values: Array) -> Array:
    """Copies of theta (K, n_theta) with the components ``indices`` set to ``values`` (K, n)."""
    out = np.repeat(np.asarray(theta, dtype=float)[None], len(values), axis=0)
    out[:, indices] = values
    return out
