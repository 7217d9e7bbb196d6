"""PS-EM with a divergence check, on eq. (35) of the paper: Fig. 1 as reported.

The particle filter is that of :mod:`tests.studies.guarded`: bootstrap, multinomial resampling at every
step, and a measurement that all particles contradict is ignored. The backward simulation and the M step
are those of :func:`engine.ps_em`. One model, compiled, only for these studies: a run takes a tenth of the
time of the general method's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.data.series import Series
from engine.errors import OptionError
from engine.estimation.e_steps import EStep, Expect
from engine.estimation.em import EmResult
from engine.estimation.em_loop import Loop, iterate
from engine.filters.rbpf import COLLAPSED
from engine.kernels.backward import pick
from engine.kernels.resampling import multinomial
from engine.models import mixed_4
from engine.statespace.base import BaseModel
from engine.statespace.model import Array, MixedModel, Theta, ThetaLike
from tests.studies.guarded import GUARD
from tests.studies.stopped import stopping

NX = 4
Q = float(mixed_4.Q[0, 0])  # Q = 0.01 I and R = 0.1 I in eq. (35)
R = float(mixed_4.R[0, 0])


def guarded_ps_em(
    model: MixedModel,
    series: Series,
    theta0: ThetaLike = None,
    free: Sequence[str] | None = None,
    n_particles: int = 50,
    n_iterations: int = 100,
    seed: int = 0,
    *,
    guard: float = GUARD,
    m_step: str = "bfgs",
    m_step_iterations: int = 0,
) -> EmResult:
    """As :func:`engine.ps_em` with the paper's settings, but for the check; N = M = ``n_particles``.

    ``guard``: a measurement is ignored, all weights equal, where the sum of exp(-e' R^{-1} e / 2) over
    the particles is below; 0 never does. ``collapsed`` of the result counts ignored rows too.
    ``m_step_iterations`` of BFGS in each M step; 0 goes to the maximum by ``m_step``. Raises OptionError,
    also for any model but mixed-4.
    """
    expect = _guarded_step(model, series, n_particles, guard)
    if m_step_iterations:
        expect = stopping(expect, model, model.free_indices(free), m_step_iterations)
        m_step = "scoring"
    return iterate(
        model, expect, Loop(theta0, free, n_iterations, seed, m_step=m_step, tolerance=None)
    )


def _guarded_step(model: MixedModel, series: Series, n_particles: int, guard: float) -> Expect:
    if model.name != mixed_4.MODEL.name:
        raise OptionError(f"model '{model.name}': only mixed-4 is compiled here", "model")
    y, T, M = np.array(series.y), len(series), n_particles

    def expect(theta: Theta, rng: np.random.Generator) -> EStep:
        pasts, log_likelihood, lost = e_step(
            np.asarray(theta),
            y,
            guard,
            rng.standard_normal((T, NX, M)),
            rng.random((T, M)),
            rng.random((T, M)),
        )
        return EStep(Squares(model, *pasts), log_likelihood, float(M), lost / T)

    return expect


@dataclass(frozen=True, eq=False)
class Squares:
    """Q(theta, theta_k) of eq. (35) up to a constant, from the drawn trajectories.

    The transition is x_{t+1} = F(theta) phi(x_t) + w_t with phi = (arctan a, z), so Q is a function of
    the means over the trajectories of sum_t phi phi' (``past``), sum_t x_{t+1} phi' (``cross``) and
    sum_t x_{t+1}' x_{t+1} (``ahead``).
    """

    model: BaseModel
    past: Array
    cross: Array
    ahead: float

    def value(self, theta: Array) -> float:
        """Q at theta."""
        F = transition(theta)
        squares = self.ahead - 2.0 * np.sum(F * self.cross) + np.sum((F @ self.past) * F)
        return float(-0.5 * squares / Q)

    def derivatives(self, theta: Array, free: NDArray[np.intp]) -> tuple[float, Array, Array]:
        """Value, gradient (n,) and scoring matrix (n, n) in the n free parameters."""
        slopes = transition_slopes(theta)[free]
        residual = self.cross - transition(theta) @ self.past
        gradient = np.einsum("kij,ij->k", slopes, residual) / Q
        H = np.einsum("kij,jm,lim->kl", slopes, self.past, slopes) / Q
        return self.value(theta), gradient, H

    def possible(self, theta: Array) -> bool:
        """Always: its noise depends on no parameter."""
        return True

    def moves_noise_free(self, theta: Array, free: NDArray[np.intp]) -> NDArray[np.bool_]:
        """None (n,): eq. (35) has noise everywhere."""
        return np.zeros(len(free), dtype=bool)


def transition(theta: Array) -> Array:
    """F(theta) (4, 4), eqs. (35a)-(35b)."""
    th1, th2, th3, th4, th5 = theta.tolist()
    c, s = th4 * math.cos(th5), th4 * math.sin(th5)
    return np.array(
        [[th1, th2, 0.0, 0.0], [0.0, 1.0, th3, 0.0], [0.0, 0.0, c, -s], [0.0, 0.0, s, c]]
    )


def transition_slopes(theta: Array) -> Array:
    """Derivative of F by every parameter, (5, 4, 4)."""
    radius, c, s = float(theta[3]), math.cos(theta[4]), math.sin(theta[4])
    slopes = np.zeros((5, NX, NX))
    slopes[0, 0, 0] = slopes[1, 0, 1] = slopes[2, 1, 2] = 1.0
    slopes[3, 2:, 2:] = [[c, -s], [s, c]]
    slopes[4, 2:, 2:] = [[-radius * s, -radius * c], [radius * c, -radius * s]]
    return slopes


@njit(cache=True, error_model="numpy")
def e_step(
    theta: Array, y: Array, guard: float, noise: Array, uniforms: Array, backward: Array
) -> tuple[tuple[Array, Array, float], float, int]:
    """Filter y (T, 2) and draw as many trajectories backward as there are particles.

    noise (T, 4, M) ~ N(0, I), uniforms and backward (T, M) ~ U(0, 1) are the random numbers used.
    Returns (past, cross, ahead) of :class:`Squares`, the log-likelihood, and the number of rows at which
    the measurement was ignored or one particle was left.
    """
    T, nx, M = noise.shape
    x, f, angle = np.empty((T, nx, M)), np.empty((T, nx, M)), np.empty((T, M))
    log_w, w, raw = np.empty((T, M)), np.empty(M), np.empty(M)
    c, s = theta[3] * math.cos(theta[4]), theta[3] * math.sin(theta[4])
    width = math.sqrt(Q)
    log_likelihood, lost = 0.0, 0
    x[0] = 0.0
    x[0, 0] = noise[0, 0]
    for t in range(T):
        top = -np.inf
        for i in range(M):
            a = x[t, 0, i]
            e1 = y[t, 0] - 0.1 * a * abs(a)
            e2 = y[t, 1] - x[t, 1, i] + x[t, 2, i] - x[t, 3, i]
            raw[i] = -0.5 * (e1 * e1 + e2 * e2) / R
            top = max(top, raw[i])
        total, squares = 0.0, 0.0
        for i in range(M):
            w[i] = math.exp(raw[i] - top)
            total += w[i]
            squares += w[i] * w[i]
        log_sum = top + math.log(total)
        log_likelihood += log_sum - math.log(M) - math.log(2.0 * math.pi * R)
        ignored = guard > 0.0 and not log_sum > math.log(guard)
        if ignored or not total * total >= COLLAPSED * squares:
            lost += 1
        for i in range(M):
            w[i] = 1.0 / M if ignored else w[i] / total
            log_w[t, i] = math.log(w[i])
            angle[t, i] = math.atan(x[t, 0, i])
            f[t, 0, i] = theta[0] * angle[t, i] + theta[1] * x[t, 1, i]
            f[t, 1, i] = x[t, 1, i] + theta[2] * x[t, 2, i]
            f[t, 2, i] = c * x[t, 2, i] - s * x[t, 3, i]
            f[t, 3, i] = s * x[t, 2, i] + c * x[t, 3, i]
        ancestors = multinomial(w, uniforms[t])
        if t < T - 1:
            for k in range(nx):
                for i in range(M):
                    x[t + 1, k, i] = f[t, k, ancestors[i]] + width * noise[t + 1, k, i]
    # the last ancestors drawn are the particles at time T with which the trajectories end
    past, cross, ahead = np.zeros((nx, nx)), np.zeros((nx, nx)), 0.0
    level, phi, ends = np.empty(M), np.empty(nx), ancestors
    for t in range(T - 2, -1, -1):
        for j in range(M):
            now = x[t + 1, :, ends[j]]
            for i in range(M):
                level[i] = log_w[t, i]
            for k in range(nx):
                for i in range(M):
                    d = now[k] - f[t, k, i]
                    level[i] -= 0.5 * d * d / Q
            i = pick(level, w, backward[t, j])
            phi[:] = x[t, :, i]
            phi[0] = angle[t, i]
            for k in range(nx):
                ahead += now[k] * now[k]
                for m in range(nx):
                    past[k, m] += phi[k] * phi[m]
                    cross[k, m] += now[k] * phi[m]
            ends[j] = i
    return (past / M, cross / M, ahead / M), log_likelihood, lost
