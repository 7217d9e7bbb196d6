"""Channels whose zero means nothing to a model: a position on a road, all temperatures of a room.

Where x is a path of the model, so is one with a constant added to such states and inputs, and readings are
moved by a constant. They could be counted from anywhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from engine.diagnose.effects.rates import Points, guessed_points, two_thetas
from engine.statespace.model import Array, MixedModel
from engine.units import difference

STEPS = (1.0, 0.1)  # times the time between samples
ROUNDING = 1e-11  # of a number
DIFFERENCED = 1e-9  # the same where steps of equations rest on differences by nonlinear states
FAR = 7.0  # times the size of a state: how far it is moved


@np.errstate(all="ignore")  # of a law that grows fast the guessed points may be too far off
def without_zero(model: MixedModel, dt: float) -> frozenset[str]:
    """The states, inputs and outputs of which the model does not care where they are counted from.

    One state alone, or all states and inputs of a unit, or of a kind of units, together. ``dt`` is the time
    between samples, in the model's unit of time.
    """
    try:
        points = guessed_points(model, dt)
        theta, other = two_thetas(model)
        out: set[str] = set()
        for ways in _ways(model, points):
            moved = _moved(model, points, theta, *ways)
            if moved == _moved(model, points, other, *ways):
                out |= moved
        return frozenset(out)
    except Exception:  # noqa: BLE001 - a user's function may refuse points that are only guessed
        return frozenset()


def _ways(model: MixedModel, points: Points) -> Iterator[tuple[Array, Array]]:
    """How far states (nx,) and inputs (nu,) are moved, in turn."""
    units = [*model.nonlinear.values(), *model.linear.values(), *model.inputs.values()]
    for i, size in enumerate(points.scale):
        yield FAR * size * np.eye(model.nx)[i], np.zeros(model.nu)
    for per in _together(units):
        own, driven = per[: model.nx], per[model.nx :]
        if own.any() and np.count_nonzero(per) > 1:
            far = FAR * (points.scale[own > 0.0] / own[own > 0.0]).max()
            yield far * own, far * driven


def _together(units: Sequence[str]) -> Iterator[Array]:
    """How many units (n,) of each channel one step of all of a kind is, 0 of others: in m and mm 1 to 1000.

    First those that are written alike, whatever they are, then those of different units of one kind.
    """
    for unit in dict.fromkeys(units):
        yield np.array([float(one == unit) for one in units])
    known = [difference(one) for one in units]
    for kind in dict.fromkeys(one[1] for one in known if one is not None):
        per = np.array([0.0 if one is None or one[1] != kind else 1.0 / one[0] for one in known])
        if len({unit for unit, own in zip(units, per, strict=True) if own}) > 1:
            yield per / per.max()


def _moved(model: MixedModel, points: Points, theta: Array, dx: Array, du: Array) -> set[str]:
    """The channels that are moved, if nothing but a constant comes of it."""
    read = np.zeros(model.ny, dtype=bool)
    off = DIFFERENCED if model.continuous and model.na else ROUNDING
    for u, t, dt in zip(points.u, points.t, points.dt, strict=True):
        places = (points.x, u), (points.x + dx, u + du)
        for h in STEPS:
            (here, Q), (there, Q_there) = (_next(model, theta, x, v, t, h * dt) for x, v in places)
            if not (_apart(here, there, dx, off) and _same(Q, Q_there, off)):
                return set()
        (here, R), (there, R_there) = (_reading(model, theta, x, v, t) for x, v in places)
        change = there[0] - here[0]
        if not (_apart(here, there, change) and _same(R, R_there)):
            return set()
        read |= np.abs(change) > ROUNDING * (np.abs(here[0]) + np.abs(there[0]))
    names = [*model.nonlinear, *model.linear, *model.inputs, *model.outputs]
    moves = np.concatenate([dx != 0.0, du != 0.0, read])
    return {name for name, moved in zip(names, moves, strict=True) if moved}


def _apart(here: Array, there: Array, change: Array, off: float = ROUNDING) -> bool:
    """Whether rows (M, n) are as far apart as this ``change`` (n,), but for a share of them that may be off."""
    rounding = off * (np.abs(here) + np.abs(there) + np.abs(change)).max(axis=0)
    return bool((np.abs(there - here - change) <= rounding).all())


def _same(here: Array, there: Array, off: float = ROUNDING) -> bool:
    """Whether covariances (., n, n) are the same, but for a share of the scatter that may be off."""
    scatter = np.sqrt(np.abs(np.diagonal(here, axis1=-2, axis2=-1)))
    scale = scatter[..., :, None] * scatter[..., None, :]
    return bool((np.abs(there - here) <= off * scale).all())


def _next(
    model: MixedModel, theta: Array, x: Array, u: Array, t: float, dt: float
) -> tuple[Array, Array]:
    """Means (M, nx) one step after x (M, nx), and their covariances."""
    a = np.ascontiguousarray(x[:, : model.na])
    f, A, Q = model.transition(a, u, t, dt, model.record(theta))
    return np.asarray(f + np.einsum("...ij,...j->...i", A, x[:, model.na :])), Q


def _reading(model: MixedModel, theta: Array, x: Array, u: Array, t: float) -> tuple[Array, Array]:
    """Means (M, ny) of what is read at x (M, nx), and their covariances."""
    a = np.ascontiguousarray(x[:, : model.na])
    h, C, R = model.observation(a, u, t, model.record(theta))
    return np.asarray(h + np.einsum("...ij,...j->...i", C, x[:, model.na :])), R
