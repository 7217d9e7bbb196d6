"""What a model's equations tell by being evaluated: which state feeds which, and what is a rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.estimation.expectation import parameter_scale
from engine.filters.filter_steps import first_moments
from engine.statespace.had import first_that_can_be_had
from engine.statespace.half_steps import SHORTER, step
from engine.statespace.model import Array, MixedModel

PROBE_POINTS = 12  # at which a rate is looked for
# time steps in seconds: one of them is short for any model
TIME_STEPS = 10.0 ** -np.arange(0.0, 11.0, 2.0)
# What is only there as the step is finite falls at least so much where it is quartered.
FADING = 0.5
SMALL_SHARE = 1e-2  # share of the dependence on the rate itself
ROUNDING_SHARE = 1e-8  # share that is rounding
FELT_SHARE = 1e-6  # of a state's own size: a smaller change of it is none
SNAP_SHARE = 1e-6  # of a rate's size: a zero so near 0 is 0


@dataclass(frozen=True, eq=False)
class Points:
    """Rows (n,) at which a model is evaluated one by one: x (n, nx), u (n, nu), t and dt (n,) in seconds.

    ``scale`` (nx,) and ``u_scale`` (nu,) are the sizes in which states and inputs vary.
    """

    x: Array
    u: Array
    t: Array
    dt: Array
    scale: Array
    u_scale: Array


def guessed_points(model: MixedModel, dt: float) -> Points:
    """Points from the density of the first state, where there is no record."""
    rng = np.random.default_rng(5)
    theta = np.asarray(model.theta())
    mean, scale = state_scale(model, theta, dt)
    x = mean + rng.standard_normal((PROBE_POINTS, model.nx)) * scale
    u = 0.5 + np.abs(rng.standard_normal((PROBE_POINTS, model.nu)))
    t = np.asarray(dt * np.arange(PROBE_POINTS), dtype=float)
    return Points(x, u, t, np.full(PROBE_POINTS, dt), scale, np.ones(model.nu))


def state_scale(model: MixedModel, theta: Array, dt: float) -> tuple[Array, Array]:
    """Mean and size (nx,) of the states: by p(x_1), else by the process noise, else by the mean, else 1."""
    mean, P = first_moments(model, theta)
    scale: Array
    a = mean[None, : model.na]
    with np.errstate(all="ignore"):
        _, _, Q = model.transition(a, np.ones(model.nu), 0.0, dt, model.record(theta))
    noise = np.nan_to_num(np.diagonal(Q if Q.ndim == 2 else Q[0]))
    sizes = [np.sqrt(np.maximum(np.diagonal(P), 0.0)), np.sqrt(np.maximum(noise, 0.0)), abs(mean)]
    scale = np.ones(model.nx)
    for size in reversed(sizes):
        scale = np.where(size > 0.0, size, scale)
    return mean, np.asarray(scale, dtype=float)


def feeding(
    model: MixedModel, theta: Array, points: Points
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which state (column) feeds which (row), (nx, nx); which input (column) moves it at once, (nx, nu)."""
    nx = model.nx
    change, moved = np.zeros((nx, nx)), np.zeros((nx, model.nu))
    size = points.scale.copy()
    for k in range(len(points.t)):
        here = _next(model, theta, points, k, points.x[k][None], points.u[k])[0]
        shifted = points.x[k] + np.diag(points.scale)
        each = _next(model, theta, points, k, shifted, points.u[k]) - here
        change = np.fmax(change, np.abs(each).T)
        for i, size_of_u in enumerate(points.u_scale):
            u = points.u[k].copy()
            u[i] += size_of_u
            more = _next(model, theta, points, k, points.x[k][None], u)[0]
            moved[:, i] = np.fmax(moved[:, i], np.abs(more - here))
        size = np.fmax(size, SMALL_SHARE * np.abs(here))
    return change > FELT_SHARE * size[:, None], moved > FELT_SHARE * size[:, None]


def moved_by(model: MixedModel, theta: Array, points: Points, parameter: str) -> tuple[bool, bool]:
    """Whether a parameter moves the means of the next states, and whether those of readings, at any point.

    Not of states that only scale noise. Raises EngineError where the model cannot be used beside theta.
    """
    index = model.index(parameter)
    away = 0.1 * abs(theta[index]) or 1.0
    other = _moved(model, theta, index, (away, -away), points)
    states = readings = False
    physical = ~np.isin([*model.nonlinear, *model.linear], model.scale_states)
    for k in range(len(points.t)):
        x, u, t = points.x[k][None], points.u[k], float(points.t[k])
        one, another = (_next(model, at, points, k, x, u)[:, physical] for at in (theta, other))
        states |= not np.array_equal(one, another, equal_nan=True)
        one, another = (_read(model, at, x, u, t) for at in (theta, other))
        readings |= not np.array_equal(one, another, equal_nan=True)
    return states, readings


def slopes_by(
    model: MixedModel, theta: Array, points: Points, parameter: str, share: float = SHORTER
) -> tuple[Array, Array]:
    """What a parameter does to the next states (n, nx) and to the readings (n, ny) at each point.

    Of the step a ``share``: by default so small a part that it is no more than what it does at once.
    """
    index = model.index(parameter)
    away = 0.07 * parameter_scale(model, theta, index)
    other = _moved(model, theta, index, (away, -away), points)
    short = replace(points, dt=share * points.dt)
    states, readings = [], []
    for k in range(len(points.t)):
        x, u, t = points.x[k][None], points.u[k], float(points.t[k])
        states.append(np.subtract(*(_next(model, at, short, k, x, u)[0] for at in (other, theta))))
        readings.append(np.subtract(*(_read(model, at, x, u, t)[0] for at in (other, theta))))
    return np.nan_to_num(states), np.nan_to_num(readings)


def _moved(model: MixedModel, theta: Array, k: int, ways: Sequence[float], points: Points) -> Array:
    """Theta with parameter k moved one of these ways: the farthest that it can go, of those the first.

    Theta itself where the model cannot be had on either side.
    """
    others = np.tile(np.asarray(theta, dtype=float), (len(ways), 1))
    others[:, k] = np.clip(theta[k] + np.asarray(ways), model.lower[k], model.upper[k])
    farthest = np.argsort(-np.abs(others[:, k] - theta[k]), kind="stable")
    first = points.x[:1, : model.na], points.u[0], float(points.t[0]), float(points.dt[0])
    found = first_that_can_be_had(model, others[farthest], *first)
    return np.array(theta, dtype=float) if found is None else found


def _read(model: MixedModel, theta: Array, x: Array, u: Array, t: float) -> Array:
    na = model.na
    with np.errstate(all="ignore"):
        h, C, _ = model.observation(np.ascontiguousarray(x[:, :na]), u, t, model.record(theta))
        return np.asarray(h + np.einsum("...ij,...j->...i", C, x[:, na:]))


def _next(model: MixedModel, theta: Array, points: Points, k: int, x: Array, u: Array) -> Array:
    return step(model, theta, x, u, float(points.t[k]), float(points.dt[k]))


@dataclass(frozen=True)
class Rate:
    """That a state is the rate of the states ``of``, which stand still where it is ``zero``.

    ``zero`` is None where it depends on the parameters.
    """

    zero: float | None
    of: tuple[str, ...]


@np.errstate(all="ignore")  # of a law that grows fast the guessed points may be too far off
def rates(model: MixedModel) -> dict[str, Rate]:
    """The states that are the rate of another one.

    v is the rate of x where x' - x = k (v - v0), for a short step at least, and depends on nothing
    else. Taken from the model alone, so that it is the same with and without data.
    """
    states = [*model.nonlinear, *model.linear]
    try:
        theta, other = two_thetas(model)
        points = guessed_points(model, 1.0)
        out: dict[str, Rate] = {}
        for dt in TIME_STEPS:
            elsewhere = _rates(model, other, points, dt)
            for v, (zero, of) in _rates(model, theta, points, dt).items():
                again, _ = elsewhere.get(v, (np.nan, []))
                same = abs(again - zero) <= SNAP_SHARE * points.scale[v] * 10.0
                moved = tuple(states[j] for j in of)
                out.setdefault(states[v], Rate(zero if same else None, moved))
        return out
    except Exception:  # noqa: BLE001 - a user's function may refuse points that are only guessed
        return {}


def two_thetas(model: MixedModel) -> tuple[Array, Array]:
    """The default parameters and others beside them: what holds at one alone is chance."""
    theta = np.asarray(model.theta())
    return theta, beside(model, theta)


def beside(model: MixedModel, theta: Array) -> Array:
    """Parameters (n_theta,) beside these, within their bounds: what is 0 here may not stay so.

    On that side where the model can be had; some of them up and some down where it is on neither.
    """
    away = 0.07 * np.array([parameter_scale(model, theta, k) for k in range(len(theta))])
    mixed = away * (-1.0) ** np.arange(len(away))
    mean, _ = first_moments(model, theta)
    first = mean[None, : model.na], np.ones(model.nu), 0.0, 1.0
    others = [theta + way for way in (away, -away, mixed, -mixed)]
    found = first_that_can_be_had(model, others, *first)
    return np.clip(others[0], model.lower, model.upper) if found is None else found


def _rates(
    model: MixedModel, theta: Array, points: Points, dt: float
) -> dict[int, tuple[float, list[int]]]:
    """{state: (v0, whose rate it is)} of the rates that show at steps dt and dt / 4."""
    (shares, zeros), (finer, finer_zeros) = (
        _dependence(model, theta, points, h) for h in (dt, dt / 4.0)
    )
    out: dict[int, tuple[float, list[int]]] = {}
    for j in range(model.nx):
        for v in range(model.nx):
            share, finest = shares[j, v], finer[j, v]
            fades = share <= ROUNDING_SHARE or (share <= SMALL_SHARE and finest <= FADING * share)
            if v == j or not fades:
                continue
            zero = (4.0 * finer_zeros[j, v] - zeros[j, v]) / 3.0
            size = points.scale[v]
            v0 = 0.0 if abs(zero) <= SNAP_SHARE * size else float(f"{zero:.9g}")
            out[v] = (v0, [*(out[v][1] if v in out else []), j])
    return out


def _dependence(model: MixedModel, theta: Array, points: Points, dt: float) -> tuple[Array, Array]:
    """For each state (row) and supposed rate v (column): the largest dependence on anything else,

    as a share of that on v; and the v at which the state stands still.
    """
    nx = model.nx
    moves = []  # of the state over the step: (inputs, 1 + 2 nx ways, points, nx)
    for u, t in ((points.u[0], 0.0), (points.u[1] * 1.7, 0.3), (points.u[2] * 0.4, 11.0)):
        ways = [points.x]
        for i in range(nx):
            ways += [points.x + sign * points.scale * np.eye(nx)[i] for sign in (1.0, -2.0)]
        moves.append([step(model, theta, x, u, t, dt) - x for x in ways])
    g = np.array(moves)
    here, up, down = g[:, 0], g[:, 1::2], g[:, 2::2]
    by_state = np.abs(up - here[:, None]).max(axis=(0, 2))  # (nx moved, nx)
    bent = np.abs(down - here[:, None] + 2.0 * (up - here[:, None])).max(axis=(0, 2))
    by_input = np.abs(here - here[0]).max(axis=(0, 1))  # (nx,)
    shares, zeros = np.full((nx, nx), np.inf), np.zeros((nx, nx))
    for v in range(nx):
        others: Sequence[Array] = [np.delete(by_state, v, axis=0).max(axis=0, initial=0.0)]
        rest = np.max([*others, bent[v], by_input], axis=0)
        with np.errstate(all="ignore"):
            slope = ((up[:, v] - here) / points.scale[v]).mean(axis=(0, 1))
            zeros[:, v] = (points.x[:, v, None] - here / slope).mean(axis=(0, 1))
            shares[:, v] = np.where(by_state[v] > 0.0, rest / by_state[v], np.inf)
    return np.nan_to_num(shares, nan=np.inf), np.nan_to_num(zeros)
