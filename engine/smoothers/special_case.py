"""The special case of the report, section 5.4: a_{t+1} ~ p(a_{t+1} | a_t), an arbitrary density.

    a_{t+1} ~ p(a_{t+1} | a_t)                                             eq. (63a)
    z_{t+1} = f_z(a_t) + A_z(a_t) z_t + w_z,   y_t = h(a_t) + C(a_t) z_t + e_t      eqs. (63b)-(63e)

a does not feel z, so a drawn a_{t+1} tells nothing about z_t (W^a = 0, eq. (65a)), and the linear
states are smoothed by the Rauch-Tung-Striebel recursions, eqs. (66)-(68). With a Gaussian p(a_{t+1} | a_t)
this is Algorithms 2 and 3 with A_a = 0 and Q_az = 0; here p may be anything that can be drawn and
evaluated: a mixture, a heavy-tailed step, a Markov chain over a few values.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.errors import ModelError, check_count
from engine.filters.rbpf import Filtered, Predicted, Updated, check_options, over_time
from engine.kernels import resampling as schemes
from engine.kernels.categorical import pick_each
from engine.kernels.filtering import advance, predict, weigh
from engine.kernels.gaussian import log_normal_common, psd_cholesky_many
from engine.kernels.rts import gains, log_pairs, smooth_covariances
from engine.randomness import Rng, generator
from engine.smoothers.rb_ffbsi import Smoothed
from engine.statespace.checks import FIRST_Z, READING, STEP, possible_noise
from engine.statespace.model import Array, LinearGaussian, MixedModel, ThetaLike, stacked
from engine.statespace.shapes import squared, through
from engine.views import Shown


@dataclass(frozen=True, eq=False)
class SpecialCase(Shown):
    """A model whose nonlinear states a do not depend on z and may have any density; report, eq. (63).

    Parameters
    ----------
    model : MixedModel
        The model, of whose equations those of z and y are used; those of a are replaced by ``sample``.
    sample : callable
        ``sample(a, u, t, dt, theta, rng)`` draws a_{t+1} (M, na) for each row of a (M, na).
    log_density : callable
        ``log_density(a_next, a, u, t, dt, theta)`` evaluates log p(a_next | a) row by row,
        (K, na) -> (K,).
    """

    model: MixedModel
    sample: Callable[[Array, Any, float, float, Any, np.random.Generator], Array]
    log_density: Callable[[Array, Array, Any, float, float, Any], Array]

    def __post_init__(self) -> None:
        object.__setattr__(self, "model", _without_coupling(self.model))

    def linear(self, a: Array, u: Any, t: float, dt: float, theta: Any) -> LinearGaussian:
        """Evaluate f_z (M, nz), A_z (B, nz, nz) and Q_z (B, nz, nz) of eq. (63b) at particles a (M, na)."""
        f, A, Q = self.model.transition(a, u, t, dt, theta)
        Q = possible_noise(self.model, STEP, Q, t)
        na = self.model.na
        rows = np.ascontiguousarray
        return rows(f[:, na:]), rows(stacked(A)[:, na:]), rows(stacked(Q)[:, na:, na:])


def gaussian_case(model: MixedModel) -> SpecialCase:
    """The special case with a Gaussian p(a_{t+1} | a_t) = N(f_a(a_t), Q_a(a_t)); report, eq. (64).

    Parameters
    ----------
    model : MixedModel
        A model with A_a = 0 and Q_az = 0; :func:`rbpf_special` checks that where it evaluates the model.

    Returns
    -------
    SpecialCase
        The model with its density of a, for :func:`rbpf_special`.
    """
    na = model.na

    def sample(
        a: Array, u: Any, t: float, dt: float, theta: Any, rng: np.random.Generator
    ) -> Array:
        f, A, Q = model.transition(a, u, t, dt, theta)
        if np.any(A[..., :na, :]) or np.any(Q[..., :na, na:]):
            raise ModelError(
                f"model '{model.name}' is not a special case: A_a and Q_az must be zero; use rbpf"
            )
        Q = possible_noise(model, STEP, Q, t)
        L = psd_cholesky_many(np.ascontiguousarray(stacked(Q)[:, :na, :na]))
        return f[:, :na] + through(L if len(L) > 1 else L[0], rng.standard_normal((len(a), na)))

    def log_density(a_next: Array, a: Array, u: Any, t: float, dt: float, theta: Any) -> Array:
        f, _, Q = model.transition(a, u, t, dt, theta)
        mean = np.ascontiguousarray(f[:, :na])
        L = psd_cholesky_many(np.ascontiguousarray(stacked(Q)[:, :na, :na]))
        if len(L) == 1:
            return np.asarray(log_normal_common(a_next, mean, L[0]))
        each = zip(a_next, mean, L, strict=True)
        return np.array([log_normal_common(x[None], m[None], factor)[0] for x, m, factor in each])

    return SpecialCase(model, sample, log_density)


@dataclass(frozen=True, eq=False)
class SpecialFiltered(Filtered):
    """As :class:`engine.filters.rbpf.Filtered`, with mu = z_{t+1|t}, L L' = P_{t+1|t}, V L' = P_{t|t} A_z'."""

    case: SpecialCase


def rbpf_special(
    case: SpecialCase,
    theta: ThetaLike,
    series: Series,
    n_particles: int,
    rng: Rng,
    resampling: str = "systematic",
    ess_threshold: float = 0.5,
) -> SpecialFiltered:
    """Filter with particles drawn from p(a_{t+1} | a_t); report, Algorithm 2 for eq. (63).

    Parameters
    ----------
    case : SpecialCase
        The model with its density of a.
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
    SpecialFiltered
        Particles with moments of z, their weights and the log-likelihood, as :func:`rbpf` returns them.

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
    model = case.model
    theta = model.theta(theta)
    series.check(model).alone()
    resample = check_options(n_particles, resampling, ess_threshold)
    M, T, record = n_particles, len(series), model.record(theta)
    own: NDArray[np.int64] = np.arange(M)
    even, nothing, none = np.full(M, -np.log(M)), np.zeros(M), np.empty((M, 0))
    ancestors, y = own, np.array(series.y)
    start = model.start(record)
    a = np.asarray(start.density.sample(rng, M), dtype=float)
    updated: list[Updated] = []
    predicted: list[Predicted] = []
    log_w, mu, L = even, none, np.empty((1, 0, 0))
    for t in range(T):
        time = float(series.t[t])
        h, C, R = model.observation(a, series.u[t], time, record)
        R = possible_noise(model, READING, R, time)
        if t == 0:
            z, P = start.linear(a)
            P = possible_noise(model, FIRST_Z, P, time)
            z, Z, log_w, w, log_sum, ess = weigh(
                z, psd_cholesky_many(stacked(P)), nothing, h, stacked(C), stacked(R), y[0], even
            )
        else:
            z, Z, log_w, w, log_sum, ess = advance(
                mu, L, ancestors, none, nothing, True, h, stacked(C), stacked(R), y[t], log_w
            )
        updated.append(Updated(a, z, Z, w, log_w, log_sum, ess, ancestors))
        if t == T - 1:
            break
        ancestors, u, dt = own, series.u_step[t], float(series.steps[t])
        if ess <= ess_threshold * M:
            ancestors, log_w = resample(w, rng.random(M), np.hstack((a, z))), even
        predicted.append(Predicted(*predict(*case.linear(a, u, time, dt, record), z, Z)))
        mu, L = predicted[-1][:2]
        a = np.ascontiguousarray(
            case.sample(np.ascontiguousarray(a[ancestors]), u, time, dt, record, rng), dtype=float
        )
    rows = {**over_time(updated), **over_time(predicted)}
    return SpecialFiltered(model, theta, series, **rows, case=case)


def rb_ffbsi_special(
    filtered: SpecialFiltered, n_trajectories: int, rng: Rng, joint: bool = False
) -> Smoothed:
    """Draw backward trajectories, z smoothed in RTS form; report, eqs. (66)-(68).

    Backward weights are w_t^i p(a~_{t+1} | a_t^i) N(z~_{t+1}; z^i_{t+1|t}, P^i_{t+1|t}), from eq. (69).

    Parameters
    ----------
    filtered : SpecialFiltered
        A pass of :func:`rbpf_special`.
    n_trajectories : int
        Number of trajectories N that are drawn, each of weight 1/N.
    rng : numpy.random.Generator or int
        Source of all random numbers, or the seed of one.
    joint : bool
        Whether drawn z~ are chained into whole trajectories of (a, z), as for :func:`rb_ffbsi`.

    Returns
    -------
    Smoothed
        ``a`` (T, N, na) with moments of z, under Approximations 1 and 2 of the report.

    Raises
    ------
    OptionError
        ``n_trajectories`` is no positive whole number.
    """
    rng = generator(rng)
    check_count("n_trajectories", n_trajectories)
    case, series = filtered.case, filtered.series
    record = case.model.record(filtered.theta)
    T, M, na = filtered.a.shape
    N, nz = n_trajectories, filtered.z.shape[2]
    common = filtered.root.shape[1] == filtered.L.shape[1] == 1
    B = 1 if common else N
    index = np.empty((T, N), dtype=np.int64)
    a, z, draws = np.empty((T, N, na)), np.empty((T, N, nz)), np.empty((T, N, nz))
    P, cross = np.empty((T, B, nz, nz)), np.empty((T - 1, B, nz, nz))
    index[-1] = schemes.stratified(filtered.weights[-1], rng.random(N))
    uniforms, noise = rng.random((T - 1, N)), rng.standard_normal((T, N, nz))
    a[-1], z[-1] = filtered.a[-1, index[-1]], filtered.z[-1, index[-1]]
    last = _of(filtered.root[-1], index[-1], common)
    P[-1] = squared(last)
    D = np.tile(np.eye(nz), (B, 1, 1))
    draws[-1] = z[-1] + _times(last, noise[-1])
    for t in range(T - 2, -1, -1):
        dt = float(series.steps[t])
        log_a = case.log_density(
            np.repeat(a[t + 1], M, axis=0),
            np.tile(filtered.a[t], (N, 1)),
            series.u_step[t],
            float(series.t[t]),
            dt,
            record,
        )
        log_w = log_pairs(draws[t + 1], filtered.mu[t], filtered.L[t])
        log_w += filtered.log_weights[t] + np.asarray(log_a).reshape(N, M)
        i = pick_each(log_w, uniforms[t])
        lost = i < 0  # noise-free states: only the particle's own past leads to it
        i[lost] = filtered.ancestors[t + 1, index[t + 1, lost]]
        index[t], a[t] = i, filtered.a[t, i]

        # Approximation 1: the moments of particle i, whose past need not be that of a~_{1:t}
        L, V, plus = (_of(m[t], i, common) for m in (filtered.L, filtered.V, filtered.root_plus))
        gain = gains(L, V)  # T_t, eq. (66c)
        # eqs. (68b)-(68c), here Approximation 2: P_{t|t} - T P_{t+1|t} T' is what x_{t+1} leaves of z_t
        Z, Z_next = (_of(filtered.root[s], index[s], common) for s in (t, t + 1))
        P[t], cross[t], D = smooth_covariances(Z, L, V, plus, Z_next, D)
        z_f, ahead = filtered.z[t, i], filtered.mu[t, i]
        z[t] = z_f + _times(gain, z[t + 1] - ahead)  # eq. (68a)
        if joint:
            mean = z_f + _times(gain, draws[t + 1] - ahead)
            draws[t] = mean + _times(plus, noise[t])
        else:
            draws[t] = z[t] + _times(psd_cholesky_many(np.ascontiguousarray(P[t])), noise[t])
    trajectories = np.concatenate([a, draws], axis=2) if joint else None
    return Smoothed(filtered, a, z, P, cross, index, trajectories)


def _without_coupling(model: MixedModel) -> MixedModel:
    """The model with the rows of a made empty of z: A_a = 0, Q_az = 0 (f_a = 0, Q_a = I).

    What conditions z on whole trajectories of a then finds nothing in the steps of a, as it should.
    """
    na = model.na

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        f, A, Q = (np.array(part) for part in model.transition(a, u, t, dt, theta))
        f[:, :na] = 0.0
        A[..., :na, :] = 0.0
        Q[..., :na, :] = Q[..., :, :na] = 0.0
        Q[..., range(na), range(na)] = 1.0
        return f, A, Q

    return replace(model, dynamics=dynamics)


def _of(matrices: Array, i: NDArray[np.int64], common: bool) -> Array:
    """Those of particles i: (1, ., .) where all are common, else (N, ., .)."""
    if common:
        return matrices
    return np.ascontiguousarray(
        np.broadcast_to(matrices, (len(i), *matrices.shape[1:]))
        if len(matrices) == 1
        else matrices[i]
    )


def _times(A: Array, x: Array) -> Array:
    return through(A if len(A) > 1 else A[0], x)
