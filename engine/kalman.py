"""The exact Kalman filter and RTS smoother for linear Gaussian models: the oracle of the tests.

Written in plain NumPy from the textbook formulas, independently of the kernels it checks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from engine import plots
from engine.errors import ModelError
from engine.model import Array, Gaussian, MixedModel, Theta, ThetaLike
from engine.model_check import check_start
from engine.series import Series


@dataclass(frozen=True, eq=False)
class KalmanSmoothed:
    """Exact moments of x = (a, z).

    ``x`` (T, nx) and ``P`` (T, nx, nx) smoothed; ``M`` (T-1, nx, nx) = Cov(x_t, x_{t+1} | y_{1:T});
    ``x_filtered``, ``P_filtered`` given y_{1:t}; ``x_predicted``, ``P_predicted`` given y_{1:t-1};
    ``log_likelihood``.
    """

    model: MixedModel
    theta: Theta
    x: Array
    P: Array
    M: Array
    x_filtered: Array
    P_filtered: Array
    x_predicted: Array
    P_predicted: Array
    log_likelihood: float

    @property
    def a(self) -> Array:
        """Smoothed mean of a (T, na)."""
        return self.x[:, : self.model.na]

    @property
    def z(self) -> Array:
        """Smoothed mean of z (T, nz)."""
        return self.x[:, self.model.na :]

    def plot(self, series: Series) -> plots.Figures:
        """``states`` with 95 % bands over the times of the series smoothed; extra ``plot``."""
        units = {**self.model.nonlinear, **self.model.linear}
        sd = np.sqrt(np.maximum(np.diagonal(self.P, axis1=1, axis2=2), 0.0))
        return plots.Figures(states=plots.states(series.t, units, self.x, sd))


@dataclass(frozen=True)
class LinearStep:
    """x' = f + F x + w, w ~ N(0, Q);  y = h + H x + e, e ~ N(0, R), at one time step."""

    f: Array
    F: Array
    Q: Array
    h: Array
    H: Array
    R: Array


def linear_step(model: MixedModel, record: Any, u: Array, t: float, dt: float) -> LinearStep:
    """The model's matrices on x = (a, z). Raises ModelError where it is not linear in a."""
    na, nx = model.na, model.nx
    rng = np.random.default_rng(20)
    corners = np.concatenate([np.zeros((1, na)), np.eye(na), 3.0 * rng.standard_normal((2, na))])
    f, A, Q = model.transition(corners, u, t, dt, record)
    h, C, R = model.observation(corners, u, t, record)
    for name, matrix in (("A", A), ("Q", Q), ("C", C), ("R", R)):
        if matrix.ndim == 3 and np.abs(matrix - matrix[:1]).max(initial=0.0) > 1e-12:
            raise ModelError(f"model '{model.name}' is not linear Gaussian: {name} depends on a")
    A, Q, C, R = (m[0] if m.ndim == 3 else m for m in (A, Q, C, R))
    Fa, Ha = (f[1 : na + 1] - f[0]).T, (h[1 : na + 1] - h[0]).T
    for name, value, slope in (("f", f, Fa), ("h", h, Ha)):
        if not np.allclose(value, value[0] + corners @ slope.T, rtol=1e-9, atol=1e-9):
            raise ModelError(
                f"model '{model.name}' is not linear Gaussian: {name} is not affine in a"
            )
    F = np.concatenate([Fa, A], axis=1).reshape(nx, nx)
    H = np.concatenate([Ha, C], axis=1).reshape(model.ny, nx)
    return LinearStep(f[0], F, Q, h[0], H, R)


def linear_start(model: MixedModel, record: Any) -> tuple[Array, Array]:
    """Mean (nx,) and covariance (nx, nx) of x_1. Raises ModelError where it is not Gaussian."""
    start = model.start(record)
    if not isinstance(start.density, Gaussian):
        raise ModelError(f"model '{model.name}' is not linear Gaussian: p(a_1) is not a Gaussian")
    na = model.na
    corners = np.concatenate([np.zeros((1, na)), np.eye(na)])
    z, P1 = start.linear(corners)
    if P1.ndim == 3:
        if np.abs(P1 - P1[:1]).max() > 1e-12:
            raise ModelError(f"model '{model.name}' is not linear Gaussian: P1 depends on a_1")
        P1 = P1[0]
    slope = (z[1:] - z[0]).T  # z_1 may be affine in a_1
    mean = np.concatenate([start.density.mean, z[0] + slope @ start.density.mean])
    Pa = start.density.cov
    P = np.block([[Pa, Pa @ slope.T], [slope @ Pa, slope @ Pa @ slope.T + P1]])
    return mean, P.reshape(model.nx, model.nx)


def kalman_smoother(model: MixedModel, theta: ThetaLike, series: Series) -> KalmanSmoothed:
    """Kalman filter and Rauch-Tung-Striebel smoother; missing channels are left out.

    Raises ModelError where the model is not linear Gaussian in x = (a, z) at this theta.
    """
    theta = model.theta(theta)
    check_start(model, theta, series.check(model))
    record = model.record(theta)
    T, nx = len(series), model.nx
    x_p, x_f = np.empty((T, nx)), np.empty((T, nx))
    P_p, P_f = np.empty((T, nx, nx)), np.empty((T, nx, nx))
    F = np.empty((T - 1, nx, nx))
    log_likelihood = 0.0
    x, P = linear_start(model, record)
    for t in range(T):
        dt = float(series.steps[min(t, T - 2)])
        step = linear_step(model, record, series.u[t], float(series.t[t]), dt)
        x_p[t], P_p[t] = x, P
        there = series.observed[t]
        if there.any():
            H, R = step.H[there], step.R[np.ix_(there, there)]
            nu = series.y[t, there] - step.h[there] - H @ x
            S = H @ P @ H.T + R
            K = np.linalg.solve(S, H @ P).T
            x = x + K @ nu
            J = np.eye(nx) - K @ H
            P = J @ P @ J.T + K @ R @ K.T
            log_likelihood -= 0.5 * float(
                np.linalg.slogdet(2.0 * np.pi * S)[1] + nu @ np.linalg.solve(S, nu)
            )
        x_f[t], P_f[t] = x, P
        if t < T - 1:
            F[t] = step.F
            x = step.f + step.F @ x
            P = step.F @ P @ step.F.T + step.Q
    x_s, P_s, M = x_f.copy(), P_f.copy(), np.empty((T - 1, nx, nx))
    for t in range(T - 2, -1, -1):
        G = P_f[t] @ F[t].T @ np.linalg.pinv(P_p[t + 1], hermitian=True)
        x_s[t] = x_f[t] + G @ (x_s[t + 1] - x_p[t + 1])
        P_s[t] = P_f[t] + G @ (P_s[t + 1] - P_p[t + 1]) @ G.T
        M[t] = G @ P_s[t + 1]
    return KalmanSmoothed(model, theta, x_s, P_s, M, x_f, P_f, x_p, P_p, log_likelihood)
