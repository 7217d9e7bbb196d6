"""Tests of what comes with time, by footprints: one recursion for a whole family of times or frequencies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from engine.diagnose.columns import Column, Projection
from engine.diagnose.effect import Effect
from engine.diagnose.screen import Test, make_test
from engine.expectation import parameter_scale
from engine.kernels.footprints import footprints
from engine.model import Array, MixedModel
from engine.moment_filter import MomentPath
from engine.quasi_ml import whitening
from engine.series import Series

GRID = 400  # times or frequencies tried at most
STEP_GRID = 1000  # for a step, as one sample off it leaves another footprint
CHUNK = 50  # columns held in memory at once; even, as a harmonic has two
EDGE = 0.04  # share of the record at each end in which no step can be told from the start
TIMED = ("step", "parameter-step", "parameter-drift", "harmonic", "pulse")


def family_test(
    effect: Effect,
    model: MixedModel,
    theta: Array,
    series: Series,
    path: MomentPath,
    projection: Projection,
) -> Test | None:
    """The test of a timed effect over its whole grid; None where it leaves no footprint."""
    b, e = _driver(effect, model, theta, series, path)
    if effect.kind == "pulse":
        row = _largest_pulse(path, series, b, e)
        at: list[tuple[float, ...]] = [(float(series.t[row]), *effect.probes[0][1:])]
        gate = np.zeros((len(series), 1))
        gate[row] = 1.0
    else:
        at, gate = _gates(effect, series)
    root = whitening(path.S, series.observed)
    z = np.einsum("tij,tj->ti", root, np.nan_to_num(path.innovations))
    T, ny = z.shape
    degrees = 2 if effect.kind == "harmonic" else 1

    def chunk(start: int) -> list[tuple[tuple[float, ...], Column]]:
        some = np.ascontiguousarray(gate[:, start : start + CHUNK])
        g = np.nan_to_num(footprints(path.F, path.H, path.K, b, e, some))
        G = np.einsum("tij,tnj->nti", root, g)
        s = np.einsum("nti,ti->nt", G, z)
        v = np.zeros((some.shape[1], T * ny * (1 + ny)))
        v[:, : T * ny] = -G.reshape(len(v), -1)
        return [(at[(start + k) // degrees], Column(s[k], v[k])) for k in range(len(v))]

    starts = range(0, gate.shape[1], CHUNK)
    test = make_test(effect, (chunk(start) for start in starts), projection, degrees)
    if test is not None and effect.kind == "pulse":
        test = replace(test, tries=int(series.observed.any(axis=1).sum()))
    return test


def _largest_pulse(path: MomentPath, series: Series, b: Array, e: Array) -> int:
    """The row at which one pulse explains most, from one backward pass over all rows.

    The disturbance smoother (de Jong 1989; Harvey, Koopman 1992): with L_t = F_t (I - K_t H_t),
    r_{t-1} = H_t' S_t^{-1} nu_t + L_t' r_t and N likewise, a pulse b at t scores b' r_t with
    information b' N_t b, a pulse e in y_t scores e' (S_t^{-1} nu_t - (F_t K_t)' r_t).
    """
    T, _, nx = path.H.shape
    root = whitening(path.S, series.observed)
    nu = np.nan_to_num(path.innovations)
    r, N = np.zeros(nx), np.zeros((nx, nx))
    best, largest = 0, -1.0
    for t in range(T - 1, -1, -1):
        precision = root[t].T @ root[t]
        F = path.F[t] if t < T - 1 else np.zeros((nx, nx))
        gain = F @ path.K[t]
        score = e[t] @ (precision @ nu[t] - gain.T @ r)
        information = e[t] @ (precision + gain.T @ N @ gain) @ e[t]
        if t < T - 1:
            score += b[t] @ r
            information += b[t] @ N @ b[t] - 2.0 * e[t] @ gain.T @ N @ b[t]
        value = score**2 / information if information > 0.0 else 0.0
        if value > largest and 0 < t < T - 1:
            best, largest = t, value
        L = F @ (np.eye(nx) - path.K[t] @ path.H[t])
        r = path.H[t].T @ precision @ nu[t] + L.T @ r
        N = path.H[t].T @ precision @ path.H[t] + L.T @ N @ L
    return best


def grid(effect: Effect, series: Series) -> Array:
    """The times in seconds, or frequencies in hertz, at which a timed effect is tried."""
    T, t = len(series), series.t
    if effect.kind == "harmonic":
        length, step = float(t[-1] - t[0]), float(np.median(series.steps))
        return np.asarray(np.linspace(1.5 / length, 0.48 / step, min(GRID, T // 3)))
    first, last = int(EDGE * T) + 2, T - int(EDGE * T) - 3
    most = STEP_GRID if effect.kind == "step" else GRID
    n = max(2, min(most, last - first + 1))
    rows = np.unique(np.linspace(first, max(last, first + 1), n).astype(int))
    return np.asarray(t[rows])


def _gates(effect: Effect, series: Series) -> tuple[list[tuple[float, ...]], Array]:
    """The grid as values of the effect's other parameters, and the factors (T, n) in time."""
    t = series.t[:, None]
    if effect.kind == "parameter-drift":
        middle, per = effect.probes[0]
        return [(middle, per)], (t - middle) / per
    points = grid(effect, series)
    if effect.kind == "harmonic":
        angle = 2.0 * np.pi * points * t
        both = np.stack([np.cos(angle), np.sin(angle)], axis=2).reshape(len(series), -1)
        return [(0.0, float(f)) for f in points], both
    return [(float(tau),) for tau in points], (t >= points).astype(float)


def _driver(
    effect: Effect, model: MixedModel, theta: Array, series: Series, path: MomentPath
) -> tuple[Array, Array]:
    """What a unit of the effect adds to x_{t+1} and to y_t, before its gate."""
    T = len(series)
    b, e = np.zeros((T - 1, model.nx)), np.zeros((T, model.ny))
    states = [*model.nonlinear, *model.linear]
    if effect.kind in ("parameter-step", "parameter-drift"):
        return _sensitivity(model, theta, model.index(effect.channel), series, path)
    if effect.channel in model.outputs:
        e[:, list(model.outputs).index(effect.channel)] = 1.0
    else:
        b[:, states.index(effect.channel)] = series.steps
    return b, e


def _sensitivity(
    model: MixedModel, theta: Array, k: int, series: Series, path: MomentPath
) -> tuple[Array, Array]:
    """d x_{t+1} / d theta_k and d y_t / d theta_k along the filter's means.

    Zero for parameters of the noise, whose course in time is what ``variance:...->time`` tests.
    """
    T, na = len(series), model.na
    step = 1e-4 * parameter_scale(model, theta, k)
    ends = []
    for sign in (-1.0, 1.0):
        moved = np.array(theta)
        moved[k] = np.clip(theta[k] + sign * step, model.lower[k], model.upper[k])
        record = model.record(moved)
        b, e = np.empty((T - 1, model.nx)), np.empty((T, model.ny))
        for t in range(T):
            u, time = series.u[t], float(series.t[t])
            h, C, _ = model.observation(path.predicted[t : t + 1, :na], u, time, record)
            e[t] = h[0] + (C if C.ndim == 2 else C[0]) @ path.predicted[t, na:]
            if t < T - 1:
                f, A, _ = model.transition(
                    path.filtered[t : t + 1, :na], u, time, float(series.steps[t]), record
                )
                b[t] = f[0] + (A if A.ndim == 2 else A[0]) @ path.filtered[t, na:]
        ends.append((b, e, moved[k]))
    distance = ends[1][2] - ends[0][2]
    return (ends[1][0] - ends[0][0]) / distance, (ends[1][1] - ends[0][1]) / distance


def is_timed(effect: Effect) -> bool:
    """Whether the effect is tested by footprints over time."""
    return effect.kind in TIMED
