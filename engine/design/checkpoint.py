"""Finished parts of a design, kept so that an interrupted one goes on with the same numbers.

What takes the time are the inputs that are tried and the rivals that adapt to them. A resumed design draws the
same inputs again and finds what they were worth; see :mod:`engine.diagnose.refits.checkpoint`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from engine.arrays import Array
from engine.design.candidates import Candidate, Question
from engine.design.inputs import drawn_plan
from engine.design.runs import simulated
from engine.design.search import Task
from engine.diagnose.refits.checkpoint import NOTHING, Kept, Parts, of_the_same

LOOKED_AT = 50  # readings of a run by which a model is known again


def kept_of(
    parts: Parts | None,
    question: Question,
    task: Task,
    inputs: int,
    seed: int,
    spent: Callable[[float], Any],
) -> Kept:
    """The parts of this very design. Raises OptionError where they are of another one."""
    if parts is None:
        return NOTHING
    every = [*question.candidates, question.base]
    asked = {
        "another model": [_identity(one, task) for one in every],
        "other causes": [_estimates(one) for one in every],
        "other bounds": repr(task.bounds),
        "other options": [
            *(task.length, task.dt, task.hold, task.substeps, task.seen, task.anew),
            *(question.alarm, inputs, seed),
        ],
    }
    return of_the_same("a design", asked, parts, spent)


def _identity(one: Candidate, task: Task) -> list[Any]:
    """Names, and some readings of a run, which tell of functions that have changed."""
    model = one.model
    plan = drawn_plan(np.random.default_rng(0), "steps", model.nu)
    y, _ = simulated(model, one.theta, task.experiments(task.play(plan)[None]))
    seen: Array = y.ravel()[:: max(y.size // LOOKED_AT, 1)]
    channels = [list(names) for names in (model.nonlinear, model.linear, model.outputs)]
    return [one.name, model.name, channels, [f"{value:.9g}" for value in seen.tolist()]]


def _estimates(one: Candidate) -> list[Any]:
    return [one.name, one.theta, one.free, one.information, one.further, one.lead]
