"""A start that is fitted to the beginning of the records, then to more and more of them.

Over a long record the error of a free run has many minima, as the phase of an oscillation slips by whole turns
away from where it is right, and an unstable start runs away. Over a short one neither has come far.
"""

from __future__ import annotations

from engine.errors import ModelError
from engine.simulation.problem import FreeRunProblem
from engine.statespace.model import Array

SHARES = (1 / 16, 1 / 8, 1 / 4, 1 / 2)  # of the rows of each record, in turn
READINGS = 2.0  # times what is estimated, at least


def grown(problem: FreeRunProblem, p: Array, evaluations: int) -> Array | None:
    """Where fits over growing parts of the records lead to from p; None where no part can be fitted."""
    found = None
    for share in SHARES:
        parts = [
            one.part(0, one.substeps * max(2, int(share * len(one) / one.substeps)))
            for one in problem.series
        ]
        if sum(int(one.observed.sum()) for one in parts) < READINGS * p.size:
            continue
        part = FreeRunProblem(problem.model, parts, problem.theta, problem.active, problem.x1)
        part.sizes, part.scale, part.at_once = problem.sizes, problem.scale, problem.at_once
        try:
            found = p = part.descend(p, evaluations).x
        except ModelError:
            return found
        finally:
            problem.evaluations += part.evaluations
    return found
