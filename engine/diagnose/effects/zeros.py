"""Channels whose zero means nothing to a model: a position on a road, and the reading that follows it.

Where x is a path of the model, so is one with a constant added to such a state, and readings are moved by a
constant. It could be counted from anywhere.
"""

from __future__ import annotations

import numpy as np

from engine.diagnose.effects.rates import Points, guessed_points, step
from engine.statespace.model import Array, MixedModel

STEPS = (1.0, 0.1)  # times the time between samples
ROUNDING = 1e-11  # of a number
FAR = 7.0  # times a state's size: how far it is moved


def without_zero(model: MixedModel, dt: float) -> frozenset[str]:
    """The states and outputs of which the model does not care where they are counted from.

    ``dt`` is the time between samples, in the model's unit of time.
    """
    try:
        points = guessed_points(model, dt)
        states = enumerate([*model.nonlinear, *model.linear])
        return frozenset(name for i, state in states for name in _moved(model, points, i, state))
    except Exception:  # noqa: BLE001 - a user's function may refuse points that are only guessed
        return frozenset()


def _moved(model: MixedModel, points: Points, i: int, state: str) -> set[str]:
    """The i-th state and the outputs that move with it, if nothing but a constant comes of moving it."""
    theta = np.asarray(model.theta())
    away = FAR * points.scale[i] * np.eye(model.nx)[i]
    places = points.x, points.x + away
    read = np.zeros(model.ny, dtype=bool)
    for u, t, dt in zip(points.u, points.t, points.dt, strict=True):
        for h in STEPS:
            if not _apart(*(step(model, theta, x, u, t, h * dt) for x in places), away):
                return set()
        here, there = (_reading(model, theta, x, u, t) for x in places)
        change = there[0] - here[0]
        if not _apart(here, there, change):
            return set()
        read |= np.abs(change) > ROUNDING * (np.abs(here[0]) + np.abs(there[0]))
    return {state, *(name for name, moves in zip(model.outputs, read, strict=True) if moves)}


def _apart(here: Array, there: Array, change: Array) -> bool:
    """Whether rows (M, n) are as far apart as this ``change`` (n,), but for rounding."""
    rounding = ROUNDING * (np.abs(here) + np.abs(there)).max(axis=0)
    return bool((np.abs(there - here - change) <= rounding).all())


def _reading(model: MixedModel, theta: Array, x: Array, u: Array, t: float) -> Array:
    """Means (M, ny) of what is read at x (M, nx)."""
    h, C, _ = model.observation(np.ascontiguousarray(x[:, : model.na]), u, t, model.record(theta))
    return np.asarray(h + np.einsum("...ij,...j->...i", C, x[:, model.na :]))
