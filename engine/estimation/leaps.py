"""Where the moment filter cannot guide steps, EM's own are followed further, as particles find it likelier.

EM may need hundreds of small steps in one direction, and each of them drowns in its Monte Carlo noise. Their
mean over some iterations does not. So the point that many such steps lead to is tried: filters of particles
with other random numbers tell whether it is likelier. Nothing else is asked of the model.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from engine.errors import EngineError
from engine.estimation.e_steps import RETRIES, ParticleStep
from engine.estimation.em_result import EmResult
from engine.estimation.likelihood_step import LIKELIER
from engine.estimation.wandering import SURE, gain_of, moved, nats, undecided, values_of
from engine.filters.sigma_point import free_thetas
from engine.statespace.base import Array, BaseModel, Theta

STRIDE = 10  # iterations between leaps, whose mean step is followed
LENGTHS = (30.0, 10.0, 3.0)  # in mean steps: gains of long leaps are told most surely
LONGEST = 3.0  # by which the logarithm of a positive parameter changes, at most
EDGE_SHARE = 0.5  # of the way to a bound, at most, is gone, of logarithms where they are taken
RISES = (
    " Steps of EM went on in one direction: a point ahead, {}, is likelier by {} as {} particles tell. "
    "More iterations from there, or more particles, would tell where the maximum is."
)


def ahead(
    model: BaseModel, points: Sequence[Theta], indices: NDArray[np.intp]
) -> Iterator[tuple[float, Theta]]:
    """Lengths in mean steps, and the theta that they lead to from the last of the ``points``, longest first.

    Parameters that are positive change by factors.
    """
    first, last = (np.asarray(one)[indices] for one in (points[0], points[-1]))
    lower, upper = model.lower[indices], model.upper[indices]
    log = (lower >= 0.0) & (first > 0.0) & (last > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        step = np.where(log, np.log(last) - np.log(first), last - first) / (len(points) - 1)
    if not (np.isfinite(step).all() and step.any()):
        return
    for length in LENGTHS:
        change: Array = length * step
        factor = np.exp(np.clip(np.where(log, change, 0.0), -LONGEST, LONGEST))
        goal = np.where(log, last * factor, last + change)
        low = np.where(log, np.sqrt(np.abs(last * lower)), last - EDGE_SHARE * (last - lower))
        goal = np.clip(goal, low, last + EDGE_SHARE * (upper - last))
        theta = free_thetas(np.asarray(points[-1]), indices, goal[None])[0]
        yield length, Theta(theta, points[-1].names)


def leap(
    model: BaseModel,
    points: Sequence[Theta],
    indices: NDArray[np.intp],
    particles: ParticleStep,
    seed: int,
    more: Sequence[int] = RETRIES[:1],
) -> tuple[Theta, float, float, int] | None:
    """The farthest point ahead that particles find surely likelier, or else one that may well be.

    With the gain (nats), its standard error and the number of particles; None where no point may be.
    """
    perhaps = None
    for _, there in ahead(model, points, indices):
        try:
            gain, error, n = gain_of(points[-1], there, particles, 0.0, seed, more)
        except (EngineError, ArithmeticError, ValueError, np.linalg.LinAlgError):
            continue  # out there a user's function may fail
        if not np.isfinite(gain):
            continue
        if gain > max(SURE * error, LIKELIER):
            return there, gain, error, n
        if gain > LIKELIER and perhaps is None:
            perhaps = there, gain, error, n
    return perhaps


def surely(found: tuple[Theta, float, float, int] | None) -> bool:
    """Whether what :func:`leap` found is likelier beyond doubt."""
    return found is not None and found[1] > SURE * found[2]


def looked_far(
    found: EmResult, particles: ParticleStep, indices: NDArray[np.intp], seed: int, window: int
) -> EmResult:
    """The settled result, said to be undecided where the mean of the last steps leads to a likelier point.

    It is moved there where that is sure.
    """
    passed = [Theta(row, found.theta.names) for row in found.trace[-window:]]
    there = leap(found.model, passed, indices, particles, seed, RETRIES)
    if there is None:
        return found
    theta, gain, error, n = there
    said = RISES.format(values_of(theta, found), nats(gain, error), n)
    return undecided(moved(found, theta) if surely(there) else found, said)
