"""Free runs of a model over many inputs at once, with everything that is linear beside them.

Beside a run x_{t+1} = F(x_t, u_t, theta), y_t = G(x_t, u_t, theta) go J = dF/dx, H = dG/dx, the noise's Q and
R, and the derivatives of y by the parameters, of which the first state may be a function.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.estimation.expectation import either_side
from engine.filters.filter_steps import first_moments
from engine.kernels.trajectory import carry
from engine.simulation.free_run import run_rows
from engine.simulation.steps import Steps, sizes, tested
from engine.statespace.model import Array, MixedModel
from engine.statespace.refutation import repeated_if_refuted, times_are_alike

LOST = 1e100  # a state so far off is none
DIFFERENCE = 1e-5  # of a parameter's size, between which and its neighbours differences are taken


@dataclass(frozen=True, eq=False)
class Experiments:
    """B inputs over the same T samples.

    ``u`` (B, n, nu) and ``u_step`` (B, n, nu) are those at the n rows and over the steps that begin there,
    ``t`` (n,) s, every ``dt`` s; ``rows`` (T,) those of the n rows that are samples, where a model makes
    several steps a sample.
    """

    u: Array
    u_step: Array
    t: Array
    dt: float
    rows: NDArray[np.intp]

    @classmethod
    def of(cls, u: Array, dt: float, hold: str, substeps: int) -> Experiments:
        """For inputs (B, T, nu), every dt s, that do between samples what ``hold`` says."""
        frames = [frame(one, dt, hold).refined(substeps) for one in u]
        each = np.array([f.u for f in frames]), np.array([f.u_step for f in frames])
        return cls(*each, frames[0].t, dt / substeps, frames[0].samples)


def frame(u: Array, dt: float, hold: str) -> Series:
    """A series of inputs (T, nu) without readings."""
    return Series(np.full((len(u), 1), np.nan), u, dt=dt, hold=hold)


@dataclass(frozen=True, eq=False)
class Runs:
    """B free runs: y (B, n, ny) and x (B, n, nx).

    J (B, n-1, nx, nx), H (B, n, ny, nx), Q (B, n-1, nx, nx), R (B, n, ny, ny) along them; P1 (nx, nx) of the
    first state; dy (B, n, ny, p) and dx (B, n, nx, p) by the parameters. A run that is not finite is
    ``lost`` (B,), and zero.
    """

    y: Array
    x: Array
    J: Array
    H: Array
    Q: Array
    R: Array
    P1: Array
    dy: Array
    dx: Array
    lost: NDArray[np.bool_]


@repeated_if_refuted
def simulated(model: MixedModel, theta: Array, experiments: Experiments) -> tuple[Array, Array]:
    """The free runs alone: y (B, n, ny) and x (B, n, nx), which may not be finite."""
    with np.errstate(all="ignore"):
        x = _states(model, theta, experiments)
        G = _outputs(model, theta, experiments)
        y = replace(G, split=tested(model, G, _rows(x)) is None)(_rows(x)).value
    return _flat(y, len(x)), x


def of_many(model: MixedModel, thetas: Array, experiment: Experiments) -> tuple[Array, Array]:
    """The free runs of parameter vectors (K, n_theta) in one experiment: y (K, n, ny), x (K, n, nx)."""
    blank = np.full((len(experiment.t), model.ny), np.nan)
    series = Series(blank, experiment.u_step[0], dt=experiment.dt)
    first = np.array([first_moments(model, theta)[0] for theta in thetas])
    both = [0, 0] if len(thetas) == 1 else slice(None)  # one alone would be found by another method
    _, x = run_rows(model, thetas[both], series, first[both])
    x = np.ascontiguousarray(x.transpose(1, 0, 2)[: len(thetas)])
    y = []
    with np.errstate(all="ignore"):
        for theta, own in zip(thetas, x, strict=True):
            G = _outputs(model, theta, experiment)
            y.append(replace(G, split=tested(model, G, own) is None)(own).value)
    return np.array(y), x


@repeated_if_refuted
def linearised(
    model: MixedModel,
    theta: Array,
    experiments: Experiments,
    parameters: Sequence[int],
    known: Array | None = None,
) -> Runs:
    """The free runs with all that is linear beside them; derivatives by the ``parameters`` (p,) of theta.

    ``known`` are their states (B, n, nx), where they were run before. A run that is not finite is replaced by
    zeros and marked as lost.
    """
    theta = np.asarray(theta, dtype=float)
    mean, P1 = first_moments(model, theta)
    with np.errstate(all="ignore"):
        x = _states(model, theta, experiments) if known is None else known
        lost = np.asarray(~(np.abs(x) < LOST).all(axis=(1, 2)))
        x = np.where(_like(lost, x), mean, x)
        B, n, nx = x.shape
        here, before = _rows(x), _rows(x[:, :-1])
        F, G = _steps(model, theta, experiments), _outputs(model, theta, experiments)
        F = replace(F, split=tested(model, F, before) is None)
        G = replace(G, split=tested(model, G, here) is None)
        ahead, seen = F(before), G(here)
        moved = np.abs(x - x[:, :1]).max(axis=1)
        each = np.array([sizes(one, np.abs(mean), model.start_sizes) for one in moved])
        J = _flat(F.slopes(before, ahead, np.repeat(each, n - 1, axis=0), central=True), B)
        H = _flat(G.slopes(here, seen, np.repeat(each, n, axis=0), central=True), B)
        p = len(parameters)
        b, d = np.zeros((B, n - 1, nx, p)), np.zeros((B, n, model.ny, p))
        start = np.zeros((nx, p))
        for i, k in enumerate(parameters):
            low, high = either_side(model, theta, k, DIFFERENCE)
            down, up = float(low[k] - theta[k]), float(high[k] - theta[k])
            ends = model.record(low), model.record(high)
            b[..., i] = _flat(F.slope_between(before, ahead, ends, down, up), B)
            d[..., i] = _flat(G.slope_between(here, seen, ends, down, up), B)
            first = first_moments(model, high)[0] - first_moments(model, low)[0]
            start[:, i] = first / (up - down)
        dx = np.array([carry(J[k], b[k], start) for k in range(B)])
        dy = H @ dx + d
    Q, R = _each(ahead.Q, B, n - 1), _each(seen.Q, B, n)
    parts = [_flat(seen.value, B), x, J, H, Q, R, dy, dx]
    for one in parts:
        lost = np.asarray(lost | ~np.isfinite(one).reshape(B, -1).all(axis=1))
    y, x, J, H, Q, R, dy, dx = (np.where(_like(lost, one), 0.0, one) for one in parts)
    return Runs(y, x, J, H, Q, R, P1, dy, dx, lost)


def _like(flags: NDArray[np.bool_], array: Array) -> NDArray[np.bool_]:
    return flags.reshape(-1, *(1,) * (array.ndim - 1))


def _states(model: MixedModel, theta: Array, experiments: Experiments) -> Array:
    """x (B, n, nx) of the runs without noise, all B of them in one step of the model."""
    mean, _ = first_moments(model, np.asarray(theta, dtype=float))
    B, n, _ = experiments.u.shape
    x = np.empty((B, n, model.nx))
    x[:, 0] = mean
    record, t = model.record(np.asarray(theta, dtype=float)), experiments.t
    if B == 1:
        return of_many(model, np.asarray(theta, dtype=float)[None], experiments)[1]
    dt, u = experiments.dt, np.ascontiguousarray(experiments.u_step.transpose(1, 2, 0))
    first = _steps(model, theta, experiments).rows(0, B)
    split = tested(model, first, x[:, 0]) is None
    with times_are_alike():
        for i, at in enumerate(t[:-1].tolist()):
            step = Steps(model.transitions, model.na, u[i], at, dt, record, split)
            x[:, i + 1] = step(x[:, i]).value
    return x


def _steps(model: MixedModel, theta: Array, experiments: Experiments) -> Steps:
    """Those of all runs, one after the other."""
    u = _rows(experiments.u_step[:, :-1]).T
    B, t = len(experiments.u), experiments.t
    record = model.record(np.asarray(theta, dtype=float))
    return Steps(model.transitions, model.na, u, np.tile(t[:-1], B), experiments.dt, record)


def _outputs(model: MixedModel, theta: Array, experiments: Experiments) -> Steps:
    record = model.record(np.asarray(theta, dtype=float))
    t = np.tile(experiments.t, len(experiments.u))
    return Steps(model.observations, model.na, _rows(experiments.u).T, t, 0.0, record)


def _rows(values: Array) -> Array:
    """(B, n, k) as (B n, k)."""
    return np.ascontiguousarray(values.reshape(-1, values.shape[-1]))


def _flat(values: Array, B: int) -> Array:
    """(B n, ...) as (B, n, ...)."""
    return values.reshape(B, -1, *values.shape[1:])


def _each(matrix: Array, B: int, n: int) -> Array:
    """A covariance that may be common to all rows, as (B, n, k, k)."""
    if matrix.ndim == 2:
        return np.ascontiguousarray(np.broadcast_to(matrix, (B, n, *matrix.shape)))
    return _flat(matrix, B)
