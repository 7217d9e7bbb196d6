"""Another minimum of a free run's error that is as good as the one a fit ended at.

Standard errors know one minimum only. Where a rate of absorption and one of elimination may change places, both
simulate the record alike, many standard errors apart.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import OptimizeResult

from engine.distributions import chi2_quantile
from engine.errors import ModelError
from engine.simulation.problem import FreeRunProblem
from engine.words import number

NEAR = 1.5  # times the least sum of squares: so bad a start may still lead to as good an end ...
ALIKE = 0.05  # ... which is worse by this share at most, or by what 95 % of noises make of it
APART = 5.0  # standard errors


def other_minimum(
    problem: FreeRunProblem, best: OptimizeResult, tried: Sequence[OptimizeResult], evaluations: int
) -> OptimizeResult | None:
    """The best end of those ``tried`` that is as good as ``best``, or better, and has other parameters."""
    k = problem.active.size
    e, J = problem.evaluate(best.x)
    spread = problem.uncertainty(e, J, best.x)
    known = ~spread.tied[:k]
    errors = np.sqrt(np.diag(spread.covariance)[:k])
    worse = max(ALIKE, float(chi2_quantile(0.95, max(k, 1))) / max(len(e) - best.x.size, 1))

    def apart(end: OptimizeResult) -> bool:
        return bool((np.abs(end.x - best.x)[:k] > APART * errors)[known].any())

    for end in sorted(tried, key=lambda one: float(one.cost)):
        if end.cost > NEAR * best.cost or not apart(end):
            continue
        try:
            found = problem.descend(end.x, evaluations)
        except ModelError:
            continue
        if found.cost <= (1.0 + worse) * best.cost and apart(found):
            return found
    return None


def said_of(problem: FreeRunProblem, best: OptimizeResult, other: OptimizeResult) -> str:
    """A sentence on the other minimum."""
    there = ", ".join(
        f"{name} = {number(value, 4)}"
        for name, value in zip(problem.names(problem.active), other.x.tolist(), strict=False)
    )
    more = 100.0 * (np.sqrt(other.cost / best.cost) - 1.0) if best.cost > 0.0 else 0.0
    height = f"larger by {more:.2g} %" if more >= 0.01 else "as small"
    return (
        f"These data hardly tell the estimate from another minimum, at {there}, whose error is {height}. "
        "Standard errors are of the one alone: decide by what else is known, and let bounds leave out the "
        "other."
    )
