"""Which of several starts a fit of the simulation follows to its end.

Each gets a few evaluations. One of them is fitted to growing parts of the records first, as all are where none
follows the readings, see :mod:`engine.simulation.growing`.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult

from engine.data.given import check_enough
from engine.errors import ModelError
from engine.simulation.growing import grown
from engine.simulation.problem import FreeRunProblem
from engine.statespace.model import Array

POOR = 0.5  # standard deviations of the readings
SHORT = 12  # evaluations that each start gets before the best one is followed to its end


class Progress:
    """What the caller is told: steps done of those known so far, counted on from round to round."""

    def __init__(self, callback: Callable[[int, int], object] | None) -> None:
        self.callback = callback
        self.done = self.steps = self.round = 0

    def begin(self, steps: int) -> None:
        """A round of so many steps."""
        self.steps, self.round = self.done + steps, steps

    def stops(self, more: bool = False) -> bool:
        """Tell that one more step is done, and whether another round follows; whether that stops the fit."""
        self.done += 1
        try:
            steps = self.steps + more * self.round
            return self.callback is not None and self.callback(self.done, steps) is True
        except StopIteration:
            return True


def best_of_starts(
    problem: FreeRunProblem,
    n_starts: int,
    seed: int,
    evaluations: int,
    told: Progress,
) -> tuple[OptimizeResult, list[OptimizeResult], int]:
    """The best of the starts, followed to its end, and all that were tried, unless stopped after so many."""
    problem.look_for_silent()
    check_enough(problem.series, problem.active.size, len(problem.series) * problem.uncertain.size)
    starts = problem.starts(n_starts, np.random.default_rng(seed))
    tried: list[OptimizeResult] = []

    def least() -> OptimizeResult:
        return min(tried, key=lambda end: float(end.cost))

    def ends(p: Array | None) -> bool:
        """Follow a start for a little, where it can be; whether the caller stops at those tried so far."""
        if p is not None:
            with suppress(ModelError):
                tried.append(problem.descend(p, SHORT))
        return told.stops() and bool(tried)

    told.begin(len(starts) + 2)
    if any(map(ends, starts)) or ends(grown(problem, problem.start(), SHORT)):
        return least(), tried, len(tried)
    if not tried:
        problem.runs_away()
    if _follows_poorly(problem, least()):  # all may have slipped
        told.begin(len(starts) + 1)
        if any(ends(grown(problem, start, SHORT)) for start in starts):
            return least(), tried, len(tried)
    return problem.descend(least().x, evaluations), tried, 0


def _follows_poorly(problem: FreeRunProblem, end: OptimizeResult) -> bool:
    """Whether a run leaves a large part of what the readings move."""
    readings = sum(int(one.observed.sum()) for one in problem.series)
    return bool(2.0 * end.cost > (POOR * problem.unit) ** 2 * readings)


def speaks_at_its_end(
    problem: FreeRunProblem, best: OptimizeResult, free: NDArray[np.intp]
) -> bool:
    """Whether parameters that changed nothing at the start do where the fit has ended."""
    if not problem.silent.size:
        return False
    theta, x1 = problem.split(best.x)
    there = FreeRunProblem(problem.model, problem.series, theta, free, x1)
    there.look_for_silent()
    return there.silent.size < problem.silent.size
