"""Readings of a state's rate, as of an accelerometer on a speed: what pushes the state is in them, too."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any
from weakref import WeakKeyDictionary, ref

import numpy as np

from engine.diagnose.effects.rates import Points, beside, guessed_points
from engine.errors import EngineError
from engine.statespace.half_steps import step
from engine.statespace.model import Array, MixedModel

ALIKE = 1e-2  # of a reading: what a line of the rate may leave, as the steps are finite
SHORT = 10.0 ** np.arange(
    -12.0, 4.0
)  # steps tried: nobody knows how fast a model is, in its own unit of time
APART = 1e-4  # between the times of the points

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


def felt_by_readings(
    model: MixedModel,
    split: Callable[[Any], tuple[Any, Any]],
    target: str,
    rate: Callable[[Array, Any, Any, Any], Any],
) -> dict[str, Any]:
    """The measurement of a model in which ``rate(a, u, t, own)`` pushes a state: nothing where none feels it.

    Of the outputs that read the rate of that state, as an accelerometer does of a speed.
    """
    rows = readings_of_rate(model, target)
    if not rows:
        return {}

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        record, own = split(theta)
        h, C, R = model.observation(a, u, t, record)
        h = h.copy()
        for row, factor in rows.items():
            h[:, row] += factor * rate(a, u, t, own)
        return h, C, R

    return {"measurement": measurement}


@np.errstate(all="ignore")  # a guessed point may be where the model is not meant
def _all_of(model: MixedModel) -> dict[str, dict[int, float]]:
    found: dict[str, dict[int, float]] = {}
    try:
        theta = np.asarray(model.theta())
        points = guessed_points(model, APART)
        # nobody knows how large inputs are: beside large ones a reading looks like one of an input alone
        alone = replace(points, u=np.zeros_like(points.u))
        readings = _readings(model, theta, alone).T
        rows = [k for k, values in enumerate(readings) if not _of_one(values, alone.x)]
        if not rows:
            return found
        one = _factors(model, theta, alone, rows)
        other = _factors(model, beside(model, theta), points, rows)
    except (EngineError, np.linalg.LinAlgError):
        return found
    for (row, state), factor in one.items():
        if np.isclose(factor, other.get((row, state), np.nan), rtol=ALIKE):
            found.setdefault(state, {})[row] = factor
    return found


def _of_one(values: Array, x: Array) -> bool:
    """Whether a reading (n,) is one of a single state (n, nx), or of none."""
    return not np.ptp(values) > 0.0 or any(_line(values, state)[0] <= ALIKE for state in x.T)


def _factors(
    model: MixedModel, theta: Array, points: Points, rows: Sequence[int]
) -> dict[tuple[int, str], float]:
    """By how much of the rate of a state (second) an output (first) grows, where that is all of it.

    By the step, long or short, that leaves least: longer ones bend, and shorter ones are lost in rounding.
    """
    values = _readings(model, theta, points).T
    readings = {row: values[row] for row in rows}
    best: dict[tuple[int, str], tuple[float, float]] = {}
    for short in SHORT:
        rates = _rates(model, theta, points, float(short))
        for state, rate in zip([*model.nonlinear, *model.linear], rates.T, strict=True):
            for row, values in readings.items():
                best[row, state] = min(_line(values, rate), best.get((row, state), (np.inf, 0.0)))
    return {at: slope for at, (left, slope) in best.items() if left <= ALIKE}


def _readings(model: MixedModel, theta: Array, points: Points) -> Array:
    """Means (n, ny) of the outputs."""
    na, record, out = model.na, model.record(theta), []
    for x, u, t in zip(points.x, points.u, points.t.tolist(), strict=True):
        h, C, _ = model.observation(np.ascontiguousarray(x[None, :na]), u, t, record)
        out.append((h + np.einsum("...ij,...j->...i", C, x[None, na:]))[0])
    return np.array(out)


def _rates(model: MixedModel, theta: Array, points: Points, short: float) -> Array:
    """Rates (n, nx) of the states, by one step."""
    each = zip(points.x, points.u, points.t.tolist(), strict=True)
    return np.array([(step(model, theta, x[None], u, t, short)[0] - x) / short for x, u, t in each])


def _line(values: Array, by: Array) -> tuple[float, float]:
    """What a line over ``by`` (n,) leaves of ``values`` (n,), as a share, whatever its constant; its slope."""
    values, by = values - values.mean(), by - by.mean()
    size, whole = float(by @ by), float(np.linalg.norm(values))
    if not (np.isfinite(size) and size > 0.0 and np.isfinite(whole) and whole > 0.0):
        return np.inf, 0.0
    slope = float(values @ by) / size
    return float(np.linalg.norm(values - slope * by)) / whole, slope
