"""Iterates that wandered off: few particles can lead EM from a good start to a bad end, and call it settled.

The moment filter tells at next to no cost how likely the end is beside what was passed before. It is an
approximation, so where it says that the end is far less likely, the particle filter is asked, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from engine.estimation.e_steps import FAR_NATS, Expect
from engine.estimation.em_result import EmResult
from engine.estimation.outcome import Outcome
from engine.statespace.base import Theta

CHECKS = 7  # particle filters at either of two points that the moment filter tells apart
LIKELIEST = 2  # iterates by their E steps are looked at, besides the start and the last
AGAINST = (
    " By the moment filter the iterates passed parameters that are {:.0f} nats likelier than these; the "
    "particle filter does not say so. More particles would tell which is right."
)


def looked_back(
    found: EmResult, moment: Callable[[Theta], float], expect: Expect, seed: int
) -> EmResult:
    """The result, at a theta of its trace that is far likelier than the last by both filters, if any is.

    ``moment`` gives the moment filter's log-likelihood, ``expect`` the particle filter's.
    """
    likeliest = np.argsort(-found.log_likelihood)[:LIKELIEST].tolist()
    rows = sorted({0, len(found.trace) - 1, *likeliest})
    passed = [Theta(found.trace[k], found.theta.names) for k in rows]
    *before, end = (moment(theta) for theta in (*passed, found.theta))
    best = passed[int(np.argmax(before))]
    fall = max(before) - end
    if not fall > FAR_NATS:
        return found
    there, here = (_by_particles(theta, expect, seed) for theta in (best, found.theta))
    if there - here < FAR_NATS:
        return replace(found, message=found.message + AGAINST.format(fall))
    outcome = Outcome.WANDERED
    message = found.message.replace(found.outcome.value, outcome.value)
    return replace(found, theta=best, outcome=outcome, message=message)


def _by_particles(theta: Theta, expect: Expect, seed: int) -> float:
    """Median log-likelihood of a few filters."""
    seeds = np.random.SeedSequence(seed, spawn_key=(0,)).spawn(CHECKS)
    values = [expect(theta, np.random.default_rng(s)).log_likelihood for s in seeds]
    return float(np.median(values))
