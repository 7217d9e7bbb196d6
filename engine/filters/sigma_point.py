"""A deterministic Gaussian filter for the mixed model, run for many parameter vectors at once.

It propagates mean and covariance of x = (a, z) by sigma points in a and exactly in z. Its
log-likelihood is smooth in theta and free of Monte Carlo noise, which makes it the instrument for
comparing many extended models quickly; on linear Gaussian models it is the Kalman filter. It is an
approximation where the density of a is far from Gaussian: there the particle filter has the last
word (see :mod:`engine.diagnose`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.failing import where_it_fails
from engine.filters.filter_steps import FilterSteps, Thetas, lost_at
from engine.filters.strata import StrataSteps, filter_in_strata, path_in_strata
from engine.filters.taped import filter_by_tape
from engine.kernels.gaussian import psd_cholesky_many
from engine.kernels.moment_steps import keep_reading, observe, predict, room_for, slopes
from engine.kernels.moments import points_of
from engine.statespace.model import Array, MixedModel
from engine.statespace.refutation import refutations, repeated_if_refuted
from engine.views import Shown

NEAR_SHARE = 1e-4  # of a state's size: over this, slopes are taken where the state has no variance
KNOWN_SHARE = 1e-6  # of it: what scatters by less is known but for rounding
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
        with np.errstate(over="ignore"):  # of a filter that ran away
            total = self.log_terms.sum(axis=0)
        return np.where(np.isfinite(total), total, -np.inf)

    def of(self, which: NDArray[np.intp]) -> MomentFiltered:
        """Those of the filters that are named by their positions (n,)."""
        return MomentFiltered(
            self.innovations[:, which], self.S[:, which], self.log_terms[:, which]
        )


@dataclass(frozen=True, eq=False)
class MomentPath:
    """What one filter saw: moments and slopes along its way, for footprints of small changes.

    ``predicted``, ``filtered`` (T, nx) means of x with covariances ``P_predicted``, ``P_filtered``;
    ``innovations`` (T, ny), ``S`` (T, ny, ny); gains ``K`` (T, nx, ny) = Cov(x_t, y_t) S^{-1}, zero for missing
    channels; slopes ``H`` (T, ny, nx) of y_t and ``F`` (T-1, nx, nx) of x_{t+1} along x_t. ``S`` is the one by
    which scores come out, ``S_predicted`` the covariance that was predicted: another if noise is not Gaussian.
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
    S_predicted: Array
    log_likelihood: float


_Kept: TypeAlias = tuple[MixedModel, bytes, int, MomentPath]
_KEPT: WeakKeyDictionary[Series, tuple[_Kept, ...]] = WeakKeyDictionary()


@repeated_if_refuted
@np.errstate(all="ignore")
def moment_filter(model: MixedModel, thetas: Array, series: Series) -> MomentFiltered:
    """Filter a series with each of the parameter vectors ``thetas`` (K, n_theta)."""
    run = Thetas(model, thetas)
    if model.random_scales:
        innovations, S, terms = filter_in_strata(StrataSteps(model, run, series))
        return MomentFiltered(innovations, S, usable(terms, innovations, S, series))
    return run_filter(FilterSteps(model, run, series))


def run_on_tape(
    run: FilterSteps, visited: tuple[Array, Array] | None = None
) -> MomentFiltered | None:
    """:func:`run_filter` in one call of a kernel; None where the model's functions must be called."""
    found = filter_by_tape(run, visited)
    if found is None:
        return None
    innovations, S, terms = found
    return MomentFiltered(innovations, S, usable(terms, innovations, S, run.series))


def run_filter(run: FilterSteps, visited: tuple[Array, Array] | None = None) -> MomentFiltered:
    """All steps of the filter; ``visited``, each (T, S, na), are filled with the points of the first copy.

    With those at which y_t, and those at which x_{t+1} is predicted.
    """
    model, series = run.model, run.series
    if (taped := run_on_tape(run, visited)) is not None:
        return taped
    T, K, ny = len(series), run.thetas.K, model.ny
    innovations, S, terms = np.empty((T, K, ny)), np.empty((T, K, ny, ny)), np.empty((T, K))
    m, P = run.start_beside()
    rows, beside = points_of(m, P, model.na)  # overwritten in place
    room, points = room_for(K, model.na, model.nx, ny), len(rows) // K
    for t in range(T):
        if visited is not None:
            visited[0][t] = rows[:points]
        seen = run.observation(t, rows)
        observe(room, (False, False), t, *seen, rows, beside, m, P, series.y, innovations, S, terms)
        if visited is not None:
            visited[1][t] = rows[:points]
        if t < T - 1:
            predict(room, (False, False), *run.transition(t, rows), rows, beside, m, P)
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
    thetas = Thetas(model, theta)
    run = FilterSteps(model, thetas, series)
    kept = _nothing_kept(model, len(series))
    if model.random_scales:
        total = path_in_strata(StrataSteps(model, thetas, series), kept)
    else:
        total = _keep(run, kept)
    _slopes_without_variance(run, kept)
    return MomentPath(**kept, log_likelihood=total)


def _nothing_kept(model: MixedModel, T: int) -> dict[str, Array]:
    nx, ny = model.nx, model.ny
    return {
        "predicted": np.empty((T, nx)),
        "P_predicted": np.empty((T, nx, nx)),
        "filtered": np.empty((T, nx)),
        "P_filtered": np.empty((T, nx, nx)),
        "innovations": np.empty((T, ny)),
        "S": np.empty((T, ny, ny)),
        "S_predicted": np.empty((T, ny, ny)),
        "K": np.zeros((T, nx, ny)),
        "H": np.empty((T, ny, nx)),
        "F": np.empty((T - 1, nx, nx)),
    }


def _keep(run: FilterSteps, kept: dict[str, Array]) -> float:
    """All steps of one filter, ``kept``, and its log-likelihood."""
    model, series, T = run.model, run.series, len(run.series)
    moments = [kept[name] for name in ("predicted", "P_predicted", "filtered", "P_filtered")]
    gains = [kept[name] for name in "HKF"]
    found = filter_by_tape(run, None, moments, gains)
    if found is None:
        found = _kept_by_calls(run, moments, gains)
    kept["innovations"][:], kept["S"][:] = found[0][:, 0], found[1][:, 0]
    kept["S_predicted"] = kept["S"]
    with np.errstate(over="ignore"):
        total = usable(found[2], found[0], found[1], series)[:, 0].cumsum()
    here = np.isfinite(total) & np.isfinite(kept["filtered"]).all(axis=1)
    if not here.all():
        t = int(np.argmin(here))
        raise lost_at(model, series, t, _why_lost(run, kept, t))
    return float(total[T - 1])


@where_it_fails("")
def _why_lost(run: FilterSteps, kept: dict[str, Array], t: int) -> str:
    """Why the filter is lost at row t; "" if nobody knows."""
    if not t:
        means, covs = run.start()
        return run.why_unread(means[0], covs[0], 0)
    return run.why_lost(kept["filtered"][t - 1], kept["P_filtered"][t - 1], t - 1)


def _kept_by_calls(
    run: FilterSteps, moments: list[Array], gains: list[Array]
) -> tuple[Array, Array, Array]:
    """The same as :func:`engine.filters.taped.filter_by_tape` of one filter; ends where it is lost."""
    model, series, T = run.model, run.series, len(run.series)
    predicted, P_predicted, filtered, P_filtered = moments
    innovations, S = np.empty((T, 1, model.ny)), np.empty((T, 1, model.ny, model.ny))
    terms = np.zeros((T, 1))
    m, P = run.start_beside()
    rows, beside = points_of(m, P, model.na)
    room = room_for(1, model.na, model.nx, model.ny)
    for t in range(T):
        predicted[t], P_predicted[t] = m[:, 0], P[:, :, 0]
        seen = run.observation(t, rows)
        cross = observe(
            room, (False, False), t, *seen, rows, beside, m, P, series.y, innovations, S, terms
        )
        filtered[t], P_filtered[t] = m[:, 0], P[:, :, 0]
        keep_reading(t, cross[:, :, 0].copy(), S[t, 0], series.y[t], tuple(moments), tuple(gains))
        if not (np.isfinite(m).all() and np.isfinite(terms[t, 0])):
            terms[t] = np.nan
            break
        if t < T - 1:
            cross = predict(room, (False, False), *run.transition(t, rows), rows, beside, m, P)
            gains[2][t] = slopes(cross[:, :, 0].copy(), P_filtered[t])
    return innovations, S, terms


def _slopes_without_variance(run: FilterSteps, kept: dict[str, Array]) -> None:
    """Fill in H and F where a direction of x has next to no variance, from which nothing can be regressed.

    A state that forgets its beginning and has no noise, as a motor's lag, is known ever better, and what is
    left of its covariances is rounding. There they are slopes over a small share of what each state is at most
    on the way, in its unit.
    """
    predicted, P = kept["predicted"], kept["P_predicted"]
    variance = np.diagonal(P, axis1=1, axis2=2)
    sizes = np.maximum(np.abs(predicted), np.sqrt(np.maximum(variance, 0.0))).max(axis=0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)  # 1: it never leaves zero
    least = np.diag((NEAR_SHARE * sizes) ** 2)
    for name, function, means, covs in (
        ("H", run.observation, predicted, P),
        ("F", run.transition, kept["filtered"][:-1], kept["P_filtered"][:-1]),
    ):
        pivots = np.diagonal(psd_cholesky_many(np.ascontiguousarray(covs)), axis1=1, axis2=2)
        for t in np.flatnonzero(~(pivots > KNOWN_SHARE * sizes).all(axis=1)):
            wide = covs[t] + least
            _, _, cross = run.through(function, int(t), means[t][None], wide[None])
            kept[name][t] = slopes(cross[0], wide)


def free_thetas(theta: Array, indices: NDArray[np.intp], values: Array) -> Array:
    """Copies of theta (K, n_theta) with the components ``indices`` set to ``values`` (K, n)."""
    out = np.repeat(np.asarray(theta, dtype=float)[None], len(values), axis=0)
    out[:, indices] = values
    return out
