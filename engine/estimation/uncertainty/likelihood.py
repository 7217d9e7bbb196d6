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
theta_k to either side (:mod:`engine.estimation.uncertainty.profile`), joined by a spline and integrated. Of
particles it has Monte Carlo noise, which ``errors`` tells, and their bias, which vanishes as their number
grows. An end to which there is no way is not found, and is said to be so.

The maximum is that of the curve, next to the estimate. An estimate at which EM stopped a little
early therefore does no harm. Another maximum further away is inside only if the likelihood does not
fall enough in between.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from engine.data.given import as_series_list
from engine.data.series import Series
from engine.distributions import chi2_quantile
from engine.errors import ModelError, NotSettledWarning, OptionError
from engine.estimation.uncertainty.likelihood_result import LikelihoodIntervals
from engine.estimation.uncertainty.observed import (
    Estimate,
    of_estimate,
    said_of_drawn,
    said_of_failure,
    standard_errors,
)
from engine.estimation.uncertainty.observed_result import StandardErrors
from engine.estimation.uncertainty.profile import March
from engine.estimation.uncertainty.score import Score
from engine.randomness import check_seed
from engine.statespace.model import Array, MixedModel, ThetaLike
from engine.threads import single_threaded
from engine.words import enumerated

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
    exact = exact or model.na == 0  # particles would repeat one another
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
    march = March(score, errors.covariance, 1 if exact else replicates, seeds)
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
    drawn = said_of_drawn("intervals", errors.drawn)
    told = (failed, drawn, _warning(errors, maximum), _said_of_missing(errors, values))
    warning = " ".join(filter(None, told))
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


def ends(
    at: Array, slope: Array, start: float, fall: float, outermost: tuple[float, float]
) -> tuple[tuple[float, float], float]:
    """Where the curve with ``slope`` (P,) at ``at`` (P,) has fallen by ``fall``, and its maximum.

    The maximum is reached uphill from ``start``. A side that never falls enough ends where the interval
    may reach at most, ``outermost``.
    """
    height = PchipInterpolator(at, slope).antiderivative()
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
