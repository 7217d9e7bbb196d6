"""The Rao-Blackwellized particle filter; report, Algorithm 2."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from engine.data.given import one_series
from engine.data.series import Series
from engine.errors import OptionError, check_count
from engine.filters.lost import few_in_words, left_in_words, lost_in_words
from engine.filters.proposals import Proposal, Step, bootstrap, get_proposal
from engine.filters.taped_particles import rows_by_tape
from engine.kernels import resampling as schemes
from engine.kernels.curve import along_curve
from engine.kernels.filtering import advance, predict, weigh
from engine.kernels.gaussian import psd_cholesky, psd_cholesky_many
from engine.randomness import Rng, generator
from engine.statespace.checks import (
    FIRST_A,
    FIRST_Z,
    READING,
    STEP,
    check_readings,
    check_start,
    possible_noise,
)
from engine.statespace.first_state import moments_of_first
from engine.statespace.model import Array, Gaussian, MixedModel, Theta, ThetaLike, stacked
from engine.statespace.refutation import repeated_if_refuted
from engine.statespace.shapes import squared
from engine.threads import single_threaded
from engine.views import Shown, View, sheet, tables

RESAMPLING: dict[str, Callable[[Array, Array], NDArray[np.int64]]] = {
    "multinomial": schemes.multinomial,
    "stratified": schemes.stratified,
    "systematic": schemes.systematic,
    "residual": schemes.residual,
    "sorted": schemes.systematic,
}
Resample: TypeAlias = Callable[[Array, Array, Array], NDArray[np.int64]]

FIRST_DRAWS = 16  # of a first density that is no Gaussian, for each particle
COLLAPSED = 1.5  # an effective sample size below this means that one particle is left


@dataclass(frozen=True, eq=False)
class Filtered(Shown):
    """The result of :func:`rbpf`, with what a backward pass needs.

    Arrays have B = 1 where a matrix is common to all particles, and B = M otherwise.

    Attributes
    ----------
    model : MixedModel
        The model that was filtered with.
    theta : Theta
        Parameters (n_theta,) of the pass.
    series : Series
        The data that were filtered.
    a : array (T, M, na)
        Particles of the nonlinear states.
    z : array (T, M, nz)
        Means z_{t|t} of the linear states given each particle.
    root : array (T, B, nz, nz)
        Lower roots of the covariances P_{t|t} of z given each particle; ``cov`` are these, ``P``
        (T, M, nz, nz) their full view.
    weights, log_weights : array (T, M)
        Normalised weights before resampling, and their logarithms.
    log_likelihood_terms : array (T,)
        Estimates of log p(y_t | y_{1:t-1}); ``log_likelihood`` is their sum.
    ess : array (T,)
        Effective sample size before resampling; ``collapsed`` are the rows at which one particle was left.
    ancestors : array (T, M)
        From which particle of t - 1 each was drawn.
    mu : array (T-1, M, nx)
        Means of the prediction from t to t + 1, report, eq. (22).
    L : array (T-1, B, nx, nx)
        Roots of its covariances, L L' = Sigma.
    V : array (T-1, B, nz, nx)
        V L' = P_{t|t} A', which the backward pass uses; ``AP`` is A P_{t|t}.
    root_plus : array (T-1, B, nz, nz)
        Lower roots of the covariances of z_t given x_{t+1}.
    """

    model: MixedModel
    theta: Theta
    series: Series
    a: Array
    z: Array
    root: Array
    weights: Array
    log_weights: Array
    log_likelihood_terms: Array
    ess: Array
    ancestors: NDArray[np.int64]
    mu: Array
    L: Array
    V: Array
    root_plus: Array

    @property
    def log_likelihood(self) -> float:
        """Estimate of log p(y_{1:T})."""
        return float(self.log_likelihood_terms.sum())

    @cached_property
    def cov(self) -> Array:
        """P_{t|t}, (T, B, nz, nz)."""
        return squared(self.root)

    @property
    def AP(self) -> Array:
        """A P_{t|t}, (T-1, B, nx, nz)."""
        return np.asarray(self.L @ np.swapaxes(self.V, 2, 3))

    @property
    def P(self) -> Array:
        """P_{t|t}^i, (T, M, nz, nz); a read-only view where it is common to all particles."""
        T, _, nz, _ = self.cov.shape
        return np.broadcast_to(self.cov, (T, self.a.shape[1], nz, nz))

    @cached_property
    def note(self) -> str:
        """What says that particles lost the series, by the moment filter or their weights, or are few."""
        ess = float(np.mean(self.ess))
        lost = lost_in_words(self.model, self.theta, self.series, self.log_likelihood, ess)
        rows = self.collapsed
        left = left_in_words(self.series.t[rows].tolist(), self.ess[rows].tolist())
        few = few_in_words(self.a, self.series.t.tolist())
        return " ".join(filter(None, (lost, left, few)))

    @property
    def collapsed(self) -> NDArray[np.intp]:
        """Rows t at which the weights collapsed onto one particle (or none)."""
        if self.a.shape[1] < 4 or self.model.na == 0:
            return np.flatnonzero(self.ess <= 0.0)
        return np.flatnonzero(self.ess < COLLAPSED)

    def mean(self) -> Array:
        """Filtered mean of x = (a, z), (T, nx)."""
        mean: Array = np.einsum(
            "tm,tmx->tx", self.weights, np.concatenate([self.a, self.z], axis=2)
        )
        return mean

    def _view(self) -> View:
        model, M = self.model, self.a.shape[1]
        least = int(np.argmin(self.ess))
        units = {**model.nonlinear, **model.linear}
        ends = zip(*(f(self.mean(), axis=0).tolist() for f in (np.min, np.max)), strict=True)
        rows = [(name, *row, unit) for (name, unit), row in zip(units.items(), ends, strict=True)]
        return sheet(
            f"{model.name}: {len(self.a)} samples filtered by {M} particles",
            tables().line(f"Log-likelihood {self.log_likelihood:.2f}"),
            tables().line(
                f"Effective sample size {np.mean(self.ess):.3g} in the mean, at the least "
                f"{self.ess[least]:.2g} at t = {self.series.t[least]:g}"
            ),
            tables().line(self.note),
            tables().table(("state", "least mean", "largest mean", "unit"), rows),
        )


class Updated(NamedTuple):
    """One row of :class:`Filtered`, once y_t is known."""

    a: Array
    z: Array
    root: Array
    weights: Array
    log_weights: Array
    log_likelihood_terms: float
    ess: float
    ancestors: NDArray[np.int64]


class Predicted(NamedTuple):
    """The prediction of the next one, report, eq. (22)."""

    mu: Array
    L: Array
    V: Array
    root_plus: Array


@single_threaded
@repeated_if_refuted
def rbpf(
    model: MixedModel,
    theta: ThetaLike,
    series: Series,
    n_particles: int,
    rng: Rng,
    proposal: str | Proposal = "adapted",
    resampling: str = "systematic",
    ess_threshold: float = 0.5,
) -> Filtered:
    """Filter a series by the Rao-Blackwellized particle filter; report, Algorithm 2.

    Missing channels of y are left out of the update.

    Parameters
    ----------
    model : MixedModel
        The model, paper, eq. (1).
    theta : Theta, mapping, array or None
        Parameters: all as (n_theta,), some by name, or None for the model's defaults.
    series : Series
        The data: y (T, ny) with NaN where missing, u (T, nu), times.
    n_particles : int
        Number of particles M.
    rng : numpy.random.Generator or int
        Source of all random numbers, or the seed of one.
    proposal : str or callable
        Density that new particles are drawn from: ``adapted`` uses y_t, ``bootstrap`` does not; or a function
        of a :class:`engine.filters.proposals.Step` that returns draws (M, na) and their log-densities (M,).
    resampling : str
        ``multinomial``, ``stratified``, ``systematic``, ``residual``, or ``sorted``: systematic, of particles
        in the order of their predictions along a curve (Malik, Pitt 2011; Gerber, Chopin 2015). With
        ``ess_threshold=1`` and the same random numbers its log-likelihood is nearly smooth in theta.
    ess_threshold : float
        Resample where the effective sample size is at most this share of M (1: at every step, 0: never).

    Returns
    -------
    Filtered
        Particles ``a`` (T, M, na) with ``z`` (T, M, nz) and ``P``, their weights, and the log-likelihood.

    Raises
    ------
    OptionError
        An option is not known or out of its range; ``field`` names it.
    SeriesError
        Channels or units are not the model's, or nothing was measured; names the channel.
    ModelError
        A function of the model fails, or returns a wrong shape or covariance; names the function and the time.
    """
    rng = generator(rng)
    series = one_series(series, model)
    theta = model.theta(theta)
    check_start(model, theta, series)
    resample = check_options(n_particles, resampling, ess_threshold)
    draw = get_proposal(proposal) if model.na else bootstrap
    M, T, record = n_particles, len(series), model.record(theta)
    y, u, times, steps = np.array(series.y), series.u, series.t.tolist(), series.steps.tolist()

    own: NDArray[np.int64] = np.arange(M)
    even = np.full(M, -np.log(M))
    nothing = np.zeros(M)
    log_w, ancestors, mu, L = even, own, np.empty((M, 0)), np.empty((1, 0, 0))
    updated: list[Updated] = []
    predicted: list[Predicted] = []
    for t in range(T):
        # 1. Sampling, 2. Prediction, 3. Weighting, 4. Update of the linear states
        if t == 0:
            many = np.arange(M * _draws_of_first(model, record, draw))
            step = Step(model, record, mu, L, many, y[0], u[0], times[0], rng)
            a, z, Z, log_ratio = _first(step, draw)
            h, C, R = model.observation(a, u[0], times[0], record)
            C, R = stacked(C), stacked(possible_noise(model, READING, R, times[0]))
            if model.na:
                check_readings(model, C, R, y)
            alike = np.full(len(many), -np.log(len(many)))
            z, Z, log_w, w, log_sum, ess = weigh(z, Z, log_ratio, h, C, R, y[0], alike)
            if len(many) > M:
                kept = resample(w, rng.random(M), a)
                a, z, Z = a[kept], z[kept], Z[kept] if len(Z) > 1 else Z
                log_w, w, ess = even, np.exp(even), min(ess, float(M))
        else:
            a, log_q = draw(Step(model, record, mu, L, ancestors, y[t], u[t], times[t], rng))
            a = np.ascontiguousarray(a)
            blind = log_q is None
            h, C, R = model.observation(a, u[t], times[t], record)
            R = possible_noise(model, READING, R, times[t])
            z, Z, log_w, w, log_sum, ess = advance(
                mu,
                L,
                ancestors,
                a,
                nothing if blind else log_q,
                blind,
                h,
                stacked(C),
                stacked(R),
                y[t],
                log_w,
            )
        updated.append(Updated(a, z, Z, w, log_w, log_sum, ess, ancestors))
        if t == 0:
            given = draw, resampling, ess_threshold, rng
            if taped := rows_by_tape(model, theta, series, updated[0], *given):
                rows, predictions = taped
                return Filtered(model, theta, series, *rows, *predictions)
        if t == T - 1:
            break

        # 5. Resampling, and the prediction of each particle from which the next step starts
        if t + 1 in series.begins:
            mean, Q = moments_of_first(model, record)
            f, A = np.repeat(mean[None], M, axis=0), np.zeros((1, model.nx, model.nz))
        else:
            f, A, Q = model.transition(a, series.u_step[t], times[t], steps[t], record)
            Q = possible_noise(model, STEP, Q, times[t])
        predicted.append(Predicted(*predict(f, stacked(A), stacked(Q), z, Z)))
        mu, L = predicted[-1][:2]
        if model.na and ess <= ess_threshold * M:
            ancestors = resample(w, rng.random(M), mu)
            log_w = even
        else:
            ancestors = own
    return Filtered(model, theta, series, **over_time(updated), **over_time(predicted))


def check_options(n_particles: int, resampling: str, ess_threshold: float) -> Resample:
    """Ancestors (M,) by weights, uniform numbers (both (M,)) and predictions (M, n). Raises OptionError."""
    check_count("n_particles", n_particles)
    if resampling not in RESAMPLING:
        raise OptionError(
            f"resampling '{resampling}' is not known; use {', '.join(RESAMPLING)}", "resampling"
        )
    if not 0.0 <= ess_threshold <= 1.0:
        raise OptionError(
            f"ess_threshold = {ess_threshold} is not within [0, 1] (a share of n_particles)",
            "ess_threshold",
        )
    scheme = RESAMPLING[resampling]
    if resampling != "sorted":
        return lambda w, u, _: scheme(w, u)

    def along(w: Array, u: Array, mu: Array) -> NDArray[np.int64]:
        order = along_curve(mu)
        return np.asarray(order[scheme(w[order], u)])

    return along


def _draws_of_first(model: MixedModel, record: Any, draw: Proposal) -> int:
    """How many draws of a_1 there are to choose a particle from by the first reading.

    No proposal looks at it where the density is no Gaussian, and few draws of a wide one are near it.
    """
    blind = draw is bootstrap or isinstance(model.start(record).density, Gaussian)
    return 1 if blind else FIRST_DRAWS


def _first(step: Step, draw: Proposal) -> tuple[Array, Array, Array, Array]:
    """a_1 from q(a_1 | y_1), its z_{1|0} and the root of P_{1|0}, and log p(a_1) - log q(a_1)."""
    model, M = step.model, len(step.ancestors)
    start = model.start(step.theta)
    density = start.density
    if isinstance(density, Gaussian):
        possible_noise(model, FIRST_A, density.cov, step.t)
    log_ratio = np.zeros(M)
    if draw is bootstrap or not isinstance(density, Gaussian):
        a = np.asarray(density.sample(step.rng, M), dtype=float)
    else:
        mean = np.repeat(density.mean[None], M, axis=0)
        z, P = start.linear(mean)
        L = np.zeros((1, model.nx, model.nx))
        L[0, : model.na, : model.na] = psd_cholesky(density.cov)
        L[0, model.na :, model.na :] = psd_cholesky(P if P.ndim == 2 else P[0])
        a, log_q = draw(replace(step, mu=np.concatenate([mean, z], axis=1), L=L))
        if log_q is not None:
            log_ratio = density.log_density(a) - log_q
    z, P = start.linear(a)
    P = possible_noise(model, FIRST_Z, P, step.t)
    return a, z, psd_cholesky_many(stacked(P)), log_ratio


def over_time(rows: Sequence[Any]) -> dict[str, Any]:
    """{field: values (T, ...)} of named tuples; what is common to all particles at some rows is repeated."""
    columns = map(_stacked, zip(*rows, strict=True))
    return dict(zip(rows[0]._fields, columns, strict=True))


def _stacked(rows: Sequence[Any]) -> Array:
    first = rows[0]
    if isinstance(first, np.ndarray) and first.size:
        # as memory, which takes a third of the time; rows of other sizes or layouts do not fit
        with suppress(TypeError, ValueError):
            every = np.frombuffer(bytearray().join(rows), first.dtype)
            return every.reshape(len(rows), *first.shape)
    try:
        return np.array(rows)
    except ValueError:
        shape = max(row.shape for row in rows)
        return np.array([np.broadcast_to(row, shape) for row in rows])
