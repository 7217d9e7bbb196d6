"""The E step of PS-EM for general models: Q(theta, theta_k) from smoothed trajectories; poster."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.estimation.expectation import Ends, apart, beside
from engine.failing import where_it_fails
from engine.statespace.base import Array, Theta
from engine.statespace.general import NonlinearModel


@dataclass(frozen=True, eq=False)
class TrajectoryQ:
    """Q(theta, theta_k) = I_prior + I_pred + I_lh as averages over trajectories; poster.

    ``draws`` holds, for every series, trajectories (T, N, nx). Gradients are central differences of
    the log-densities, of all points at once; the scoring matrix is the outer product of the scores.
    """

    model: NonlinearModel
    draws: Sequence[tuple[Series, Array]]

    @where_it_fails(-np.inf)
    def value(self, theta: Array) -> float:
        """Q(theta, theta_k); -inf where the model cannot be had."""
        record = self.model.record(theta)
        total = sum(float(log_p.mean(axis=1).sum()) for log_p in self._log_densities(record))
        return total if np.isfinite(total) else -np.inf

    def derivatives(self, theta: Array, free: NDArray[np.intp]) -> tuple[float, Array, Array]:
        """Value, gradient (n,) and outer product of scores (n, n) in the n free parameters."""
        told = partial(self._derivatives, theta, free)
        return beside(self.model, self.value, theta, free, told)

    def _derivatives(
        self, theta: Array, free: NDArray[np.intp], ends: Ends
    ) -> tuple[float, Array, Array]:
        gradient, H = np.zeros(len(free)), np.zeros((len(free), len(free)))
        slopes = []
        for k, both in zip(free, ends, strict=True):
            pair = (self._log_densities(self.model.record(end)) for end in both)
            far = apart(*both, int(k))
            slopes.append([(b - a) / far for a, b in zip(*pair, strict=True)])
        for part in zip(*slopes, strict=True):
            scores = np.array(part)  # (n, T, N)
            gradient += scores.mean(axis=2).sum(axis=1)
            H += np.einsum("atj,btj->ab", scores, scores) / scores.shape[2]
        return self.value(theta), gradient, H

    def possible(self, theta: Array) -> bool:
        """Whether the densities can be had: they have no covariances."""
        return self.value(theta) > -np.inf

    def moves_noise_free(self, theta: Array, free: NDArray[np.intp]) -> NDArray[np.bool_]:
        """None (n,): a general model is given by densities, which have no such directions."""
        return np.zeros(len(free), dtype=bool)

    def _log_densities(self, record: Any) -> list[Array]:
        """log p(x_1) (1, N), log p(x_{t+1} | x_t) (T-1, N), log p(y_t | x_t) (T', N) of every series."""
        parts = []
        for series, x in self.draws:
            parts.append(self.model.initial(record).log_density(x[0])[None])
            parts.append(log_transitions(self.model, series, x, record))
            parts.append(log_outputs(self.model, series, x, record))
        return parts


def log_transitions(model: NonlinearModel, series: Series, x: Array, record: Any) -> Array:
    """log p(x_{t+1} | x_t) (T-1, N) along trajectories x (T, N, nx)."""
    T, N, nx = x.shape
    u, times = np.repeat(series.u_step[:-1].T, N, axis=1), np.repeat(series.t[:-1], N)
    dt: Any = series.dt if series.dt is not None else np.repeat(series.steps, N)
    f, g = model.transition(x[:-1].reshape(-1, nx), u, times, dt, record)
    return model.log_transition(x[1:].reshape(-1, nx), f, g, record).reshape(T - 1, N)


def log_outputs(model: NonlinearModel, series: Series, x: Array, record: Any) -> Array:
    """log p(y_t | x_t) (T', N) at the T' rows with a measurement."""
    rows = np.flatnonzero(series.observed.all(axis=1))
    N, nx = x.shape[1:]
    y = np.repeat(series.y[rows], N, axis=0)
    u, times = np.repeat(series.u[rows].T, N, axis=1), np.repeat(series.t[rows], N)
    log_p = model.log_measurement(y, x[rows].reshape(-1, nx), u, times, record)
    return log_p.reshape(len(rows), N)


def trajectory_q(
    model: NonlinearModel, theta: Theta, draws: Sequence[tuple[Series, Array]]
) -> TrajectoryQ:
    """The Q-function of trajectories drawn at theta."""
    model.transitions.look_again()
    model.observations.look_again()
    return TrajectoryQ(model, draws)
