"""Dry friction over one step: it may stop a motion, not reverse it, and it holds what stands.

The other forces on a speed v, whatever they are, are taken as constant within the step: they lead from v to
``free``. Then v moves on straight lines, with a corner where it changes its sign, or stops there for as long as
the friction is the larger. Without that a body which stands would creep between the steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from engine.diagnose.effects.effect import Split, on_base, pushed
from engine.diagnose.effects.rate_readings import felt_by_readings
from engine.statespace.model import Array, MixedModel
from engine.statespace.promotion import promote

MOST_FED = 8  # each of them is a dimension for filters; two masses, their drive's current and a load are five

Size = Callable[[Any, Sequence[Any]], Any]  # of a friction, at speeds (M,) and own parameters
Zero = Callable[[Sequence[Any]], Any]


def rubbed(v: Any, free: Any, push: Any) -> Any:
    """The speed (M,) after a step from v (M,) that leads to ``free`` (M,) without friction; 0 where it stands.

    ``push`` (M,) is what friction takes of a speed that keeps its sign; all in the speed's unit.
    """
    drive = free - v
    way = np.where(v == 0.0, np.sign(drive), np.sign(v))
    end = free - way * push
    turns = way * end < 0.0
    span = np.abs(v) + np.abs(end)
    left = np.where(turns, np.abs(end) / np.where(span > 0.0, span, 1.0), 0.0)  # share of the step
    turned = left * np.sign(drive) * np.maximum(np.abs(drive) - push, 0.0)
    return np.where(turns, turned, end)


def with_feeding(model: MixedModel, source: str, feeding: Sequence[str]) -> MixedModel:
    """The model with a speed promoted, and what feeds it where that is little: friction must know it.

    A slow load is among them: where it were left out, what stands would creep under the mean of it.
    """
    fed = [name for name in model.linear if name in feeding and name != source]
    return promote(model, (source, *(fed if len(fed) <= MOST_FED else ())))


def rub(
    model: MixedModel, source: str, target: str, feeding: Sequence[str], size: Size, zero: Zero
) -> MixedModel:
    """``target``' = ... - dt * size(v) * sign(v), v the state ``source`` counted from its ``zero``.

    Of a continuous model half of it comes before the step and half after it (Strang 1968). Where linear states
    still move v, a mean over them does not say which way the motion is: friction comes before the step, and
    only stops.
    """
    base = with_feeding(model, source, feeding)
    split, column = Split(model), list(base.nonlinear).index(source)
    row = [*base.nonlinear, *base.linear].index(target)
    own_speed = source == target

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        record, own = split(theta)
        v = a[:, column] - zero(own)
        f, A, Q = base.transition(a, u, t, dt, record)
        after = f[:, column] - zero(own)
        moved = np.broadcast_to(A[..., column, :].any(axis=-1), (len(a),))
        ends = rubbed(v, after, dt * size(v, own)) if own_speed else after
        push = dt * size(np.where(moved, v, 0.5 * (v + ends)), own)  # of the speed half way
        whole = -push * np.sign(v)
        if own_speed:
            stopped = np.sign(whole) * np.minimum(np.abs(whole), np.abs(v))
            ends = rubbed(v, after, push)
            whole = np.where(moved, stopped, ends - after)
        if not base.continuous:
            return pushed(base, {row: whole}, a, u, t, dt, record)
        f, A, Q = pushed(base, {row: np.where(moved, whole, 0.5 * whole)}, a, u, t, dt, record)
        there = f[:, column] - zero(own)
        late = np.where(ends == 0.0, -there, 0.5 * whole)  # what stands does so to the last bit
        if not own_speed:
            late = -0.5 * push * np.sign(there)
        f[:, row] += np.where(moved, 0.0, late)
        return f, A, Q

    def felt(a: Array, u: Any, t: Any, own: Any) -> Any:
        v = a[:, column] - zero(own)
        return -size(v, own) * np.sign(v)

    functions = {"dynamics": dynamics} | felt_by_readings(base, split, target, felt)
    return on_base(base, split, **functions)
