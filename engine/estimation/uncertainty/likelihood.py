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
smoother, the curve at the ends is right to about 0.1 (of 1.92 that it falls by), as I is that at the
estimate; else it has Monte Carlo noise too, which ``errors`` tells, and the particles' bias in the
slope, which vanishes as their number grows.

The maximum is that of the curve, next to the estimate. An estimate at which EM stopped a little
early therefore does no harm. Another maximum further away is inside only if the likelihood does not
fall enough in between.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from engine.data.given import as_series_list
from engine.data.series import Series
from engine.distributions import chi2_quantile
from engine.errors import ModelError, NotSettledWarning, OptionError
from engine.estimation.uncertainty.observed import Estimate, of_estimate, standard_errors
from engine.estimation.uncertainty.observed_result import StandardErrors
from engine.estimation.uncertainty.score import Score
from engine.randomness import check_seed
from engine.statespace.model import Array, MixedModel, Theta, ThetaLike
from engine.threads import single_threaded
from engine.ties import scaled_inverse
from engine.views import Shown, View, sheet, tables
from engine.words import Told, digits_of_ends

STEP_ERRORS = 0.7  # between the values of theta_k, in standard errors ...
GROWTH = 1.25  # ... and by how much it grows from one to the next
SIDE_POINTS = 20  # on one side at most; the last is some 240 standard errors away
# Nats beyond the end: the step is halved, so that the spline has a point nearby.
OVERSHOOT_NATS = 1.5
HALVINGS = 3
BEYOND_NATS = 0.3  # nats that the last point is beyond the end
NEAR_ERRORS = 0.01  # standard errors from a bound count as being there
LAG_NATS = 0.01  # nats by which the other parameters may be away from their maximum ...
CORRECTIONS = 3  # ... after this many steps towards it at most
AWAY_ERRORS = 1.0  # standard errors between the estimate and the maximum are worth a warning
STEP_PARTS = 64  # parts of each step on which the curve is searched


@dataclass(frozen=True, eq=False)
class LikelihoodIntervals(Shown):
    """Intervals of the free parameters by the likelihood ratio.

    Attributes
    ----------
    model : MixedModel
        The model that was estimated.
    theta : Theta
        The estimate (n_theta,) about which the intervals are.
    level : float
        Confidence of each interval, such as 0.95.
    values : array (n_theta, 2)
        The intervals; NaN for parameters that are held fixed or at a bound. An end that is the parameter's
        bound, which may be infinite, says that the likelihood does not fall enough before it.
    errors : array (n_theta, 2)
        Monte Carlo standard errors of the ends, NaN where there is no end but a bound.
    maximum : array (n_theta,)
        Value at which each profile is highest: the estimate, if it is the maximum.
    warning : str
        A sentence where a maximum is more than a standard error away from the estimate, else "".
    """

    model: MixedModel
    theta: Theta
    level: float
    values: Array
    errors: Array
    maximum: Array
    warning: str = ""

    def _view(self) -> View:
        rows = [
            (p.name, *(Told(one, digits_of_ends(low, high)) for one in (value, low, high)), p.unit)
            for p, value, (low, high) in zip(
                self.model.parameters, self.theta.tolist(), self.values.tolist(), strict=True
            )
            if np.isfinite(low) or np.isfinite(high)
        ]
        head = ("parameter", "estimate", f"{100 * self.level:g} % from", "to", "unit")
        title = f"{self.model.name}: intervals by the likelihood ratio"
        return sheet(title, tables().line(self.warning), tables().table(head, rows))


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
        values[index], maximum[index] = ends(at, slopes.mean(axis=0), theta[index], fall, outermost)
        spread[index] = _jackknife(at, slopes, theta[index], fall, outermost)
        spread[index, np.isin(values[index], score.bounds)] = np.nan
    warning = _warning(errors, maximum)
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


@dataclass(frozen=True, eq=False)
class _March:
    """Along the profile of one parameter after the other, away from the estimate."""

    score: Score
    covariance: Array
    replicates: int
    seeds: np.random.SeedSequence

    def profile(self, k: int, fall: float) -> tuple[Array, Array, tuple[float, float]]:
        """Values of parameter k in order (P,), and the slopes of its profile there (R, P).

        Then how far its interval may reach: to the outermost values, or to a bound before which the
        likelihood did not fall enough.
        """
        x = self.score.x
        scores = self._scores(x)
        v, other = self._directions(k, x, scores)
        centre = x + other @ scores.mean(axis=0)
        at, slopes, outermost = [x[k]], [scores @ v], []
        for sign in (-1.0, 1.0):
            side, reach = self._side(k, sign, self._clipped(centre, k), slopes[0], fall)
            outermost.append(reach)
            for value, slope in side:
                at.append(value)
                slopes.append(slope)
        order = np.argsort(at)
        return np.array(at)[order], np.array(slopes)[order].T, (outermost[0], outermost[1])

    def _side(
        self, k: int, sign: float, x: Array, slope: Array, fall: float
    ) -> tuple[list[tuple[float, Array]], float]:
        """Values and slopes on one side until the curve has fallen, and how far that side reaches."""
        sd = float(np.sqrt(self.covariance[k, k]))
        lower, upper = self.score.bounds
        bound = lower[k] if sign < 0.0 else upper[k]
        v = self.covariance[:, k] / self.covariance[k, k]
        step, halvings = STEP_ERRORS * sd, 0
        at, slopes = [x[k]], [float(slope.mean())]
        out: list[tuple[float, Array]] = []
        while len(out) < SIDE_POINTS:
            room = abs(bound - x[k])
            if room < NEAR_ERRORS * sd:
                break
            length = min(step, 0.9 * room)  # at a bound a variance may be zero
            there, slope_there, direction = self._at(k, x + sign * length * v)
            fallen = _fallen([*at, there[k]], [*slopes, float(slope_there.mean())])
            if fallen > fall + OVERSHOOT_NATS and halvings < HALVINGS:
                step, halvings = 0.5 * length, halvings + 1
                continue
            out.append((float(there[k]), slope_there))
            if fallen > fall + BEYOND_NATS:
                return out, float(there[k])
            x, v = there, direction
            at.append(x[k])
            slopes.append(float(slope_there.mean()))
            step *= GROWTH
        return out, float(bound)

    def _at(self, k: int, x: Array) -> tuple[Array, Array, Array]:
        """The point of the profile next to x, its slopes (R,), and the profile's direction there."""
        x = self._clipped(x, k)
        scores = self._scores(x)
        v, other = self._directions(k, x, scores)
        s = scores.mean(axis=0)
        for _ in range(CORRECTIONS):
            if 0.5 * float(s @ other @ s) <= LAG_NATS:
                break
            x = self._clipped(x + other @ s, k)
            scores = self._scores(x)
            v, other = self._directions(k, x, scores)
            s = scores.mean(axis=0)
        return self._clipped(x + other @ s, k), scores @ v, v

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
        information = scaled_inverse(self.covariance)
        v, other = np.zeros(len(x)), np.zeros((len(x), len(x)))
        v[k] = 1.0
        if moving.size:
            inverse = scaled_inverse(information[np.ix_(moving, moving)])
            v[moving] = -inverse @ information[moving, k]
            other[np.ix_(moving, moving)] = inverse
        return v, other

    def _room(self) -> tuple[Array, Array]:
        """How far each parameter may go: nearly to its bounds."""
        x, (lower, upper) = self.score.x, self.score.bounds
        return x - 0.999 * (x - lower), x + 0.999 * (upper - x)

    def _clipped(self, x: Array, k: int) -> Array:
        """The others within their room; parameter k is left alone."""
        out: Array = np.clip(x, *self._room())
        out[k] = x[k]
        return out


def _fallen(at: list[float], slopes: list[float]) -> float:
    """How far below its highest value the curve with these slopes is at the last of ``at``."""
    order = np.argsort(at)
    height = CubicSpline(np.array(at)[order], np.array(slopes)[order]).antiderivative()(at)
    return float(height.max() - height[-1])


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
