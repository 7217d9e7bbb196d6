"""Whether the parameters of a model that makes its own steps are those of a step so long.

A model that is written by Euler's rule fits a linear record as well as the differential equation does, at other
parameters: of a lag of 0.25 s, sampled every 0.15 s, it makes one of 0.33 s. Nothing is wrong with its
predictions, so nothing is found; and its standard errors know nothing of it. Models that are ``continuous``
make finer steps where they are asked to, see :mod:`engine.simulation.step_length`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from engine.data.series import Series
from engine.errors import EngineError
from engine.simulation.problem import FreeRunProblem
from engine.statespace.half_steps import halving_changes, in_half_steps
from engine.statespace.model import Array, MixedModel, Theta
from engine.words import enumerated, with_unit

MOVED = 2.0  # standard errors
SHOWN = 3  # parameters that are told, those first that move most
LOOKED_AT = 1000  # rows: a drive with friction may turn in one of a hundred
AS_WELL = 1.04  # times the sum of squares
EVALUATIONS = 12  # of runs with two half-steps


def moved_in_words(
    model: MixedModel,
    theta: Theta,
    moves: Mapping[str, float],
    errors: Mapping[str, float],
) -> str:
    """A sentence where ``moves``, what two half-steps add to parameters, exceed their ``errors``; else ""."""
    shares = {name: abs(moves[name]) / e for name, e in errors.items() if e > 0.0}
    moved = [
        name for name in sorted(shares, key=lambda name: -shares[name]) if shares[name] > MOVED
    ]
    if not moved:
        return ""
    told = [
        f"{name} would be {with_unit(theta[name] + moves[name], unit)} instead of "
        f"{with_unit(theta[name], unit)}"
        for name in moved[:SHOWN]
        for unit in [model.parameters[model.index(name)].unit]
    ]
    return (
        "The parameters are those of steps as long as the model makes them: with two steps of half the length "
        f"the record is explained as well, and {enumerated(told)}. Their errors do not say so. Where the model "
        "stands for differential equations, write these with engine.continuous, which makes exact or shorter "
        "steps, or make several steps in its dynamics."
    )


def may_be_too_long(model: MixedModel, theta: Array, x: Array, series: Series) -> bool:
    """Whether the model makes its own steps, and shorter ones do something else at states x (T, nx)."""
    if model.continuous or model.steps_counted or len(x) < 2:
        return False
    rows = np.unique(np.linspace(0, len(x) - 2, LOOKED_AT).astype(int))
    try:
        return halving_changes(
            model, theta, x[rows], series.u[rows], series.t[rows], series.steps[rows]
        )
    except EngineError:
        return False


def about_own_free_runs(
    problem: FreeRunProblem, p: Array, runs: Sequence[Array], errors: Mapping[str, float]
) -> str:
    """A sentence where free runs by half-steps fit as well, with other parameters; "" where they do not.

    ``p`` is where the problem's search ended, ``runs`` (T, nx) those of all series from there, and
    ``errors`` are the standard errors of the parameters.
    """
    model, (theta, x1) = problem.model, problem.split(p)
    each = zip(runs, problem.series, strict=True)
    if not any(may_be_too_long(model, np.asarray(theta), run, one) for run, one in each):
        return ""
    try:
        halves = FreeRunProblem(in_half_steps(model), problem.series, theta, problem.active, x1)
        halves.look_for_silent()
        end = halves.descend(halves.start(), EVALUATIONS)
    except EngineError:
        return ""
    if not 2.0 * end.cost <= AS_WELL * float(np.sum(problem.residuals(p) ** 2)):
        return ""
    moved = np.asarray(halves.split(end.x)[0]) - np.asarray(theta)
    return moved_in_words(model, theta, dict(zip(theta.names, moved.tolist(), strict=True)), errors)
