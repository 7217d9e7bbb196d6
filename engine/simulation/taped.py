"""Free runs without noise of a model whose step is on tape: all time steps in one call of a kernel."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.data.series import Series
from engine.kernels.taped import run_taped
from engine.statespace.kept_tape import OfRecord
from engine.statespace.model import Array, MixedModel
from engine.statespace.on_tape import SHORTEST, on_tape
from engine.statespace.shapes import stacked


def run_by_tape(
    model: MixedModel, record: Any, series: Series, x1: Array, lengths: Array
) -> Array | None:
    """The states (T, K, nx) of runs from x1 (K, nx) over steps of ``lengths`` (T - 1,).

    The fields of ``record`` are numbers or (K,). None where the step must be called.
    """
    T, K, na = len(series), len(x1), model.na
    if T < SHORTEST or not np.isfinite(x1).all():
        return None
    each = [np.broadcast_to(np.asarray(value, dtype=float), (K,)) for value in record]
    thetas = np.array(each).reshape(len(each), K).T
    theta = record if all(np.ndim(value) == 0 for value in record) else model.record(thetas[0])
    inputs = np.ascontiguousarray(series.u_step, dtype=float)
    times, steps = series.t.tolist(), lengths.tolist()

    def call(t: int, a: Array) -> tuple[Array, Array, Array]:
        f, A, Q = model.transition(a, inputs[t], times[t], steps[t], record)
        return f, stacked(A), stacked(Q)

    rows = OfRecord(inputs, np.array(times), np.array([*steps, 0.0]), np.arange(T) < T - 1)
    first = x1[:, :na]
    moving = on_tape(model.transitions, call, rows, first, thetas, theta, model.continuous)
    if moving is None or not moving.begins_well(x1[:, :na]):
        return None
    X = np.empty((T, K, model.nx))
    X[0] = x1
    done = run_taped(moving.arguments, (moving.u, moving.t, moving.dt), X)
    if not done and moving.learns():
        return run_by_tape(model, record, series, x1, lengths)
    if not done:
        moving.note(done)
        return None
    lost = ~np.isfinite(X).all(axis=(1, 2))
    if moving.lines.raises and lost.any():
        return None  # of parameters with which it runs away calls tell why
    if K == 1 and lost.any():
        # just before it is lost differences are nothing but rounding
        half = int(np.argmax(lost)) // 2
        agrees = moving.agrees(half, X[half, :, :na])
    else:
        agrees = moving.agrees(T - 2)
    if not agrees:
        return None
    moving.note(done)
    return X
