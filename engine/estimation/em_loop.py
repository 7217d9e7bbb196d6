"""The loop of Algorithm 1 of the paper, for any E step: E step, M step, settled?

Iteration k draws all its random numbers from ``SeedSequence(seed, spawn_key=(k,))`` and looks at
nothing but the trace before it, so a run stopped after any iteration and resumed from its
:class:`Checkpoint` gives the same bits as one that was never stopped.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from engine.errors import OptionError, check_count
from engine.estimation.convergence import WINDOW, has_settled, mean_point
from engine.estimation.e_steps import LOST_SHARE, Expect, ParticleStep
from engine.estimation.em_result import Checkpoint, EmResult, Iteration
from engine.estimation.em_steps import Maximized, Steps
from engine.estimation.expectation import parameter_scale
from engine.estimation.leaps import looked_far
from engine.estimation.likelihood_step import LikelihoodStep
from engine.estimation.maximization import check_m_step
from engine.estimation.outcome import Outcome
from engine.estimation.quasi_newton import Ascent, Memory, width
from engine.estimation.scattered import filters_that_fell
from engine.estimation.summit import Summit
from engine.estimation.vanished import revived_by_particles
from engine.estimation.wandering import (
    kept_best,
    looked_ahead,
    looked_back,
    moved_ahead,
)
from engine.randomness import check_seed
from engine.statespace.base import Array, BaseModel, Theta, ThetaLike
from engine.ties import Ties

NOTHING_FREE = "Nothing was estimated: no parameter is free."
TOLD_SHARE = 0.01  # of rows with one particle left, that is worth a word

Callback: TypeAlias = Callable[[Iteration], Any]


@dataclass(frozen=True)
class Loop:
    """The options of every EM: start, free parameters, when it ends, and who sees each iteration.

    Fields as in :func:`engine.estimation.em.rbps_em`; ``resume`` comes before ``theta0``.
    """

    theta0: ThetaLike = None
    free: Sequence[str] | None = None
    n_iterations: int = 100
    seed: int = 0
    callback: Callback | None = None
    resume: Checkpoint | EmResult | None = None
    m_step: str = "scoring"
    tolerance: float | None = 1e-3


def iterate(
    model: BaseModel,
    expect: Expect,
    loop: Loop,
    better_starts: Callable[[Theta], Sequence[Theta]] | None = None,
    likelihood: LikelihoodStep | None = None,
    ascent: Ascent | None = None,
    particles: ParticleStep | None = None,
    summit: Summit | None = None,
) -> EmResult:
    """Algorithm 1 of the paper: E step, M step, settled?

    ``better_starts`` may name points; the first iteration leaves from one that is far more likely;
    ``likelihood`` moves the parameters to which the Q-function is no guide. ``ascent`` replaces the M step
    where it can. ``particles`` are ``expect`` where more of them may be taken, as few may lose the series.
    ``summit`` ends a run whose likelihood is exact.
    """
    n = loop.n_iterations
    check_count("n_iterations", n)
    check_seed(loop.seed)
    check_m_step(loop.m_step)
    if loop.tolerance is not None and not loop.tolerance >= 0.0:  # NaN is not
        raise OptionError(
            f"tolerance = {loop.tolerance}; a number from 0 on is needed", "tolerance"
        )
    indices = model.free_indices(loop.free)
    log = _Log(model, loop, len(indices) if ascent is not None else 0)
    steps = Steps(
        model, expect, indices, loop.seed, loop.m_step, better_starts, likelihood, ascent, particles
    )
    outcome, last = Outcome.ITERATIONS_USED_UP, None

    def elsewhere() -> Theta | None:
        if particles is None or (summit is not None and summit.serves(log.theta)):
            return None
        return revived_by_particles(model, log.theta, indices, particles, loop.seed)

    settled = log.settled(indices)
    for k in range(log.k + 1, n + 1):
        passed, memory = log.trace, log.memory
        if settled:
            start = elsewhere()
            if start is None:
                break
            passed, memory = [start], [None]
        started = time.perf_counter()
        last = steps.move(k, passed, memory, steps.least(log.rows))
        seconds = time.perf_counter() - started
        it = log.add(k, last, seconds)
        if not last.finite:
            outcome = Outcome.DIVERGED
            break
        settled = log.settled(indices)
        if _stops(loop.callback, it):
            outcome = Outcome.STOPPED_BY_CALLER
            break
    else:
        settled = settled and elsewhere() is None
    if settled and outcome is not Outcome.STOPPED_BY_CALLER:
        outcome = Outcome.CONVERGED
    if last is None and log.k:  # all was done before: the last iteration again, for what it said
        last = steps.move(log.k, log.trace[:-1], log.memory[:-1], steps.least(log.rows[:-1]))
    names = tuple(model.parameter_names[i] for i in indices)
    ties = Ties() if last is None or outcome is Outcome.DIVERGED else steps.ties(last)
    found = log.result(names, outcome, last, ties)
    if likelihood is None or not log.k or outcome is Outcome.DIVERGED:
        return found
    chance = ascent is not None and log.had_a_chance(found.outcome)
    exact = summit if summit is not None and summit.serves(found.theta) else None
    if exact is not None and chance:
        found = exact(found)
    elif particles is not None and chance:
        found = moved_ahead(found, likelihood, particles, loop.seed)
        if last is not None and log.by_em and steps.misled(last):
            found = looked_far(found, particles, indices, loop.seed, WINDOW)
    elif outcome is Outcome.CONVERGED is found.outcome and log.memory[-1] is None:
        found = looked_ahead(found, likelihood, particles, loop.seed)
    if exact is not None and not chance:
        found = exact.unsaid(found)
    if particles is None:
        return found
    if exact is None:
        found = filters_that_fell(found, log.averaged, likelihood.rows, particles.n_particles)
    if ascent is not None:
        found = kept_best(found, particles, loop.seed)
    return looked_back(found, likelihood.of, particles, likelihood.rows, loop.seed)


def _said_of_noise_free(names: Sequence[str], whose: str) -> str:
    """A sentence about parameters that the likelihood estimated and not EM."""
    act = "It acts" if len(names) == 1 else "They act"
    return (
        f" Estimated by scoring on {whose} likelihood: {', '.join(names)}. {act} where the model has no noise, "
        "on a first state, a state or a reading, or where it jumps, about which EM alone learns nothing."
    )


def _stops(callback: Callback | None, iteration: Iteration) -> bool:
    if callback is None:
        return False
    try:
        return callback(iteration) is True
    except StopIteration:
        return True


class _Log:
    """The trace as it grows."""

    def __init__(self, model: BaseModel, loop: Loop, n: int) -> None:
        self.model, self.loop, self.n = model, loop, n
        self.memory: list[Memory | None] = []
        resume = loop.resume
        if resume is None:
            self.trace = [model.theta(loop.theta0)]
            self.rows: list[tuple[float, float, float, float]] = []
            return
        if resume.trace.shape != (len(resume.log_likelihood) + 1, len(model.parameters)):
            raise OptionError(
                f"resume has a trace of shape {resume.trace.shape} and "
                f"{len(resume.log_likelihood)} log-likelihoods; model '{model.name}' needs "
                f"(k + 1, {len(model.parameters)}) and k",
                "resume",
            )
        self.trace = [model.theta(row) for row in resume.trace]
        columns = (resume.log_likelihood, resume.ess, resume.seconds, resume.collapsed)
        self.rows = list(zip(*(column.tolist() for column in columns), strict=True))
        known = [Memory.of(row, n) for row in resume.memory] if n else []
        self.memory = known if len(known) == self.k else [None] * self.k

    @property
    def k(self) -> int:
        return len(self.rows)

    @property
    def theta(self) -> Theta:
        return self.trace[-1]

    def add(self, k: int, done: Maximized, seconds: float) -> Iteration:
        step, n = done.seen, self.loop.n_iterations
        self.trace.append(done.theta)
        self.memory.append(done.memory)
        health = (step.log_likelihood, step.ess, seconds, step.collapsed)
        self.rows.append(health)
        return Iteration(k, n, done.theta, *health, self._packed(done.memory))

    def _packed(self, memory: Memory | None) -> Array:
        return np.full(width(self.n) if self.n else 0, np.nan) if memory is None else memory.row()

    def settled(self, indices: Any) -> bool:
        tolerance = self.loop.tolerance
        if tolerance is None:
            return False
        if not len(indices):
            return self.k > 0
        if self.memory and self.memory[-1] is not None:
            return self.memory[-1].settled
        if self.k < 2 * WINDOW or any(m is not None for m in self.memory[-2 * WINDOW :]):
            return False
        trace = np.array(self.trace[-2 * WINDOW - 1 :])
        theta = np.asarray(self.theta)
        scale = np.array([parameter_scale(self.model, theta, k) for k in indices])
        return has_settled(trace[:, indices], scale, tolerance)

    @property
    def averaged(self) -> int:
        """How many of the last iterations a settled estimate rests on; the first may be far away."""
        last = self.memory[-1] if self.memory else None
        return max(0, min(WINDOW if last is None else last.images, self.k - 1))

    @property
    def by_em(self) -> bool:
        """Whether the last iterates are EM's."""
        return all(one is None for one in self.memory[-WINDOW:])

    def had_a_chance(self, outcome: Outcome) -> bool:
        """Whether the iterates have settled, or were given enough iterations for it."""
        enough = self.loop.tolerance is not None and self.k >= 2 * WINDOW
        return outcome is Outcome.CONVERGED or (outcome is Outcome.ITERATIONS_USED_UP and enough)

    def result(
        self, names: tuple[str, ...], outcome: Outcome, last: Maximized | None, ties: Ties
    ) -> EmResult:
        trace = np.array([np.asarray(row) for row in self.trace])
        log_likelihood, ess, seconds, collapsed = np.array(self.rows).reshape(-1, 4).T
        theta = trace[-1]
        if outcome is Outcome.CONVERGED and self.memory[-1] is None:
            theta = mean_point(trace[-WINDOW:])
        # of the end alone: a start from which the run came away says nothing of where it is
        lost = collapsed[-min(WINDOW, (self.k + 1) // 2) :].mean() if self.k else 0.0
        if outcome is not Outcome.DIVERGED and lost > LOST_SHARE:
            outcome = Outcome.COLLAPSED
        message = outcome.value if names or not outcome.success else NOTHING_FREE
        if last is not None and last.seen.failed:
            message += f" The model cannot be had at the last iterate: {last.seen.failed}."
        if lost >= TOLD_SHARE:
            message += f" The filter was left with one particle at {100 * lost:.1f} % of the rows."
        stuck: tuple[str, ...] = ()
        if last is not None and outcome is not Outcome.DIVERGED:
            stuck = last.not_moved([self.model.index(name) for name in names])
        if last is not None and last.seen.times > 1:
            message += f" The last E step took {last.seen.times} times the particles, as fewer lost the series."
        if last is not None and last.by_likelihood:
            message += _said_of_noise_free(last.by_likelihood, last.whose)
        if stuck:
            message += (
                f" Not estimated, as the likelihood does not depend on them here or cannot be had: "
                f"{', '.join(stuck)}. Hold them fixed (free=), or start elsewhere."
            )
        message = f"{message} {ties.in_words}".rstrip()
        estimate = Theta(theta, self.model.parameter_names)
        if outcome is not Outcome.DIVERGED:
            held = self.model.held_in_words(estimate, names, ties)
            message = f"{message} {held}".rstrip()
        return EmResult(
            self.model,
            names,
            estimate,
            trace,
            log_likelihood,
            ess,
            seconds,
            collapsed,
            outcome,
            message,
            stuck,
            np.array([self._packed(m) for m in self.memory]).reshape(self.k, -1),
            ties,
        )
