"""Bootstrap particle filter and FFBSi on the full state x = (a, z), without Rao-Blackwellization.

The baselines of the report, section 6, and of PS-EM, paper, section V. A mixed model all of whose
states count as nonlinear is again a mixed model, so the filter is Algorithm 2 of the report with
nothing left to marginalize, and the smoother (Godsill, Doucet, West 2004) is Algorithm 3 with
empty z: the same kernels, one call for the whole backward pass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from engine.expectation import Moments
from engine.kernels.gaussian import log_normal_common, psd_cholesky
from engine.model import Array, Density, Gaussian, MixedModel, Start, Theta, ThetaLike
from engine.proposals import Proposal
from engine.rb_ffbsi import rb_ffbsi
from engine.rbpf import Filtered, rbpf
from engine.series import Series
from engine.simulate import noise, through


@dataclass(frozen=True, eq=False)
class ParticleFiltered:
    """What a particle filter leaves behind.

    ``x`` (T, M, nx) particles of x = (a, z) with ``weights`` (T, M) before resampling;
    ``log_likelihood``; ``ess`` (T,) effective sample size before resampling. ``model`` is the model it
    was asked for, ``filtered`` the pass of Algorithm 2 on the same model with empty z.
    """

    model: MixedModel
    filtered: Filtered

    @property
    def theta(self) -> Theta:
        """Parameters of the pass."""
        return self.filtered.theta

    @property
    def series(self) -> Series:
        """The data."""
        return self.filtered.series

    @property
    def x(self) -> Array:
        """Particles (T, M, nx)."""
        return self.filtered.a

    @property
    def a(self) -> Array:
        """Nonlinear states (T, M, na)."""
        return self.x[:, :, : self.model.na]

    @property
    def z(self) -> Array:
        """Linear states (T, M, nz)."""
        return self.x[:, :, self.model.na :]

    @property
    def weights(self) -> Array:
        """Normalized weights (T, M)."""
        return self.filtered.weights

    @property
    def log_likelihood(self) -> float:
        """Estimate of log p(y_{1:T})."""
        return self.filtered.log_likelihood

    @property
    def ess(self) -> Array:
        """Effective sample size (T,)."""
        return self.filtered.ess

    @property
    def collapsed(self) -> NDArray[np.intp]:
        """Rows at which the weights collapsed onto one particle."""
        return self.filtered.collapsed

    def mean(self) -> Array:
        """Filtered mean of x (T, nx)."""
        return self.filtered.mean()


@dataclass(frozen=True, eq=False)
class ParticleSmoothed:
    """N equally weighted draws ``trajectories`` (T, N, nx) of x_{1:T} given y_{1:T}.

    ``a`` (T, N, na) and ``z`` (T, N, nz) are its parts; ``index`` (T, N) the filter particle of each point.
    """

    filtered: ParticleFiltered
    trajectories: Array
    index: NDArray[np.int64]

    @property
    def a(self) -> Array:
        """Nonlinear states (T, N, na)."""
        return self.trajectories[:, :, : self.filtered.model.na]

    @property
    def z(self) -> Array:
        """Linear states (T, N, nz)."""
        return self.trajectories[:, :, self.filtered.model.na :]

    @property
    def moments(self) -> Moments:
        """The draws as the moments an E step takes: P = 0 and M = 0."""
        T, nz = len(self.trajectories), self.filtered.model.nz
        zero = np.zeros((T, 1, nz, nz))
        return Moments(self.a, self.z, zero, zero[1:])

    def mean(self) -> Array:
        """Smoothed mean of x (T, nx)."""
        return np.asarray(self.trajectories.mean(axis=1))

    def std(self) -> Array:
        """Smoothed standard deviation of x (T, nx)."""
        return np.asarray(self.trajectories.std(axis=1))


def particle_filter(
    model: MixedModel,
    theta: ThetaLike,
    series: Series,
    n_particles: int,
    rng: np.random.Generator,
    proposal: str | Proposal = "bootstrap",
    resampling: str = "multinomial",
    ess_threshold: float = 1.0,
) -> ParticleFiltered:
    """Bootstrap particle filter with M = ``n_particles`` on x = (a, z) (Gordon, Salmond, Smith 1993).

    The defaults are the report's, section 6: the transition density as proposal, and resampling at
    every time step. Options and errors as in :func:`engine.rbpf.rbpf`.
    """
    full = as_nonlinear(model)
    filtered = rbpf(full, theta, series, n_particles, rng, proposal, resampling, ess_threshold)
    return ParticleFiltered(model, filtered)


def ffbsi(
    filtered: ParticleFiltered, n_trajectories: int, rng: np.random.Generator
) -> ParticleSmoothed:
    """Draw N = ``n_trajectories`` trajectories of x by backward simulation (Godsill et al. 2004)."""
    draws = rb_ffbsi(filtered.filtered, n_trajectories, rng)
    return ParticleSmoothed(filtered, draws.a, draws.index)


def as_nonlinear(model: MixedModel) -> MixedModel:
    """The same model with x = (a, z) as its nonlinear state and no linear one; made once."""
    if model.nz == 0:
        return model
    if "nonlinear" not in model.derived:
        model.derived["nonlinear"] = _as_nonlinear(model)
    return cast(MixedModel, model.derived["nonlinear"])


def _as_nonlinear(model: MixedModel) -> MixedModel:
    na, empty = model.na, np.zeros((model.nx, 0))
    no_slope = np.zeros((model.ny, 0))

    def dynamics(x: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        f, A, Q = model.transition(np.ascontiguousarray(x[:, :na]), u, t, dt, theta)
        return f + through(A, x[:, na:]), empty, Q

    def measurement(x: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        h, C, R = model.observation(np.ascontiguousarray(x[:, :na]), u, t, theta)
        return h + through(C, x[:, na:]), no_slope, R

    def initial(theta: Any) -> tuple[Density, Any, Any]:
        return _joint_start(model.start(theta), na), np.zeros(0), np.zeros((0, 0))

    return replace(
        model,
        nonlinear={**model.nonlinear, **model.linear},
        linear={},
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
    )


@dataclass(frozen=True)
class JointStart:
    """p(x_1) = p(a_1) N(z_1; z_{1|0}(a_1), P_{1|0}(a_1)), report, eq. (1f)."""

    start: Start
    na: int

    def sample(self, rng: np.random.Generator, n: int) -> Array:
        """Draw (n, nx)."""
        a = np.asarray(self.start.density.sample(rng, n), dtype=float)
        z, P = self.start.linear(a)
        return np.concatenate([a, z + noise(P, z.shape, rng)], axis=1)

    def log_density(self, x: Array) -> Array:
        """Evaluate at x (M, nx) -> (M,); a direction without noise contributes nothing."""
        a, z = np.ascontiguousarray(x[:, : self.na]), x[:, self.na :]
        z1, P = self.start.linear(a)
        log_p = np.array(self.start.density.log_density(a), dtype=float)
        if P.ndim == 2:
            return np.asarray(
                log_p + log_normal_common(np.ascontiguousarray(z), z1, psd_cholesky(P))
            )
        for i, (row, mean, cov) in enumerate(zip(z, z1, P, strict=True)):
            log_p[i] += log_normal_common(row[None], mean[None], psd_cholesky(cov))[0]
        return log_p


def _joint_start(start: Start, na: int) -> Density:
    """A Gaussian where it is one, as proposals that look at y_1 can then use it."""
    if not isinstance(start.density, Gaussian) or callable(start.z1) or callable(start.P1):
        return JointStart(start, na)
    z, P = start.linear(np.zeros((1, na)))
    cov = np.zeros((na + start.nz, na + start.nz))
    cov[:na, :na] = start.density.cov
    cov[na:, na:] = P
    return Gaussian(np.concatenate([start.density.mean, z[0]]), cov)
