"""Readings of a state's rate, as of an accelerometer on a speed: what pushes the state is in them, too."""

from __future__ import annotations

from collections.abc import Callable
from weakref import WeakKeyDictionary, ref

import numpy as np

from engine.diagnose.effects.rates import Points, beside, guessed_points
from engine.errors import EngineError
from engine.statespace.half_steps import SHORTER, step
from engine.statespace.model import Array, MixedModel

ALIKE = 1e-2  # of a reading: what a line of the rate may leave, as the steps are finite
STEP = 1e-4  # time, in any unit: steps are as much shorter as it takes, or the model is not asked

_KEPT: WeakKeyDictionary[Callable[..., object], tuple[object, dict[str, dict[int, float]]]] = (
    WeakKeyDictionary()
)


def readings_of_rate(model: MixedModel, state: str) -> dict[int, float]:
    """Outputs (rows) that read the rate of a state, at any parameters, with by how much of it; often none.

    Of differential equations only: what a step adds says nothing of a rate. A reading of one signal is not
    one: a speed is read, whatever else moves the position.
    """
    if not model.continuous:
        return {}
    kept = _KEPT.get(model.measurement)
    if kept is None or kept[0] != ref(model.dynamics):
        kept = ref(model.dynamics), _all_of(model)
        _KEPT[model.measurement] = kept
    return kept[1].get(state, {})


@np.errstate(all="ignore")  # a guessed point may be where the model is not meant
def _all_of(model: MixedModel) -> dict[str, dict[int, float]]:
    found: dict[str, dict[int, float]] = {}
    try:
        theta = np.asarray(model.theta())
        points = guessed_points(model, STEP)
        one, other = (_factors(model, at, points) for at in (theta, beside(model, theta)))
    except (EngineError, np.linalg.LinAlgError):
        return found
    for (row, state), factor in one.items():
        if np.isclose(factor, other.get((row, state), np.nan), rtol=ALIKE):
            found.setdefault(state, {})[row] = factor
    return found


def _factors(model: MixedModel, theta: Array, points: Points) -> dict[tuple[int, str], float]:
    """By how much of the rate of a state (second) each output (first) grows, where that is all of it."""
    na, record = model.na, model.record(theta)
    rates, y = [], []
    for x, u, t in zip(points.x, points.u, points.t, strict=True):
        short = SHORTER * STEP
        rates.append((step(model, theta, x[None], u, float(t), short)[0] - x) / short)
        h, C, _ = model.observation(np.ascontiguousarray(x[None, :na]), u, float(t), record)
        y.append((h + np.einsum("...ij,...j->...i", C, x[None, na:]))[0])
    signals = np.hstack([points.x, points.u])
    out = {}
    for row, values in enumerate(np.array(y).T):
        if any(_line(values, signal) is not None for signal in signals.T):
            continue
        for state, rate in zip([*model.nonlinear, *model.linear], np.array(rates).T, strict=True):
            slope = _line(values, rate)
            if slope is not None:
                out[row, state] = slope
    return out


def _line(values: Array, by: Array) -> float | None:
    """The slope of ``values`` (n,) over ``by`` (n,) where they are on a line, whatever its constant."""
    values, by = values - values.mean(), by - by.mean()
    size = float(by @ by)
    if not (np.isfinite(size) and size > 0.0 and np.ptp(values) > 0.0):
        return None
    slope = float(values @ by) / size
    on_it = np.linalg.norm(values - slope * by) <= ALIKE * np.linalg.norm(values)
    return slope if on_it else None
