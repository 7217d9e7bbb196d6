"""The exact Kalman filter and RTS smoother for linear Gaussian models: the oracle of the tests.

Written in plain NumPy, independently of the kernels it checks: the textbook's formulas on square roots of the
covariances, by QR (Kailath, Sayed, Hassibi 2000, ch. 12).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from engine.data.given import one_series
from engine.data.series import Series
from engine.errors import ModelError
from engine.statespace.checks import READING, STEP, check_start, possible_noise
from engine.statespace.model import Array, Gaussian, LinearGaussian, MixedModel, Theta, ThetaLike
from engine.statespace.shapes import squared
from engine.threads import single_threaded
from engine.views import Figures, Shown, figures, plots
from engine.words import enumerated

SAME = 1e-9  # share of its largest value by which what should not depend on a may do so
LEFT = 1e-7  # of a state's size, and of its way: by what differences leave it may be moved
PART = 0.382  # of a step: after a whole one, an oscillation may be where it was
ROUNDING = 1e-12  # of the values from whose difference a slope is taken
SINGULAR = 1e-13  # eigenvalues of a correlation matrix, or singular values of its root, below this are rounding
LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class KalmanSmoothed(Shown):
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

    def plot(self, series: Series) -> Figures:
        """``states`` with 95 % bands over the times of the series smoothed; extra ``plot``."""
        units = {**self.model.nonlinear, **self.model.linear}
        sd = np.sqrt(np.maximum(np.diagonal(self.P, axis1=1, axis2=2), 0.0))
        return figures(states=plots().states(series.t, units, self.x, sd, series.time_unit))


def transition_matrices(
    model: MixedModel,
    record: Any,
    u: Array,
    t: Any,
    dt: Any,
    points: Array,
    size: Array | None = None,
) -> LinearGaussian:
    """f (nx,), F (nx, nx), Q (nx, nx) of x' = f + F x + w, w ~ N(0, Q), x = (a, z).

    ``points`` (n, na) of a from :func:`probes`. Raises ModelError where the model is not linear there. Beside
    the ``size`` (nx,) of each state, 0 where it has none, what differences leave of a linear ``continuous``
    model does not count.
    With times of their own, u (nu, M), t (M,) or dt (M,), f and F and what is not common to all are of
    each: f (M, nx), F (M, nx, nx).
    """
    a, u, t, dt = _at_each(points, u, t, dt)
    at = _by_time(model.transition(a, u, t, dt, record), len(points))
    try:
        return _matrices(model, "fAQ", at, points)
    except ModelError:
        # of a step that is too long to be calculated, an infinite size would excuse any difference
        finite = all(np.isfinite(part).all() for part in at)
        if size is None or not model.continuous or not finite:
            raise
    part = _by_time(model.transition(a, u, t, PART * dt, record), len(points))
    return _matrices(model, "fAQ", at, points, _left(at, part, points, size))


def observation_matrices(
    model: MixedModel, record: Any, u: Array, t: Any, points: Array
) -> LinearGaussian:
    """h (ny,), H (ny, nx), R (ny, ny) of y = h + H x + e, e ~ N(0, R); as transition_matrices."""
    a, u, t, _ = _at_each(points, u, t, 0.0)
    at = model.observation(a, u, t, record)
    return _matrices(model, "hCR", _by_time(at, len(points)), points)


def _at_each(points: Array, u: Any, t: Any, dt: Any) -> tuple[Array, Any, Any, Any]:
    """All points at the first time, then all at the next; as they are where there is one time."""
    times = [(u, np.ndim(u) > 1), (t, np.ndim(t) > 0), (dt, np.ndim(dt) > 0)]
    numbers = [np.shape(x)[-1] for x, many in times if many]
    if not numbers:
        return points, u, t, dt
    u, t, dt = (np.repeat(x, len(points), axis=-1) if many else x for x, many in times)
    return np.tile(points, (numbers[0], 1)), u, t, dt


def _by_time(at: LinearGaussian, n: int) -> LinearGaussian:
    """What a model returned for n points at each of M times, as (M, n, ...); for one time as it is."""
    value, matrix, cov = at
    if len(value) == n:
        return at
    matrix, cov = (m if m.ndim == 2 else m.reshape(-1, n, *m.shape[1:]) for m in (matrix, cov))
    return value.reshape(-1, n, value.shape[1]), matrix, cov


def probes(centre: Array, sd: Array, typical: Array) -> Array:
    """Points (na + 5, na) of a at which a model is asked whether it is linear, in the states' units.

    The centre, one point along each axis, and others at random; as far away as the state is from zero
    or its standard deviation ``sd`` (na,), whichever is more, and near by. ``typical`` (na,) sizes help
    where both are zero.
    """
    na = len(centre)
    draws = _draws(na)
    far = np.maximum(sd, np.abs(centre))
    far = np.where(far > 0.0, far, typical)
    steps = (np.zeros((1, na)), np.diag(far), 3.0 * far * draws[0])
    return np.asarray(centre + np.concatenate([*steps, 3.0 * sd * draws[1]]))


@lru_cache(maxsize=64)
def _draws(na: int) -> Array:
    return np.random.default_rng(20).standard_normal((2, 2, na))


def _left(
    at: LinearGaussian, part: LinearGaussian, points: Array, size: Array
) -> tuple[Array, Array, Array]:
    """What differences may leave in value (..., 1, nx), matrix (..., 1, nx, nz), covariance (..., 1, nx, nx).

    So little that it moves no state by more than a share of its ``size`` (nx,), and of how far it moves, as
    ``part`` of the step tells. An entry alone has no size: it passes through zero as steps grow.
    """
    value, matrix, cov = at
    na, nx = points.shape[1], value.shape[-1]
    sd = np.sqrt(np.maximum(np.diagonal(cov, axis1=-2, axis2=-1), 0.0))
    sd = sd.max(axis=-2) if cov.ndim > 2 else sd
    size = np.maximum(size, sd)
    z, moved = size[..., na:], part[0].copy()
    moved[..., :na] -= points
    reach = size + np.ptp(value, axis=-2) + _carried(matrix, z)
    way = np.ptp(moved, axis=-2) + _carried(part[1] - np.eye(nx)[:, na:], z)
    reach = LEFT * np.minimum(reach, way / PART)
    per = np.divide(1.0, z, out=np.zeros_like(z), where=z > 0.0)
    return (
        reach[..., None, :],
        (reach[..., :, None] * per[..., None, :])[..., None, :, :],
        LEFT * (sd[..., :, None] * sd[..., None, :])[..., None, :, :],
    )


def _carried(matrix: Array, z: Array) -> Array:
    """How far z of this size (..., nz) moves the states (..., nx), at most, by the matrices of all points."""
    if matrix.ndim == 2:
        return np.asarray(z @ np.abs(matrix).T)
    return np.asarray((np.abs(matrix) * z[..., None, None, :]).sum(axis=-1).max(axis=-2))


def _matrices(
    model: MixedModel,
    names: str,
    at: LinearGaussian,
    points: Array,
    left: tuple[Array, Array, Array] | None = None,
) -> LinearGaussian:
    """Intercept, matrix on x = (a, z) and covariance from the model's values ``at`` the points.

    ``left`` is by how much each may differ, besides.
    """
    value, matrix, cov = at
    lost = [name for name, part in zip(names, at, strict=True) if not np.isfinite(part).all()]
    if lost and not points.shape[1]:  # no state is at fault
        raise ModelError(
            f"model '{model.name}': {enumerated(lost)} not finite at this theta", numeric=True
        )
    more: Any = left or (0.0, 0.0, 0.0)
    common = []
    for name, m, own in ((names[1], matrix, more[1]), (names[2], cov, more[2])):
        if m.ndim > 2:
            first = m[..., 0, :, :]
            limit = SAME * np.abs(m).max(axis=-3, keepdims=True) + own
            if (np.abs(m - m[..., :1, :, :]) > limit).any():
                raise _not_linear(model, f"{name} depends on a")
            m = first
        common.append(m)
    slope = _slope(value, points, more[0])
    if slope is None:
        raise _not_linear(model, f"{names[0]} is not affine in a")
    shared = np.broadcast_to(common[0], (*slope.shape[:-2], *common[0].shape[-2:]))
    full = np.concatenate([slope, shared], axis=-1)
    return value[..., 0, :] - slope @ points[0], full, common[1]


def _slope(value: Array, points: Array, left: Any = 0.0) -> Array | None:
    """J (..., n, na) with value = value_0 + (a - a_0) J' at all points, None where there is none.

    Values may be off by ``left``, too.
    """
    na = points.shape[1]
    moved = points - points[0]
    change = value - value[..., :1, :]
    with np.errstate(invalid="ignore"):
        Jt = change[..., 1 : na + 1, :] / np.diagonal(moved[1 : na + 1])[:, None]
        off = np.abs(change - moved @ Jt)
        limit = SAME * np.abs(change).max(axis=-2, keepdims=True)
        limit = limit + ROUNDING * np.abs(value).max(axis=-2, keepdims=True)
        limit = limit + left
    return np.swapaxes(Jt, -1, -2) if (off <= limit).all() else None


def _not_linear(model: MixedModel, why: str) -> ModelError:
    return ModelError(f"model '{model.name}' is not linear Gaussian: {why}")


def linear_start(model: MixedModel, record: Any) -> tuple[Array, Array]:
    """Mean (nx,) and covariance (nx, nx) of x_1. Raises ModelError where it is not Gaussian."""
    start = model.start(record)
    if not isinstance(start.density, Gaussian):
        raise _not_linear(model, "p(a_1) is not a Gaussian")
    mean, Pa = start.density.mean, start.density.cov
    points = probes(mean, np.sqrt(np.maximum(np.diagonal(Pa), 0.0)), np.ones(model.na))
    z, P1 = start.linear(points)
    if P1.ndim == 3:
        if (np.abs(P1 - P1[:1]) > SAME * np.abs(P1).max(axis=0)).any():
            raise _not_linear(model, "P1 depends on a_1")
        P1 = P1[0]
    slope = _slope(z, points)  # z_1 may be affine in a_1
    if slope is None:
        raise _not_linear(model, "z1 is not affine in a_1")
    P = np.block([[Pa, Pa @ slope.T], [slope @ Pa, slope @ Pa @ slope.T + P1]])
    return np.concatenate([mean, z[0]]), P.reshape(model.nx, model.nx)


def start_probes(model: MixedModel, record: Any) -> tuple[Array, Array]:
    """The :func:`probes` about p(a_1), and the size (nx,) of each state there."""
    (mean, P), na = linear_start(model, record), model.na
    sd = np.sqrt(np.maximum(np.diagonal(P), 0.0))
    return probes(mean[:na], sd[:na], np.ones(na)), np.maximum(np.abs(mean), sd)


@single_threaded
def kalman_smoother(model: MixedModel, theta: ThetaLike, series: Series) -> KalmanSmoothed:
    """Filter and smooth a linear Gaussian model exactly; missing channels are left out.

    Parameters
    ----------
    model : MixedModel
        The model, paper, eq. (1).
    theta : Theta, mapping, array or None
        Parameters: all as (n_theta,), some by name, or None for the model's defaults.
    series : Series
        The data: y (T, ny) with NaN where missing, u (T, nu), times.

    Returns
    -------
    KalmanSmoothed
        Means ``x`` (T, nx), covariances ``P`` (T, nx, nx), ``M`` (T-1, nx, nx) and the log-likelihood.

    Raises
    ------
    ModelError
        The model is not linear Gaussian in x = (a, z) at this theta, or not finite.
    SeriesError
        Channels or units are not the model's, or nothing was measured; names the channel.
    """
    series = one_series(series, model).alone()
    theta = model.theta(theta)
    check_start(model, theta, series)
    record = model.record(theta)
    T, nx, na = len(series), model.nx, model.na
    x_p, x_f = np.empty((T, nx)), np.empty((T, nx))
    S_p, S_f = np.empty((T, nx, nx)), np.empty((T, nx, nx))  # roots of covariances
    # in units of S_f the root of what x_{t+1} leaves of x_t, and what it tells; in those of S_p the same of y_t
    left, V = np.empty((T - 1, nx, nx)), np.empty((T - 1, nx, nx))
    U, by_y = np.tile(np.eye(nx), (T, 1, 1)), np.zeros((T, nx))
    log_likelihood = 0.0
    x, P = linear_start(model, record)
    P = possible_noise(model, "initial: the covariance of x_1", P, float(series.t[0]))
    S = _root(P)
    sizes = np.ones(na)  # until a state has a scale, any is as good
    for t in range(T):
        u, time = series.u[t], float(series.t[t])
        # linear? asked again at each time, where the filter is
        sd = _sd(S)
        far = np.maximum(np.abs(x), sd)
        sizes = np.where(far[:na] > 0.0, far[:na], sizes)
        x_p[t], S_p[t] = x, S
        there = series.observed[t]
        h, H, R = observation_matrices(model, record, u, time, probes(x[:na], sd[:na], sizes))
        R = possible_noise(model, READING, R, time)
        if there.any():
            H, R = H[there], R[np.ix_(there, there)]
            root, gain, U[t] = _joint(H @ S, _root(R))
            v = solve_triangular(root, series.y[t, there] - h[there] - H @ x, lower=True)
            by_y[t] = gain @ v
            x, S = x + S @ by_y[t], S @ U[t]
            log_likelihood -= 0.5 * float(len(v) * LOG_2PI + v @ v)
            log_likelihood -= float(np.log(np.abs(np.diagonal(root))).sum())
        x_f[t], S_f[t] = x, S
        if t < T - 1:
            points = probes(x[:na], _sd(S)[:na], sizes)
            dt = float(series.steps[t])
            f, F, Q = transition_matrices(model, record, series.u_step[t], time, dt, points, far)
            Q = possible_noise(model, STEP, Q, time)
            x = f + F @ x
            S, V[t], left[t] = _joint(F @ S, _root(Q))
    x_s, P_s, M = x_f.copy(), squared(S_f), np.empty((T - 1, nx, nx))
    # d and D are the moments of xi, x_t = x_p + S_p xi: a gain on x_{t+1} itself would divide by S_p, which
    # ends next to singular where noise does not renew what decays
    d, D = by_y[-1], U[-1] @ U[-1].T
    for t in range(T - 2, -1, -1):
        d, VD = V[t] @ d, V[t] @ D
        cov = VD @ V[t].T + left[t] @ left[t].T
        x_s[t] += S_f[t] @ d
        M[t] = S_f[t] @ VD @ S_p[t + 1].T
        P_s[t] = S_f[t] @ cov @ S_f[t].T
        d, D = by_y[t] + U[t] @ d, U[t] @ cov @ U[t].T
    P_f, P_p = squared(S_f), squared(S_p)
    return KalmanSmoothed(model, theta, x_s, P_s, M, x_f, P_f, x_p, P_p, log_likelihood)


def _joint(AS: Array, noise: Array) -> tuple[Array, Array, Array]:
    """From A S (n, nx) and a root of the noise (n, n), with x = S xi, xi ~ N(0, I), and y = A x + noise:

    the root L (n, n) of Cov(y), V (nx, n) with V L' = Cov(xi, y), and the root (nx, nx) of Cov(xi | y). Nothing
    is subtracted, so that a diffuse P_1 does not drown what the readings tell.
    """
    n, nx = AS.shape
    X = np.zeros((n + nx, nx + n))
    X[:n, :nx], X[:n, nx:], X[n:, :nx] = AS, noise, np.eye(nx)
    L = np.asarray(np.linalg.qr(X.T, mode="r"), dtype=float).T
    return L[:n, :n], L[n:, :n], L[n:, n:]


def _root(P: Array) -> Array:
    """A square root of a covariance (n, n), taken of the correlations: units do not matter."""
    return _root_of(P.tobytes(), len(P))


@lru_cache(maxsize=16)  # most are the same at every time
def _root_of(numbers: bytes, n: int) -> Array:
    P = np.frombuffer(numbers).reshape(n, n)
    sd = np.sqrt(np.diagonal(P))
    unit = np.where(sd > 0.0, sd, 1.0)
    values, vectors = np.linalg.eigh(P / unit[:, None] / unit)
    values = np.where(values > SINGULAR, values, 0.0)
    return np.asarray(unit[:, None] * vectors * np.sqrt(values))


def _sd(S: Array) -> Array:
    """Standard deviations (..., n) by a root (..., n, n)."""
    return np.asarray(np.sqrt((S**2).sum(axis=-1)))
