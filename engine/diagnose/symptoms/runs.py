"""Free runs for the diagnosis: where they start, what noise would do to them, how sure theta is."""

from __future__ import annotations

import numpy as np

from engine.data.series import Series
from engine.estimation.quasi_ml import QuasiFit
from engine.filters.sigma_point import MomentPath, moment_path
from engine.kernels.gaussian import psd_cholesky
from engine.simulation.simulate import noise, propagate
from engine.statespace.had import can_be_had, first_that_can_be_had
from engine.statespace.model import Array, MixedModel

FEWEST, MOST = 20, 100  # rows of measurements that the first state is estimated from


def start_rows(series: Series) -> int:
    """How many rows tell the first state: a tenth, and enough measurements in them if there are any."""
    rows = int(np.clip(len(series) // 10, FEWEST, MOST))
    seen = np.flatnonzero(series.observed.any(axis=1))[:10]
    enough = int(seen[-1]) + 1 if len(seen) else 0
    return min(max(rows, enough, 2), len(series))


def start_state(
    model: MixedModel, theta: Array, series: Series, first: int = 0
) -> tuple[Array, Array]:
    """Mean (nx,) and covariance of x at row ``first``, given all before it and a few rows after."""
    rows = start_rows(series.part(first, len(series)))
    path = moment_path(model, theta, series.part(0, first + rows))
    means, covariances = smoothed(path, first)
    return means[0], covariances[0]


def smoothed(path: MomentPath, first: int = 0) -> tuple[Array, Array]:
    """Smoothed means (n, nx) and covariances (n, nx, nx) of the rows from ``first`` on.

    Backwards from the filter's last row Rauch, Tung and Striebel's recursion, J_t = P_{t|t} F_t' P_{t+1|t}^-,
    x_{t|n} = x_{t|t} + J_t (x_{t+1|n} - x_{t+1|t}), P_{t|n} = P_{t|t} + J_t (P_{t+1|n} - P_{t+1|t}) J_t'.
    The inverse is that of the correlations, so that a state's unit does not decide what is cut off.
    """
    means, covariances = path.filtered[first:].copy(), path.P_filtered[first:].copy()
    for k in range(len(means) - 2, -1, -1):
        t = first + k
        ahead = path.P_predicted[t + 1]
        scale = np.sqrt(np.maximum(np.diag(ahead), 0.0))
        per = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0.0)
        correlations = ahead * per[:, None] * per
        inverse = np.linalg.pinv(correlations, rcond=1e-12, hermitian=True) * per[:, None] * per
        J = path.P_filtered[t] @ path.F[t].T @ inverse
        means[k] += J @ (means[k + 1] - path.predicted[t + 1])
        P = covariances[k] + J @ (covariances[k + 1] - ahead) @ J.T
        covariances[k] = 0.5 * (P + P.T)
    return means, covariances


def noise_free(model: MixedModel, theta: Array, series: Series, x1: Array) -> tuple[Array, Array]:
    """y (T, ny) and x (T, nx) without noise from x1 (nx,); not finite where the run is lost."""
    na = model.na
    y, a, z = propagate(model, model.record(theta), series, x1[None, :na], x1[None, na:])
    return y[:, 0], np.concatenate([a[:, 0], z[:, 0]], axis=1)


def draws(
    model: MixedModel,
    theta: Array,
    series: Series,
    x1: Array,
    P1: Array,
    covariance: Array | None,
    n: int,
    rng: np.random.Generator,
) -> Array:
    """n simulations (n, T, ny) with drawn parameters, first states, process and measurement noise.

    Where a model cannot take many parameter vectors at once, a tenth as many of them are drawn.
    """
    na = model.na
    x = x1 + noise(P1, (n, len(x1)), rng)
    if covariance is None or not covariance.any():
        y, _, _ = propagate(model, model.record(theta), series, x[:, :na], x[:, na:], rng)
        return np.ascontiguousarray(np.swapaxes(y, 0, 1))
    thetas = theta + rng.standard_normal((n, len(theta))) @ psd_cholesky(covariance).T
    thetas = np.clip(thetas, model.lower, model.upper)
    thetas = _where_it_can_be_had(model, theta, thetas, series, x)
    record = model.records(thetas)
    u, t, dt = series.u_step[0], float(series.t[0]), float(series.steps[0])
    if model.transitions.takes(x[:, :na], u, t, dt, record):
        y, _, _ = propagate(model, record, series, x[:, :na], x[:, na:], rng)
        return np.ascontiguousarray(np.swapaxes(y, 0, 1))
    parts = []
    for rows in np.array_split(np.arange(n), max(n // 10, 1)):
        record = model.record(thetas[rows[0]])
        y, _, _ = propagate(model, record, series, x[rows, :na], x[rows, na:], rng)
        parts.append(np.swapaxes(y, 0, 1))
    return np.concatenate(parts)


def _where_it_can_be_had(
    model: MixedModel, theta: Array, thetas: Array, series: Series, x: Array
) -> Array:
    """``thetas`` (n, n_theta) drawn around theta, from its other side where the model cannot be had at one.

    So an estimate at the edge of such places has those of the side that there is.
    """
    a = x[:, : model.na]
    first = series.u_step[0], float(series.t[0]), float(series.steps[0])
    if can_be_had(model, model.records(thetas), a, *first).all():
        return thetas
    out = np.tile(theta, (len(thetas), 1))
    for k, drawn in enumerate(thetas):
        either = drawn, 2.0 * theta - drawn
        found = first_that_can_be_had(model, either, a[k : k + 1], *first)
        out[k] = theta if found is None else found
    return out


def covariance_of(fit: QuasiFit) -> Array:
    """The covariance (n_theta, n_theta) of a fit's estimate, zero for what was held or is at a bound.

    The inverse of the information where it has one; directions without information, which the
    data leave open, are left out instead of being drawn over all of their bounds.
    """
    n = len(fit.theta)
    out = np.zeros((n, n))
    H = fit.information
    d = np.sqrt(np.clip(np.diag(H), 0.0, None))
    own = np.array([fit.model.index(name) for name in fit.free], dtype=int)
    theta = np.asarray(fit.theta)[own]
    inside = (theta > fit.model.lower[own]) & (theta < fit.model.upper[own])
    informed = np.flatnonzero((d > 0.0) & inside)
    if informed.size:
        scaled = H[np.ix_(informed, informed)] / np.outer(d[informed], d[informed])
        inverse = np.linalg.pinv(scaled, rcond=1e-6, hermitian=True) / np.outer(
            d[informed], d[informed]
        )
        out[np.ix_(own[informed], own[informed])] = 0.5 * (inverse + inverse.T)
    return out
