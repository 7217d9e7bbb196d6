"""The Rao-Blackwellized particle filter; report, Algorithm 2."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.errors import OptionError
from engine.kernels import resampling as schemes
from engine.kernels.filtering import condition, predict, update
from engine.kernels.gaussian import psd_cholesky
from engine.model import Array, Gaussian, MixedModel, Theta, ThetaLike
from engine.proposals import Proposal, Step, bootstrap, get_proposal
from engine.series import Series

RESAMPLING: dict[str, Callable[[Array, Array], NDArray[np.int64]]] = {
    "multinomial": schemes.multinomial,
    "stratified": schemes.stratified,
    "systematic": schemes.systematic,
    "residual": schemes.residual,
}

COLLAPSED = 1.5  # an effective sample size below this means that one particle is left


@dataclass(frozen=True, eq=False)
class Filtered:
    """What a RBPF pass leaves behind, for reading and for the backward pass.

    For people: ``a`` (T, M, na), ``z`` (T, M, nz) and ``P`` (T, M, nz, nz) are z_{t|t} and P_{t|t} per
    particle; ``weights`` (T, M) before resampling; ``log_likelihood``; ``ess`` (T,) the effective
    sample size before resampling; ``collapsed`` the rows at which only one particle was left.

    For the backward pass, of the prediction from t to t+1, report, eq. (22): ``mu`` (T-1, M, nx),
    ``L`` (T-1, B, nx, nx) with L L' = Sigma, ``AP`` (T-1, B, nx, nz) = A P_{t|t}; ``cov`` (T, B, nz, nz) holds
    P with B = 1 where it is common to all particles; ``ancestors`` (T, M); and the model's
    matrices as they were evaluated: ``A``, ``Q``, ``h``, ``C``, ``R`` with a leading time axis, ``z1``, ``P1``.
    """

    model: MixedModel
    theta: Theta
    series: Series
    a: Array
    z: Array
    cov: Array
    weights: Array
    log_weights: Array
    log_likelihood: float
    log_likelihood_terms: Array
    ess: Array
    ancestors: NDArray[np.int64]
    mu: Array
    L: Array
    AP: Array
    A: Array
    Q: Array
    h: Array
    C: Array
    R: Array
    z1: Array
    P1: Array

    @property
    def P(self) -> Array:
        """P_{t|t}^i, (T, M, nz, nz); a read-only view where it is common to all particles."""
        T, _, nz, _ = self.cov.shape
        return np.broadcast_to(self.cov, (T, self.a.shape[1], nz, nz))

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


def rbpf(
    model: MixedModel,
    theta: ThetaLike,
    series: Series,
    n_particles: int,
    rng: np.random.Generator,
    proposal: str | Proposal = "adapted",
    resampling: str = "systematic",
    ess_threshold: float = 0.5,
) -> Filtered:
    """Filter a series with M = ``n_particles``; report, Algorithm 2.

    ``proposal``: "adapted" looks at y_t, "bootstrap" does not, or any function, see
    :mod:`engine.proposals`. ``resampling``: multinomial, stratified, systematic or residual, done
    when the effective sample size is at most ``ess_threshold`` * M (1: at every step, 0: never).
    Missing channels of y are left out of the update. Raises OptionError, SeriesError, ModelError.
    """
    theta = model.theta(theta)
    series.check(model)
    scheme = check_options(n_particles, resampling, ess_threshold)
    draw = get_proposal(proposal) if model.na else bootstrap
    M, T, record = n_particles, len(series), model.record(theta)
    y, u, times, steps = series.y, series.u, series.t.tolist(), series.steps.tolist()

    own: NDArray[np.int64] = np.arange(M)
    even = np.full(M, -np.log(M))
    log_w, w, ancestors = even, np.empty(M), own
    kept = _Kept(T, M)
    mu, L = np.empty((M, model.nx)), np.empty((1, model.nx, model.nx))
    step = Step(model, record, np.empty(0), np.empty(0), own, y[0], u[0], times[0], rng)
    a, z, P, log_ratio = _first(step, draw)
    z1, P1 = z, P

    for t in range(T):
        if t > 0:
            # 1. Sampling, 2. Prediction
            a, log_q = draw(Step(model, record, mu, L, ancestors, y[t], u[t], times[t], rng))
            z, P, log_p = condition(mu, L, ancestors, a)
            log_ratio = 0.0 if log_q is None else log_p - log_q

        # 3. Weighting, 4. Update of the linear states
        h, C, R = model.observation(a, u[t], times[t], record)
        C, R = stacked(C), stacked(R)
        z, P, log_y = update(z, P, h, C, R, y[t])
        log_w = log_w + log_y + log_ratio
        log_sum, ess = schemes.normalize(log_w, w)
        log_w = log_w - log_sum if np.isfinite(log_sum) else even
        kept(t, a=a, z=z, cov=P, weights=w, log_weights=log_w, ancestors=ancestors, h=h, C=C, R=R)
        kept(t, log_likelihood_terms=log_sum, ess=ess)
        if t == T - 1:
            break

        # 5. Resampling, and the prediction of each particle from which the next step starts
        if model.na and ess <= ess_threshold * M:
            ancestors = scheme(w, rng.random(M))
            log_w = even
        else:
            ancestors = own
        f, A, Q = model.transition(a, u[t], times[t], steps[t], record)
        A, Q = stacked(A), stacked(Q)
        mu, L, AP = predict(f, A, Q, z, P)
        kept(t, mu=mu, L=L, AP=AP, A=A, Q=Q)

    arrays = kept.arrays()
    log_likelihood = float(arrays["log_likelihood_terms"].sum())
    return Filtered(
        model=model,
        theta=theta,
        series=series,
        log_likelihood=log_likelihood,
        z1=z1,
        P1=P1,
        **arrays,
    )


def check_options(
    n_particles: int, resampling: str, ess_threshold: float
) -> Callable[[Array, Array], NDArray[np.int64]]:
    """The resampling function, after checking the options of the filter. Raises OptionError."""
    if int(n_particles) != n_particles or n_particles < 1:
        raise OptionError(
            f"n_particles = {n_particles}; a positive whole number is needed", "n_particles"
        )
    if resampling not in RESAMPLING:
        raise OptionError(
            f"resampling '{resampling}' is not known; use {', '.join(RESAMPLING)}", "resampling"
        )
    if not 0.0 <= ess_threshold <= 1.0:
        raise OptionError(
            f"ess_threshold = {ess_threshold} is not within [0, 1] (a share of n_particles)",
            "ess_threshold",
        )
    return RESAMPLING[resampling]


def _first(step: Step, draw: Proposal) -> tuple[Array, Array, Array, Any]:
    """a_1 from q(a_1 | y_1), its z_{1|0} and P_{1|0}, and log p(a_1) - log q(a_1)."""
    model, M = step.model, len(step.ancestors)
    start = model.start(step.theta)
    density = start.density
    log_ratio: Any = 0.0
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
    return a, z, stacked(P), log_ratio


def stacked(matrix: Array) -> Array:
    """(B, ., .) with B = 1 for a matrix common to all particles."""
    return matrix[None] if matrix.ndim == 2 else matrix


class _Kept:
    """Arrays with a leading time axis, allocated when their first row is known."""

    def __init__(self, T: int, M: int) -> None:
        self.T, self.M = T, M
        self.rows: dict[str, Any] = {}

    def __call__(self, t: int, **values: Any) -> None:
        for name, value in values.items():
            rows = self.rows.get(name)
            if rows is None:
                T = self.T - 1 if name in ("mu", "L", "AP", "A", "Q") else self.T
                dtype = np.int64 if name == "ancestors" else float
                rows = self.rows[name] = np.empty((T, *np.shape(value)), dtype=dtype)
            elif rows.ndim > 1 and rows.shape[1] == 1 < len(value):
                # common to all particles until now, and from here on no longer
                full = np.empty((len(rows), self.M, *rows.shape[2:]))
                full[:t] = rows[:t]
                rows = self.rows[name] = full
            rows[t] = value

    def arrays(self) -> dict[str, Any]:
        return self.rows
