"""Bootstrap particle filter and FFBSi for general models; poster, Schon, Wills, Ninness 2011."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.errors import SeriesError, check_count
from engine.filters.rbpf import COLLAPSED, check_options
from engine.kernels import resampling as schemes
from engine.kernels.categorical import pick_each
from engine.randomness import Rng, generator
from engine.statespace.base import Theta, ThetaLike
from engine.statespace.general import NonlinearModel, check_general
from engine.statespace.model import Array
from engine.views import Shown


@dataclass(frozen=True, eq=False)
class GeneralFiltered(Shown):
    """``x`` (T, M, nx), ``weights`` (T, M) before resampling, ``log_likelihood``, ``ess`` (T,).

    ``ancestors`` (T, M): the particle at t-1 from which each one at t was drawn.
    """

    model: NonlinearModel
    theta: Theta
    series: Series
    x: Array
    weights: Array
    log_weights: Array
    log_likelihood: float
    ess: Array
    ancestors: NDArray[np.int64]

    @property
    def collapsed(self) -> NDArray[np.intp]:
        """Rows at which the weights collapsed onto one particle (or none)."""
        return np.flatnonzero(self.ess < (COLLAPSED if self.x.shape[1] >= 4 else 0.5))

    def mean(self) -> Array:
        """Filtered mean (T, nx)."""
        return np.asarray(np.einsum("tm,tmx->tx", self.weights, self.x))


def filter_general(
    model: NonlinearModel,
    theta: ThetaLike,
    series: Series,
    n_particles: int,
    rng: Rng,
    resampling: str = "systematic",
    ess_threshold: float = 0.5,
) -> GeneralFiltered:
    """Filter a general model by the bootstrap particle filter (Gordon, Salmond, Smith 1993).

    A row of y is used whole or, where all of it is missing, not at all: the density of a part of e is not
    known.

    Parameters
    ----------
    model : NonlinearModel
        The model, poster, eq. (1).
    theta : Theta, mapping, array or None
        Parameters: all as (n_theta,), some by name, or None for the model's defaults.
    series : Series
        The data: y (T, ny) with NaN where missing, u (T, nu), times.
    n_particles : int
        Number of particles M.
    rng : numpy.random.Generator or int
        Source of all random numbers, or the seed of one.
    resampling : str
        ``multinomial``, ``stratified``, ``systematic``, ``residual`` or ``sorted``, as for :func:`rbpf`.
    ess_threshold : float
        Resample where the effective sample size is at most this share of M (1: at every step, 0: never).

    Returns
    -------
    GeneralFiltered
        Particles ``x`` (T, M, nx) with their weights, and the log-likelihood.

    Raises
    ------
    SeriesError
        A row has some channels missing, but not all.
    OptionError
        An option is not known or out of its range; ``field`` names it.
    ModelError
        A function of the model fails, or returns a wrong shape or covariance; names the function and the time.
    """
    rng = generator(rng)
    theta = model.theta(theta)
    check_rows(series.check(model))
    check_general(model, theta, series)
    resample = check_options(n_particles, resampling, ess_threshold)
    M, T, record = n_particles, len(series), model.record(theta)
    x = np.asarray(model.initial(record).sample(rng, M), dtype=float)
    points, weights, log_weights = np.empty((T, M, model.nx)), np.empty((T, M)), np.empty((T, M))
    ess, log_likelihood = np.empty(T), 0.0
    own: NDArray[np.int64] = np.arange(M)
    ancestors = np.tile(own, (T, 1))
    even = np.full(M, -np.log(M))
    log_w = even
    for t in range(T):
        u, time = series.u[t], float(series.t[t])
        points[t] = x
        if series.observed[t].all():
            log_y = model.log_measurement(series.y[t], x, u, time, record)
            log_w = log_w + np.where(np.isnan(log_y), -np.inf, log_y)
        total, ess[t] = schemes.normalize(log_w, weights[t])
        log_likelihood += total
        log_w = log_w - total if np.isfinite(total) else even
        log_weights[t] = log_w
        if t < T - 1:
            if ess[t] <= ess_threshold * M:
                ancestors[t + 1] = resample(weights[t], rng.random(M), x)
                x, log_w = x[ancestors[t + 1]], even
            x = model.draw_next(x, series.u_step[t], time, float(series.steps[t]), record, rng)
    return GeneralFiltered(
        model, theta, series, points, weights, log_weights, log_likelihood, ess, ancestors
    )


def smooth_general(filtered: GeneralFiltered, n_trajectories: int, rng: Rng) -> Array:
    """Draw trajectories of a general model by backward simulation, O(M N) per step.

    Parameters
    ----------
    filtered : GeneralFiltered
        A pass of :func:`filter_general`.
    n_trajectories : int
        Number of trajectories N that are drawn, each of weight 1/N.
    rng : numpy.random.Generator or int
        Source of all random numbers, or the seed of one.

    Returns
    -------
    array (T, N, nx)
        Draws of x_{1:T} given y_{1:T}.

    Raises
    ------
    OptionError
        ``n_trajectories`` is no positive whole number.
    """
    rng = generator(rng)
    check_count("n_trajectories", n_trajectories)
    model, series, x = filtered.model, filtered.series, filtered.x
    T, N, record = len(x), n_trajectories, model.record(filtered.theta)
    draws = np.empty((T, N, model.nx))
    i = schemes.stratified(filtered.weights[-1], rng.random(N))
    draws[-1] = x[-1][i]
    for t in range(T - 2, -1, -1):
        u, time, dt = series.u_step[t], float(series.t[t]), float(series.steps[t])
        f, g = model.transition(x[t], u, time, dt, record)
        log_p = model.log_transition(draws[t + 1][:, None], f, g, record)
        log_w = filtered.log_weights[t] + log_p
        picked = pick_each(log_w, rng.random(N))
        # no particle can have led there (noise-free states, rounding): its own past did
        i = np.where(picked < 0, filtered.ancestors[t + 1, i], picked)
        draws[t] = x[t][i]
    return draws


def check_rows(series: Series) -> None:
    """Raise SeriesError where a row has some of its channels, but not all."""
    partial = series.observed.any(axis=1) & ~series.observed.all(axis=1)
    if partial.any():
        raise SeriesError(
            f"row {int(np.argmax(partial))} of y has some channels missing, but not all; a general "
            "model needs whole rows: drop the row or fill the channel"
        )
