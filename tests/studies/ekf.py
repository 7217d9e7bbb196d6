"""Extended Kalman filter for the mixed model on x = (a, z): a baseline to hold the others against.

The model is linearised at the predicted and the filtered mean, by central differences in a; in z
it is linear. On a linear Gaussian model this is the Kalman filter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.data.series import Series
from engine.errors import ModelError
from engine.simulation.free_run import first_state
from engine.simulation.simulate import step_lengths
from engine.statespace.model import Array, MixedModel, ThetaLike
from engine.statespace.shapes import through

LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class Extended:
    """Filtered means (T, nx), covariances (T, nx, nx) of x = (a, z), and one-step predictions.

    ``innovations`` (T, ny) are measured minus predicted, NaN where nothing was measured; ``S``
    (T, ny, ny) their predicted covariance.
    """

    log_likelihood: float
    means: Array
    covs: Array
    innovations: Array
    S: Array


def ekf(model: MixedModel, theta: ThetaLike, series: Series) -> Extended:
    """Filter one series; missing channels are left out of the update.

    Raises ModelError naming the time where the filter stops being finite.
    """
    series.check(model)
    vector = model.theta(theta)
    record = model.record(vector)
    T, nx, ny, na = len(series), model.nx, model.ny, model.na
    x, P = _first_moments(model, vector)
    means, covs = np.empty((T, nx)), np.empty((T, nx, nx))
    innovations, S_all = np.full((T, ny), np.nan), np.empty((T, ny, ny))
    log_likelihood = 0.0
    steps = step_lengths(series).tolist()
    observed = series.observed
    times, inputs, eye = series.t.tolist(), series.u, np.eye(nx)
    with np.errstate(all="ignore"):
        for t in range(T):
            points, reach = _points(x[:na], P)
            h, C, R = model.observation(points, inputs[t], times[t], record)
            predicted, H = _linearised(h, C, x[na:], reach)
            R = R if R.ndim == 2 else R[0]
            S_all[t] = H @ P @ H.T + R
            seen = observed[t]
            if seen.any():
                e = series.y[t] - predicted
                innovations[t, seen] = e[seen]
                H, S, Rs = H[seen], S_all[t][np.ix_(seen, seen)], R[np.ix_(seen, seen)]
                try:
                    L = np.linalg.cholesky(S)
                except np.linalg.LinAlgError:
                    raise _lost(model, series, t) from None
                white = np.linalg.solve(L, e[seen])
                log_likelihood -= 0.5 * float(white @ white + seen.sum() * LOG_2PI)
                log_likelihood -= float(np.log(np.diag(L)).sum())
                K = np.linalg.solve(L.T, np.linalg.solve(L, H @ P)).T
                x = x + K @ e[seen]
                J = eye - K @ H
                P = J @ P @ J.T + K @ Rs @ K.T
            means[t], covs[t] = x, P
            if not (np.isfinite(x).all() and np.isfinite(log_likelihood)):
                raise _lost(model, series, t)
            if t < T - 1:
                points, reach = _points(x[:na], P)
                f, A, Q = model.transition(points, inputs[t], times[t], steps[t], record)
                x, F = _linearised(f, A, x[na:], reach)
                P = F @ P @ F.T + (Q if Q.ndim == 2 else Q[0])
    return Extended(log_likelihood, means, covs, innovations, S_all)


def _first_moments(model: MixedModel, theta: Array) -> tuple[Array, Array]:
    """Mean and covariance of x_1, z_{1|0}(a_1) and P_{1|0}(a_1) linearised at the mean of a_1."""
    x, spread = first_state(model, model.theta(theta))
    start = model.start(model.record(theta))
    na = model.na
    P = np.diag(spread**2)
    cov = getattr(start.density, "cov", None)
    if cov is not None:
        P[:na, :na] = cov
    points, reach = _points(x[:na], P)
    z, P1 = start.linear(points)
    slope = ((z[1::2] - z[2::2]) / reach[:, None]).T
    P[na:, :na] = slope @ P[:na, :na]
    P[:na, na:] = P[na:, :na].T
    P[na:, na:] = (P1 if P1.ndim == 2 else P1[0]) + slope @ P[:na, :na] @ slope.T
    return x, P


def _points(a: Array, P: Array) -> tuple[Array, Array]:
    """Rows a and a +- a small step in each component (2 na + 1, na), and the distances (na,)."""
    na = a.size
    h = 1e-4 * np.sqrt(np.maximum(np.diagonal(P)[:na], 0.0))
    h = np.where(h > 0.0, h, 1e-7 * np.where(a != 0.0, np.abs(a), 1.0))  # 1: no scale is known
    points = np.tile(a, (2 * na + 1, 1))
    index = np.arange(na)
    points[1 + 2 * index, index] += h
    points[2 + 2 * index, index] -= h
    return points, points[1 + 2 * index, index] - points[2 + 2 * index, index]


def _linearised(f: Array, A: Array, z: Array, reach: Array) -> tuple[Array, Array]:
    """The value f + A z at the mean, and its derivative in (a, z), from rows at ``_points``."""
    value = f + through(A, np.broadcast_to(z, (f.shape[0], z.size)))
    slope = ((value[1::2] - value[2::2]) / reach[:, None]).T
    return value[0], np.concatenate((slope, A if A.ndim == 2 else A[0]), axis=1)


def _lost(model: MixedModel, series: Series, t: int) -> ModelError:
    return ModelError(
        f"model '{model.name}': the extended Kalman filter is lost at t = {series.t[t]:g} s (row "
        f"{t}); its covariance or mean is not finite. Check theta and the first state's density"
    )
