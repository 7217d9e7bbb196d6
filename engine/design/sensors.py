"""Which further sensor would tell causes apart that no input can: the same criterion over other channels.

Channels that the model has but nobody measures are its states, and outputs that the record lacks. The sensor
of a state has a noise that is a share of what the state moves by in the experiment.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from engine.design.criterion import adapted, precision
from engine.design.runs import simulated
from engine.design.search import Task
from engine.errors import EngineError
from engine.statespace.model import Array, MixedModel

NOISE = 0.01  # of a state's standard deviation in the experiment: its sensor's noise


@dataclass(frozen=True)
class Sensor:
    """A further channel, its sensor's noise (standard deviation, in ``unit``), and D of the pair with it."""

    channel: str
    noise: float
    unit: str
    D: float


def sensors(task: Task, u: Array, i: int, j: int) -> list[Sensor]:
    """Every further channel with the D of causes i and j in an experiment u (T, nu), the best first."""
    one, other = task.candidates[i], task.candidates[j]
    model = one.model
    experiment = task.experiments(u[None])
    _, x = simulated(model, one.theta, experiment)
    out = []
    for k, name in enumerate(model.outputs):
        if not task.seen[k]:
            seen = task.seen.copy()
            seen[k] = True
            D = _both(replace(task, seen=seen), u, i, j)
            out.append(Sensor(name, float(np.nan), model.outputs[name], D))
    units = {**model.nonlinear, **model.linear}
    shared = {*other.model.nonlinear, *other.model.linear}
    for k, name in enumerate(units):
        if name not in shared:
            continue
        moves = float(x[0, :, k].std())
        noise = NOISE * (moves if moves > 0.0 else 1.0)
        candidates = tuple(
            replace(c, model=with_sensor(c.model, name, noise)) if c in (one, other) else c
            for c in task.candidates
        )
        more = replace(task, candidates=candidates, seen=np.append(task.seen, True))
        try:
            out.append(Sensor(name, noise, units[name], _both(more, u, i, j)))
        except EngineError:
            continue
    return sorted(out, key=lambda sensor: -sensor.D)


def _both(task: Task, u: Array, i: int, j: int) -> float:
    """The smaller D of the two ways round, rivals adapted."""
    experiment = task.experiments(u[None])
    seen = task.measured(experiment)
    out = []
    for true, rival in ((i, j), (j, i)):
        one, other = task.candidates[true], task.candidates[rival]
        y, _ = simulated(one.model, one.theta, experiment)
        out.append(adapted(y, other, precision(other, task.anew), experiment, seen)[2])
    return min(out)


def with_sensor(model: MixedModel, state: str, noise: float) -> MixedModel:
    """The model with a state as a further output, measured with a standard deviation ``noise``."""
    names = [*model.nonlinear, *model.linear]
    k, ny = names.index(state), model.ny

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        h, C, R = model.observation(a, u, t, theta)
        M = len(a)
        h = np.concatenate([h, a[:, k : k + 1] if k < model.na else np.zeros((M, 1))], axis=1)
        row = np.zeros((*C.shape[:-2], 1, model.nz))
        if k >= model.na:
            row[..., 0, k - model.na] = 1.0
        both = np.zeros((*R.shape[:-2], ny + 1, ny + 1))
        both[..., :ny, :ny], both[..., ny, ny] = R, noise**2
        return h, np.concatenate([C, row], axis=-2), both

    name = f"sensor_of_{state}"
    unit = {**model.nonlinear, **model.linear}[state]
    return replace(model, outputs={**model.outputs, name: unit}, measurement=measurement)
