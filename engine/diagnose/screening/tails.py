"""Heavy tails and outliers: their test, and what they gain.

Outliers do not move the moments of a Gaussian filter's predictions, so the score of
:mod:`engine.diagnose.screening.screen` does not see them. Their test is the kurtosis of the one-step errors,
after the probability integral transform where predictions are mixtures (a RBPF's are), with the
normal approximation of Anscombe and Glynn (1983). The extended model's noise is a scale mixture, whose
likelihood is climbed from the best of a grid of share and ratio.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import ndtr, ndtri

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.screening.rounding import below_rounding
from engine.diagnose.screening.screen import Test
from engine.distributions import kurtosis_z, normal_sf
from engine.estimation.differences import DIFFERENCE, alive, neighbours
from engine.estimation.expectation import parameter_scale
from engine.estimation.jumps import sides, slopes
from engine.estimation.quasi_ml import QuasiFit
from engine.filters.rbpf import Filtered, rbpf
from engine.filters.sigma_point import MomentPath, moment_filter, moment_path
from engine.kernels.filtering import condition, draw_prior
from engine.statespace.model import Array, MixedModel, stacked

PARTICLES = 200
SHARES = (0.003, 0.01, 0.03, 0.1)
RATIOS = (3.0, 5.0, 10.0)
USUAL = 10.0  # ratio at which the kurtosis is read as a share
LEAST_RATIO, MOST_RATIO = 2.0, 1e4
SHARE_LEAST, SHARE_MOST = 1e-3, 0.45
STEPS = 20  # uphill from the best of the grid
PRECISE, ROUGH = 1e-3, 2e-2  # of a log-likelihood: gain of a step from which the next is not taken
LEAST_KNOWN = 1e-300
LOST = 1e300  # a value that no step is taken to
# Standardised errors beyond OUTLYING are outliers, but those AFTER so many samples of a larger one: its echo.
OUTLYING, AFTER = 3.5, 3
LEAST = 20  # values without which a kurtosis means nothing


def standardised_errors(path: MomentPath, observed: NDArray[np.bool_], pit: Array | None) -> Array:
    """Standardised one-step errors (T, ny), NaN where missing: by PIT where there is one."""
    if pit is not None:
        return np.asarray(ndtri(np.clip(pit, 1e-12, 1.0 - 1e-12)))
    scale = np.sqrt(np.diagonal(path.S, axis1=1, axis2=2))
    return np.where(observed, path.innovations / scale, np.nan)


def first_of_each(sizes: Array, rows: NDArray[np.intp], after: int = AFTER) -> list[int]:
    """Those of the ``rows`` whose error, of ``sizes`` (T,), is larger than any of so many before it.

    A filter that took an outlier for true is off for a while.
    """
    return [int(t) for t in rows if sizes[t] > sizes[max(t - after, 0) : t].max(initial=0.0)]


def tail_test(effect: Effect, model: MixedModel, path: MomentPath, errors: Array) -> Test | None:
    """The kurtosis test of an effect: of an output's errors, or of the state's share in them."""
    if effect.channel in model.outputs:
        r = errors[:, list(model.outputs).index(effect.channel)]
    else:
        row = [*model.nonlinear, *model.linear].index(effect.channel)
        gain = path.K[:, row]
        move = (gain * np.nan_to_num(path.innovations)).sum(axis=1)
        variance = np.einsum("ti,tij,tj->t", gain, path.S, gain)
        r = np.where(
            variance > 0.0, move / np.sqrt(np.where(variance > 0.0, variance, 1.0)), np.nan
        )
    r = r[np.isfinite(r)]
    if len(r) < LEAST or float(r.std()) == 0.0:
        return None
    z = kurtosis_z(r)
    n = path.innovations.shape[0]
    width = path.innovations.size * (1 + path.innovations.shape[1])
    # the size is a share; to first order the excess kurtosis is 3 share (ratio^2 - 1)^2
    excess = max(float(np.mean(r**4) / np.mean(r**2) ** 2 - 3.0), 0.0)
    size = min(excess / (3.0 * (USUAL**2 - 1.0) ** 2), 0.2)
    return Test(
        effect,
        np.full((1, n), max(size, 1e-4) / n),
        np.ones(1),
        np.ones(1),
        ((USUAL,),),
        np.zeros((1, width)),
        known=(max(z, 0.0) ** 2, float(normal_sf(z))),
    )


def tails_left(fit: QuasiFit, effect: Effect, series: Series) -> float:
    """The p-value of an effect's kurtosis test on a fitted model; 1 where it says nothing."""
    path = moment_path(fit.model, np.asarray(fit.theta), series)
    errors = standardised_errors(path, series.observed, pit_of(fit, series, seed=0))
    test = tail_test(effect, fit.model, path, errors)
    return 1.0 if test is None or test.known is None else test.known[1]


def prediction_pit(filtered: Filtered, rng: np.random.Generator) -> Array:
    """P(y_t <= measured | y_{1:t-1}) under the RBPF's predictive mixture, (T, ny), NaN where missing.

    Each particle's prediction draws one a from report, eq. (23); z is integrated out.
    """
    model, series = filtered.model, filtered.series
    record = model.record(filtered.theta)
    T, M = filtered.weights.shape
    own = np.arange(M)
    pit = np.full((T, model.ny), np.nan)
    for t in range(1, T):
        mu, L = filtered.mu[t - 1], filtered.L[t - 1]
        a = draw_prior(mu, L, own, rng.standard_normal((M, model.na)))
        z, Z, _ = condition(mu, L, own, a)
        h, C, R = model.observation(a, series.u[t], float(series.t[t]), record)
        C, R = stacked(C), stacked(R)
        mean = h + (C @ z[:, :, None])[:, :, 0]
        variance = ((C @ Z) ** 2).sum(axis=2) + np.diagonal(R, axis1=1, axis2=2)
        cdf = ndtr((series.y[t] - mean) / np.sqrt(variance))
        pit[t] = filtered.weights[t - 1] @ cdf
    pit[~series.observed] = np.nan
    return pit


def pit_of(fit: QuasiFit, series: Series, seed: int) -> Array | None:
    """The transform by a RBPF at a fitted model; None where the moments say it all (na = 0)."""
    if fit.model.na == 0:
        return None
    rng = np.random.default_rng([seed, 77])
    # of a particle that runs away, and has no weight
    with np.errstate(over="ignore", invalid="ignore"):
        filtered = rbpf(fit.model, fit.theta, series, PARTICLES, rng, proposal="bootstrap")
        return prediction_pit(filtered, rng)


def fit_tails(
    fit: QuasiFit,
    effect: Effect,
    series: Series,
    tolerance: float = PRECISE,
    enough: float = np.inf,
) -> tuple[float, Array]:
    """2 (log-likelihood gained) by outliers and the extended theta: from the best of a grid uphill.

    The usual noise shrinks where outliers made it seem large, so the model's own parameters move, too; until a
    step gains less than ``tolerance``, and not where the grid gains ``enough``.
    """
    ratios = np.outer(RATIOS, _sizes(fit, effect, series)).ravel()
    pairs = np.array([(a, b) for a in SHARES for b in np.unique(np.minimum(ratios, MOST_RATIO))])
    theta, extended = np.asarray(fit.theta), effect.apply(fit.model)

    lost = below_rounding(fit.model, theta, series, _first_state(fit, series))

    def value(thetas: Array, own: Array) -> tuple[Array, Array]:
        each = np.broadcast_to(thetas, (len(own), len(theta)))
        terms = moment_filter(extended, np.hstack([each, own]), series).log_terms
        return terms, np.zeros(len(own)) if lost is None else lost(each)

    terms, less = value(theta, pairs)
    total = terms.sum(axis=0) - less
    best = int(np.argmax(total))
    if 2.0 * (total[best] - fit.log_likelihood) >= enough:
        return 2.0 * (total[best] - fit.log_likelihood), np.concatenate([theta, pairs[best]])
    found, theta, own = _uphill(fit, value, float(total[best]), pairs[best], tolerance)
    return 2.0 * (found - fit.log_likelihood), np.concatenate([theta, own])


def tails_information(fit: QuasiFit, effect: Effect, series: Series, extended: Array) -> Array:
    """Information (k, k) of the free parameters, share and ratio at an ``extended`` theta.

    The outer product of the scores of single rows (Berndt, Hall, Hall, Hausman 1974).
    """
    theta, own = np.split(extended, [len(fit.theta)])
    indices = fit.model.free_indices(fit.free)
    thetas = neighbours(fit.model, theta, indices)
    steps = DIFFERENCE * own
    beside = own + np.repeat(np.diag(steps), 2, axis=0) * [[-1.0], [1.0], [-1.0], [1.0]]
    every = np.concatenate([thetas, np.repeat(theta[None], 4, axis=0)])
    pairs = np.concatenate([np.repeat(own[None], len(thetas), axis=0), beside])
    points = np.hstack([every, pairs])
    filtered, points = alive(moment_filter(effect.apply(fit.model), points, series), points)
    every_one = np.append(indices, len(theta) + np.arange(len(own)))
    known = np.nan_to_num(slopes(filtered.log_terms, *sides(points, every_one)))
    return np.asarray(known.T @ known)


def _sizes(fit: QuasiFit, effect: Effect, series: Series) -> Array:
    """Of the noise, and of what is seen of it, beside which outliers show however little the noise is."""
    model, path = fit.model, moment_path(fit.model, np.asarray(fit.theta), series)
    record, t = model.record(fit.theta), int(np.argmax(series.observed.any(axis=1)))
    a = path.filtered[t, : model.na][None]
    u, time, dt = series.u[t], float(series.t[t]), float(series.steps[min(t, len(series) - 2)])
    if effect.channel in model.outputs:
        i = list(model.outputs).index(effect.channel)
        noise, seen = model.observation(a, u, time, record)[2], path.S[:, i, i]
    else:
        i = [*model.nonlinear, *model.linear].index(effect.channel)
        noise = model.transition(a, series.u_step[t], time, dt, record)[2]
        seen = np.einsum("tj,tjk,tk->t", path.K[:, i], path.S, path.K[:, i])
    own = float(stacked(noise)[0, i, i])
    wider = np.sqrt(np.median(seen) / own) if own > 0.0 else 1.0
    return np.array([1.0, max(wider, 1.0)]) if np.isfinite(wider) else np.ones(1)


def _first_state(fit: QuasiFit, series: Series) -> Array:
    """The filtered nonlinear states (na,) at the first reading."""
    t = int(np.argmax(series.observed.any(axis=1)))
    path = moment_path(fit.model, np.asarray(fit.theta), series)
    return np.asarray(path.filtered[t, : fit.model.na])


def _uphill(
    fit: QuasiFit,
    value: Callable[[Array, Array], tuple[Array, Array]],
    best: float,
    own: Array,
    tolerance: float,
) -> tuple[float, Array, Array]:
    """The largest value near the fit's theta and ``own`` (share, ratio), with these: a few BFGS steps."""
    model, theta = fit.model, np.asarray(fit.theta)
    indices = model.free_indices(fit.free)
    size = np.array([parameter_scale(model, theta, int(k)) for k in indices])
    known = np.diag(fit.information)
    size = np.where(
        known > 0.0, np.minimum(size, 1.0 / np.sqrt(np.maximum(known, LEAST_KNOWN))), size
    )
    ends = np.log([(SHARE_LEAST, SHARE_MOST), (LEAST_RATIO, MOST_RATIO)])
    least, most = (
        np.concatenate([(bound[indices] - theta[indices]) / size, of_own])
        for bound, of_own in zip((model.lower, model.upper), ends.T, strict=True)
    )

    def points(x: Array) -> tuple[Array, Array]:
        thetas = np.tile(theta, (len(x), 1))
        thetas[:, indices] = np.clip(
            theta[indices] + size * x[:, :-2], model.lower[indices], model.upper[indices]
        )
        return thetas, np.exp(x[:, -2:])

    def slope(x: Array) -> tuple[float, Array]:
        low, high = np.maximum(x - DIFFERENCE, least), np.minimum(x + DIFFERENCE, most)
        every = np.tile(x, (1 + 2 * len(x), 1))
        k = np.arange(len(x))
        every[1 + 2 * k, k], every[2 + 2 * k, k] = low, high
        terms, less = value(*points(every))
        total = terms.sum(axis=0) - less
        if not np.isfinite(total).all():
            return LOST, np.zeros(len(x))
        # where a row jumps, as at a date, the slope is that of its other side
        slope_of_terms = slopes(terms, x - low, high - x, high - low).sum(axis=0)
        return -float(total[0]), (less[2::2] - less[1::2]) / (high - low) - slope_of_terms

    start = np.concatenate([np.zeros(len(indices)), np.log(own)])
    end = minimize(
        slope,
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=list(zip(least, most, strict=True)),
        options={"maxiter": STEPS, "ftol": tolerance / max(abs(best), 1.0)},
    )
    if not -float(end.fun) > best:
        return best, theta, own
    thetas, owns = points(end.x[None])
    return -float(end.fun), thetas[0], owns[0]
