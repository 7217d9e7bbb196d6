"""Confidence intervals by the likelihood ratio: where the profile likelihood has fallen enough.

A symmetric interval, estimate +- 1.96 standard errors, takes the log-likelihood for a parabola. Where
the information changes with theta it is none, and such intervals cover too little. The interval
here is the set of values theta_k about the estimate with

    2 (max l - l_p(theta_k)) <= the quantile of chi^2 with one degree of freedom,

l_p(theta_k) being the log-likelihood maximised over the other parameters. Particle filters give l with
noise, and values at different theta do not make a smooth curve. Its slope is smooth: along the profile
it is the efficient score

    s_k - I_ko I_oo^{-1} s_o        (o: the other parameters, I: the observed information),

an average over smoothed trajectories by Fisher's identity. So the slope is taken at a few values of
theta_k to either side, joined by a spline and integrated. For linear Gaussian models, with the Kalman
smoother, each step of the curve is held against the likelihood itself, and is halved until they agree; else
it has Monte Carlo noise, which ``errors`` tells, and the particles' bias in the slope, which vanishes as their
number grows.

The other parameters follow by scoring. On a curved ridge the information at the estimate leads them astray
elsewhere, so that it changes along the way as the moment filter's does. Where they do not arrive the step is
halved, too; an end to which there is no way is not found, and is said to be so.

The maximum is that of the curve, next to the estimate. An estimate at which EM stopped a little
early therefore does no harm. Another maximum further away is inside only if the likelihood does not
fall enough in between.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from engine.data.given import as_series_list
from engine.data.series import Series
from engine.distributions import chi2_quantile
from engine.errors import ModelError, NotSettledWarning, OptionError
from engine.estimation.uncertainty.likelihood_result import LikelihoodIntervals
from engine.estimation.uncertainty.observed import (
    Estimate,
    of_estimate,
    said_of_failure,
    score_decrement,
    standard_errors,
)
from engine.estimation.uncertainty.observed_result import StandardErrors
from engine.estimation.uncertainty.roots import good_guess, root_of_inverse
from engine.estimation.uncertainty.score import Score
from engine.randomness import check_seed
from engine.statespace.model import Array, MixedModel, ThetaLike
from engine.threads import single_threaded
from engine.ties import scaled_inverse
from engine.words import enumerated

STEP_ERRORS = 0.7  # between the values of theta_k, in standard errors ...
GROWTH = 1.25  # ... and by how much it grows from one to the next ...
FLAT_GROWTH, FLAT_NATS = 2.0, 0.1  # ... or where the likelihood fell by less than so many nats
SIDE_POINTS = 60  # on one side at most
# Nats beyond the end: the step is halved, so that the spline has a point nearby.
OVERSHOOT_NATS = 1.5
LEAST_STEP = 0.01  # standard errors, or of the room to the bound: it is not halved any more
BEYOND_NATS = 0.3  # nats that the last point is beyond the end
NEAR_ERRORS = 0.01  # standard errors from a bound count as being there
# So far away a likelihood that falls by so little while the distance grows by its own length has levelled off.
FAR_ERRORS, LEVEL_NATS = 240.0, 0.1
# Nats by which the other parameters may be away from their maximum: beside noise ...
LAG_NATS = 0.01
EXACT_LAG = 1e-4  # ... and without any, ...
CORRECTIONS = 3  # ... after this many steps towards it at most,
EXACT_CORRECTIONS = 8  # each of which brings them nearer
AGREED_NATS = 0.03  # between the likelihood itself and the integral of its slope over one step
AWAY_ERRORS = 1.0  # standard errors between the estimate and the maximum are worth a warning
STEP_PARTS = 64  # parts of each step on which the curve is searched


@single_threaded
def likelihood_intervals(  # noqa: PLR0913
    model: MixedModel,
    theta: ThetaLike | Estimate,
    series: Series | Sequence[Series],
    free: Sequence[str] | None = None,
    level: float = 0.95,
    errors: StandardErrors | None = None,
    n_particles: int = 100,
    n_trajectories: int = 100,
    replicates: int = 4,
    seed: int = 0,
    exact: bool = False,
    callback: Callable[[str], Any] | None = None,
) -> LikelihoodIntervals:
    """Confidence intervals by the likelihood ratio about an estimate.

    Parameters
    ----------
    model : MixedModel
        The model, paper, eq. (1).
    theta : Theta, mapping, array or EmResult
        The estimate (n_theta,), in the parameters' units; the result of an estimation also says what was free.
    series : Series or sequence of Series
        One experiment or several; y (T, ny) with NaN where missing, u (T, nu), times.
    free : sequence of str, optional
        Names of the estimated parameters, where ``errors`` does not give them; all by default.
    level : float
        Confidence, between 0 and 1.
    errors : StandardErrors, optional
        The standard errors at the estimate; computed first if not given.
    n_particles : int
        Number of particles M.
    n_trajectories : int
        Number of trajectories N that are drawn, each of weight 1/N.
    replicates : int
        Smoothers that each slope is averaged over; some eight slopes are needed for each parameter.
    seed : int
        Seed of all random numbers; the same seed gives the same result to the last bit.
    exact : bool
        Use the Kalman smoother instead of particles (linear Gaussian models).
    callback : callable, optional
        ``callback(name)`` before a parameter's interval is sought; may stop the run by raising.

    Returns
    -------
    LikelihoodIntervals
        ``values`` (n_theta, 2) in the parameters' units, with Monte Carlo errors of the ends.

    Raises
    ------
    OptionError
        The level is not between 0 and 1.
    ModelError
        The data hold no information on a parameter or only determine some together, or the likelihood is not
        finite near the estimate.
    """
    if not 0.0 < level < 1.0:
        raise OptionError(f"level = {level:g}; a number between 0 and 1 is needed", "level")
    check_seed(seed)
    failed = said_of_failure(theta if isinstance(theta, Estimate) else None)
    theta, free = of_estimate(theta, free)
    theta = model.theta(theta)
    if errors is None:
        with warnings.catch_warnings():  # an interval finds the maximum for itself
            warnings.simplefilter("ignore", NotSettledWarning)
            errors = standard_errors(
                model, theta, series, free, n_particles, n_trajectories, seed=seed, exact=exact
            )
    if errors.tied:
        raise ModelError(
            f"intervals by the likelihood need parameters that the data determine. {errors.warning}"
        )
    all_series = as_series_list(series, model)
    indices = np.array([model.index(name) for name in errors.names], dtype=np.intp)
    score = Score.of(model, theta, all_series, indices, n_particles, n_trajectories, exact)
    seeds = np.random.SeedSequence(seed, spawn_key=(1,))
    march = _March(score, errors.covariance, 1 if exact else replicates, seeds)
    fall = 0.5 * float(chi2_quantile(level, 1))
    values, spread = (np.full((len(theta), 2), np.nan) for _ in range(2))
    maximum = np.array(theta)
    for k, index in enumerate(indices):
        if callback is not None:
            callback(errors.names[k])
        at, slopes, outermost = march.profile(k, fall)
        if len(at) == 1:  # no way from the estimate
            continue
        values[index], maximum[index] = ends(at, slopes.mean(axis=0), theta[index], fall, outermost)
        low, high = np.nan_to_num(values[index], nan=theta[index])
        if errors.settled and not low <= theta[index] <= high:  # there is no way up from a maximum
            values[index], maximum[index] = np.nan, theta[index]
            continue
        spread[index] = _jackknife(at, slopes, theta[index], fall, outermost)
        spread[index, np.isin(values[index], score.bounds)] = np.nan
    warning = " ".join(
        filter(None, (failed, _warning(errors, maximum), _said_of_missing(errors, values)))
    )
    if warning:
        warnings.warn(warning, NotSettledWarning, stacklevel=3)  # to the caller
    return LikelihoodIntervals(model, theta, level, values, spread, maximum, warning)


def _warning(errors: StandardErrors, maximum: Array) -> str:
    """What to say where a profile is highest more than AWAY_ERRORS standard errors from the estimate."""
    away = np.abs(maximum - np.asarray(errors.theta)) > AWAY_ERRORS * np.nan_to_num(errors.values)
    far = [
        f"{p.name} = {value:.5g}"
        for p, value, yes in zip(errors.model.parameters, maximum.tolist(), away, strict=True)
        if yes
    ]
    if not far:
        return ""
    return (
        f"The likelihood is highest at {', '.join(far)}, not at the estimate: let the estimation go on, or "
        "start it there. The intervals are about the maximum."
    )


def _said_of_missing(errors: StandardErrors, values: Array) -> str:
    """A sentence about ends that were not found, "" without any."""
    missing = []
    for name in errors.names:
        no_low, no_high = np.isnan(values[errors.model.index(name)])
        if no_low or no_high:
            which = "" if no_low and no_high else " (lower end)" if no_low else " (upper end)"
            missing.append(f"{name}{which}")
    if not missing:
        return ""
    return (
        f"Not found: the interval of {enumerated(missing)}, as the maximum over the other parameters could "
        "not be followed to where the likelihood has fallen enough."
    )


@dataclass(frozen=True, eq=False)
class _Point:
    """Of a profile: the parameters x (n,), slopes (R,), dx / dx_k (n,), and its height where that is exact."""

    x: Array
    slopes: Array
    direction: Array
    height: float

    @property
    def slope(self) -> float:
        return float(self.slopes.mean())


@dataclass(frozen=True, eq=False)
class _March:
    """Along the profile of one parameter after the other, away from the estimate."""

    score: Score
    covariance: Array
    replicates: int
    seeds: np.random.SeedSequence

    @cached_property
    def _information_at_estimate(self) -> Array:
        return scaled_inverse(self.covariance)

    @cached_property
    def _guide(self) -> Array | None:
        """A root (n, n) of the moment filter's information at the estimate, where that is much as here."""
        found, L = (
            self.score.information(self.score.x),
            root_of_inverse(self._information_at_estimate),
        )
        return None if found is None or not good_guess(L.T @ found @ L) else _cholesky(found)

    def profile(self, k: int, fall: float) -> tuple[Array, Array, tuple[float, float]]:
        """Values of parameter k in order (P,), and the slopes of its profile there (R, P).

        Then how far its interval may reach: to the outermost values, or to a bound before which the
        likelihood did not fall enough.
        """
        start = self._at(k, self.score.x)
        if start is None:
            return self.score.x[[k]], np.zeros((self.replicates, 1)), (np.nan, np.nan)
        points, outermost = [start], []
        for sign in (-1.0, 1.0):
            side, reach = self._side(k, sign, start, fall)
            outermost.append(reach)
            points += side
        points.sort(key=lambda point: float(point.x[k]))
        at, slopes = np.array([p.x[k] for p in points]), np.array([p.slopes for p in points])
        return at, slopes.T, (outermost[0], outermost[1])

    def _side(self, k: int, sign: float, start: _Point, fall: float) -> tuple[list[_Point], float]:
        """Points on one side until the curve has fallen, and how far that side reaches; NaN if not found."""
        sd = float(np.sqrt(self.covariance[k, k]))
        lower, upper = self.score.bounds
        bound = float(lower[k] if sign < 0.0 else upper[k])
        step, fallen = STEP_ERRORS * sd, 0.0
        points = [start]
        while len(points) <= SIDE_POINTS:
            last = points[-1]
            room = abs(bound - last.x[k])
            if room < NEAR_ERRORS * sd or self._level(k, start, last):
                return points[1:], bound
            length = min(step, 0.9 * room)  # at a bound a variance may be zero
            there = self._after(k, points, sign * length)
            now = np.inf if there is None else _fallen(k, [*points, there])
            if now > fall + OVERSHOOT_NATS and 0.5 * length > LEAST_STEP * min(sd, room):
                step = 0.5 * length
                continue
            if there is None:
                break
            points.append(there)
            if now > fall + BEYOND_NATS:
                return points[1:], float(there.x[k])
            step = length * (FLAT_GROWTH if now - fallen < FLAT_NATS else GROWTH)
            fallen = now
        return points[1:], np.nan

    def _after(self, k: int, points: list[_Point], step: float) -> _Point | None:
        """The point of the profile after the last one, a ``step`` away; None where it is not surely that."""
        last = points[-1]
        try:
            there = self._at(k, last.x + step * last.direction)
        except (ModelError, ArithmeticError, np.linalg.LinAlgError):
            return None
        if there is None or not self.score.exact:
            return there
        heights = _heights(k, [*points, there])
        rise = there.height - last.height
        return there if abs(rise - (heights[-1] - heights[-2])) < AGREED_NATS else None

    def _level(self, k: int, start: _Point, last: _Point) -> bool:
        """Whether the profile has levelled off, so far as noise of its slope lets it be seen."""
        distance = abs(last.x[k] - start.x[k])
        noise = last.slopes.std() / np.sqrt(len(last.slopes))
        far = distance > FAR_ERRORS * np.sqrt(self.covariance[k, k])
        return bool(far and (abs(last.slope) - 2.0 * noise) * distance < LEVEL_NATS)

    def _at(self, k: int, x: Array) -> _Point | None:
        """The point of the profile next to x, None where the other parameters do not arrive there."""
        exact, before = self.score.exact, np.inf
        x = self._clipped(x, k)
        for _ in range(1 + (EXACT_CORRECTIONS if exact else CORRECTIONS)):
            scores = self._scores(x)
            v, other = self._directions(k, x, scores)
            decrement, noise = score_decrement(other, scores)
            here, lag = x, 0.5 * decrement
            if lag <= (EXACT_LAG if exact else LAG_NATS) or (exact and lag > before):
                break
            x, before = self._clipped(x + other @ scores.mean(axis=0), k), lag
        if lag > LAG_NATS + 0.5 * noise:
            return None
        if not exact:
            return _Point(
                self._clipped(here + other @ scores.mean(axis=0), k), scores @ v, v, np.nan
            )
        return _Point(here, scores @ v, v, self.score.value(here) + lag)

    def _scores(self, x: Array) -> Array:
        """(R, n) with random numbers of their own: noise at one value is not that at the next."""
        scores = np.array([self.score.at(x, w)[0] for w in self.seeds.spawn(self.replicates)])
        if not np.isfinite(scores).all():
            values = ", ".join(f"{n} = {v:.4g}" for n, v in zip(self.score.names, x, strict=True))
            raise ModelError(f"the likelihood is not finite at {values}, near the estimate")
        return scores

    def _directions(self, k: int, x: Array, scores: Array) -> tuple[Array, Array]:
        """dx / dx_k along the profile (n,), and I_oo^{-1} (n, n) of the other parameters.

        Others that are at the edge of their room and drawn further out stay there.
        """
        s, (low, high) = scores.mean(axis=0), self._room()
        held = ((x <= low) & (s < 0.0)) | ((x >= high) & (s > 0.0))
        held[k] = True
        moving = np.flatnonzero(~held)
        information = self._information(x)
        v, other = np.zeros(len(x)), np.zeros((len(x), len(x)))
        v[k] = 1.0
        if moving.size:
            inverse = scaled_inverse(information[np.ix_(moving, moving)])
            v[moving] = -inverse @ information[moving, k]
            other[np.ix_(moving, moving)] = inverse
        return v, other

    def _information(self, x: Array) -> Array:
        """That at the estimate (n, n), changed as the moment filter's is from there to x."""
        there = None if self._guide is None else self.score.information(x)
        root = None if there is None else _cholesky(there)
        if root is None or self._guide is None:
            return self._information_at_estimate
        change = root @ np.linalg.inv(self._guide)
        return np.asarray(change @ self._information_at_estimate @ change.T)

    def _room(self) -> tuple[Array, Array]:
        """How far each parameter may go: nearly to its bounds."""
        x, (lower, upper) = self.score.x, self.score.bounds
        return x - 0.999 * (x - lower), x + 0.999 * (upper - x)

    def _clipped(self, x: Array, k: int) -> Array:
        """The others within their room; parameter k is left alone."""
        out: Array = np.clip(x, *self._room())
        out[k] = x[k]
        return out


def _cholesky(matrix: Array) -> Array | None:
    """Its Cholesky factor, None where it has none."""
    try:
        return np.asarray(np.linalg.cholesky(matrix))
    except np.linalg.LinAlgError:
        return None


def _heights(k: int, points: Sequence[_Point]) -> Array:
    """The curve (P,) at points in turn, from its slopes."""
    at, slopes = np.array([p.x[k] for p in points]), np.array([p.slope for p in points])
    order = np.argsort(at)
    return np.asarray(CubicSpline(at[order], slopes[order]).antiderivative()(at))


def _fallen(k: int, points: Sequence[_Point]) -> float:
    """How far below its highest value the curve is at the last of the points."""
    heights = _heights(k, points)
    return float(heights.max() - heights[-1])


def ends(
    at: Array, slope: Array, start: float, fall: float, outermost: tuple[float, float]
) -> tuple[tuple[float, float], float]:
    """Where the curve with ``slope`` (P,) at ``at`` (P,) has fallen by ``fall``, and its maximum.

    The maximum is reached uphill from ``start``. A side that never falls enough ends where the interval
    may reach at most, ``outermost``.
    """
    height = CubicSpline(at, slope).antiderivative()
    parts = [np.linspace(a, b, STEP_PARTS, endpoint=False) for a, b in pairwise(at)]
    x = np.append(np.concatenate(parts), at[-1])
    y: NDArray[np.float64] = height(x)
    top = int(np.argmin(np.abs(x - start)))
    while top > 0 and y[top - 1] > y[top]:
        top -= 1
    while top < len(x) - 1 and y[top + 1] > y[top]:
        top += 1
    level = y[top] - fall
    below = np.flatnonzero(y < level)
    left, right = below[below < top], below[below > top]
    low, high = outermost
    if left.size:
        i = left[-1]
        low = float(np.interp(level, y[i : i + 2], x[i : i + 2]))
    if right.size:
        i = right[0]
        high = float(np.interp(-level, -y[i - 1 : i + 1], x[i - 1 : i + 1]))
    return (low, high), float(x[top])


def _jackknife(
    at: Array, slopes: Array, start: float, fall: float, outermost: tuple[float, float]
) -> Array:
    """Monte Carlo standard errors (2,) of the ends, by leaving out one replicate after the other."""
    R = len(slopes)
    if R < 2:
        return np.zeros(2)
    without = (slopes.sum(axis=0) - slopes) / (R - 1)
    each = np.array([ends(at, one, start, fall, outermost)[0] for one in without])
    with np.errstate(invalid="ignore"):  # a bound may be infinite
        return np.asarray(np.sqrt((R - 1) * each.var(axis=0)))
