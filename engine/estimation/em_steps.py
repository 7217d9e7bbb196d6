"""One iteration of an EM: the E step from theta_{k-1}, and the M step, or the step that takes its place.

All random numbers of iteration k come from ``SeedSequence(seed, spawn_key=(k,))``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from engine.errors import ModelError
from engine.estimation.e_steps import EStep, Expect, ParticleStep, or_none
from engine.estimation.followable import followable
from engine.estimation.leaps import STRIDE, leap, surely
from engine.estimation.likelihood_step import LikelihoodStep, score_of
from engine.estimation.maximization import Objective, maximize
from engine.estimation.quasi_newton import Ascent, Memory, Seen
from engine.estimation.wandering import clearly_likelier
from engine.filters.lost import FAR_NATS, nats_apart
from engine.filters.sigma_point import free_thetas
from engine.statespace.base import Array, BaseModel, Theta
from engine.ties import Ties

SHARES = 2.0 ** -np.arange(30.0)  # of a step that is too long


@dataclass(frozen=True, eq=False)
class Expected:
    """The E step at theta_{k-1}, and the point ``at`` that the M step leaves from with its own, ``origin``."""

    seen: EStep
    at: Theta
    origin: EStep


@dataclass(frozen=True, eq=False)
class Maximized:
    """theta_k with the E step before it, the point that the M step left from, and how it went."""

    theta: Theta
    seen: EStep
    finite: bool
    q: Objective
    at: Theta
    by_likelihood: tuple[str, ...] = ()
    whose: str = ""
    stuck: tuple[str, ...] = ()
    memory: Memory | None = None

    def not_moved(self, indices: Sequence[int]) -> tuple[str, ...]:
        """Names of the free parameters that neither Q nor the likelihood depends on."""
        silent = ~(np.diag(self.q.derivatives(self.at, np.array(indices, np.intp))[2]) > 0.0)
        moved = self.by_likelihood
        there = (self.theta.names[k] for k, quiet in zip(indices, silent, strict=True) if quiet)
        names = {*self.stuck, *(name for name in there if name not in moved)}
        return tuple(name for name in self.theta.names if name in names)


@dataclass(frozen=True, eq=False)
class Steps:
    """The two steps of an iteration; iteration k depends on theta_{k-1}, ``seed`` and on nothing else.

    ``by`` is how the M step maximises; the others as in :func:`engine.estimation.em_loop.iterate`.
    """

    model: BaseModel
    expect: Expect
    indices: NDArray[np.intp]
    seed: int
    by: str
    better_starts: Callable[[Theta], Sequence[Theta]] | None
    likelihood: LikelihoodStep | None
    ascent: Ascent | None
    particles: ParticleStep | None

    @property
    def compared(self) -> Expect | None:
        """The E step by filters that do not fall short of the moment filter."""
        return None if self.particles is None else self.particles.compared

    def move(
        self, k: int, passed: Sequence[Theta], memory: Sequence[Memory | None], least: float
    ) -> Maximized:
        """Iteration k from the last theta of those ``passed``; ``least`` as for the E step.

        ``memory`` is what the iterations before it left.
        """
        expected = self.e_step(k, passed[-1], least)
        ascended = self._ascend(k, expected, memory) if self.ascent is not None else None
        return (
            self._leapt(k, self.m_step(expected), passed, memory) if ascended is None else ascended
        )

    def e_step(self, k: int, theta: Theta, least: float) -> Expected:
        """Q(., theta_{k-1}) by smoothing; in the first iteration perhaps also from a better point.

        A log-likelihood below ``least`` is not believed without comparison.
        """
        seed = np.random.SeedSequence(self.seed, spawn_key=(k,))
        rng = np.random.default_rng(seed)
        compared = self.compared or self.expect
        first = compared if least == np.inf else self.expect
        # a model that cannot be had at the start is the caller's to put right
        seen = first(theta, rng) if k == 1 else or_none(self.model, first, theta, rng)
        if seen.log_likelihood < least < np.inf and not seen.failed:
            rng = np.random.default_rng(seed)  # the same numbers, should the moment filter agree
            seen = compared(theta, rng)
        at, origin = theta, seen
        if k == 1:
            by = FAR_NATS if self.ascent is None else 0.0
            for other in self._likeliest(self._starts(theta)):
                there = or_none(self.model, compared, other, rng)
                gain = there.log_likelihood - origin.log_likelihood
                if np.isfinite(there.log_likelihood) and not gain < by:  # nats
                    at, origin, by = other, there, 0.0
        return Expected(seen, at, origin)

    def _starts(self, theta: Theta) -> Sequence[Theta]:
        """Better starts than theta, or points beside them where particles can follow the series."""
        starts = [] if self.better_starts is None else self.better_starts(theta)
        if self.particles is None:
            return starts
        free, particles, seed = self.indices, self.particles, self.seed
        return [followable(self.model, one, theta, free, particles, seed) for one in starts]

    def _likeliest(self, starts: Sequence[Theta]) -> Sequence[Theta]:
        """The first of several starts, or one that particles, where they may be asked, find clearly likelier.

        One filter of few particles cannot tell maxima that are some nats apart. What no data can tell is left
        to whoever chose where to start.
        """
        if len(starts) < 2 or self.particles is None:
            return starts
        best = starts[0]
        for other in starts[1:]:
            if clearly_likelier(best, other, self.particles, self.seed):
                best = other
        return [best]

    def least(self, rows: Sequence[tuple[float, ...]]) -> float:
        """Log-likelihood below which a filter may have lost the series: far below that of one before, ``rows``.

        The first is as likely as it may be, and gives the second nothing to be compared with.
        """
        if self.compared is None or self.likelihood is None or not rows:
            return -np.inf
        value, ess = max((row[:2] for row in rows if np.isfinite(row[0])), default=(np.inf, 1.0))
        return np.inf if len(rows) == 1 else value - nats_apart(self.likelihood.rows, ess)

    def _ascend(
        self, k: int, expected: Expected, memory: Sequence[Memory | None]
    ) -> Maximized | None:
        """theta_k by a step on the log-likelihood; None where it should be EM's."""
        at, q = expected.at, expected.origin.q
        before: list[Memory] = []
        for one in reversed(memory):
            if one is None:
                break
            before.insert(0, one)
        seen = self._seen(at, expected.origin)
        if seen is None or self.ascent is None:
            return None
        found = self.ascent.next(seen[0], before, k)
        if found is None:
            return None
        new, exact = self._possible(q, at, found[0]), seen[1]
        silent = exact & ~(np.diag(seen[0].complete) > 0.0)
        names = np.array(at.names)[self.indices]
        return Maximized(
            new,
            expected.seen,
            True,
            q,
            at,
            tuple(names[exact & ~silent]),
            "" if self.likelihood is None else self.likelihood.whose,
            tuple(names[silent]),
            found[1],
        )

    def _seen(self, at: Theta, step: EStep) -> tuple[Seen, NDArray[np.bool_]] | None:
        """What the E step at a theta told, and which parameters (n,) move what has no noise; None without."""
        x, n = np.asarray(at)[self.indices], len(self.indices)
        if self.ascent is None or not n:
            return None
        value, exact = step.log_likelihood, np.zeros(n, bool)
        score, complete = np.full(n, np.nan), np.zeros((n, n))
        if np.isfinite(value):
            try:
                score, complete, exact = score_of(step.q, at, self.indices, self.likelihood)
            except ModelError:
                return None
        wide = nats_apart(self.ascent.rows, step.ess)
        return Seen(np.asarray(at), x, score, complete, value, wide), exact

    def misled(self, done: Maximized) -> bool:
        """Whether the moment filter is wrong where the M step left from, so that it guides no steps."""
        seen = self._seen(done.at, done.seen) if self.particles is not None else None
        if seen is None or self.ascent is None or not seen[0].finite:
            return False
        return self.ascent.refuted(seen[0])

    def _leapt(
        self, k: int, done: Maximized, passed: Sequence[Theta], memory: Sequence[Memory | None]
    ) -> Maximized:
        """The M step, or where the mean of the last ones leads, if the moment filter is no guide there."""
        last = memory[-STRIDE:]
        alone = len(last) == STRIDE and all(one is None for one in last)
        if k % STRIDE or not alone or self.particles is None or not self.misled(done):
            return done
        points = [*passed[1 - STRIDE :], done.theta]
        found = leap(self.model, points, self.indices, self.particles, self.seed)
        if found is None or not surely(found):
            return done
        new = self._possible(done.q, done.theta, np.asarray(found[0])[self.indices])
        return replace(done, theta=new)

    def _possible(self, q: Objective, at: Theta, goal: Array) -> Theta:
        """Theta with the parameters at their ``goal`` (n,), or as near to it as noise has a covariance."""
        x = np.asarray(at)[self.indices]
        for new in free_thetas(np.asarray(at), self.indices, x + SHARES[:, None] * (goal - x)):
            if q.possible(new):
                return Theta(new, at.names)
        return at

    def ties(self, last: Maximized) -> Ties:
        """Which of the parameters that it moved are only determined together."""
        silent = last.not_moved(list(self.indices))
        moved = np.array([k for k in self.indices if last.at.names[k] not in silent], np.intp)
        if self.likelihood is None or not moved.size:
            return Ties()
        try:
            complete = score_of(last.q, last.at, moved, self.likelihood)[1]
        except ModelError:
            return Ties()
        return self.likelihood.ties(last.at, moved, complete)

    def m_step(self, expected: Expected) -> Maximized:
        """theta_k = arg max Q; what enters without noise is moved by the likelihood instead."""
        seen, at, q = expected.seen, expected.at, expected.origin.q
        if not np.isfinite(expected.origin.log_likelihood):
            return Maximized(at, seen, False, q, at)
        names = np.array(at.names)
        # Q says nothing, or too little, about these
        guides = (
            q.moves_noise_free if self.likelihood is None else partial(self.likelihood.guides, q)
        )
        exact = guides(at, self.indices)
        new = Theta(maximize(q, at, self.indices[~exact], self.by), at.names)
        stuck = exact.copy()
        if exact.any() and self.likelihood is not None:
            new, stuck[exact] = self.likelihood(new, self.indices[exact])
        return Maximized(
            new,
            seen,
            bool(np.isfinite(np.asarray(new)).all()),
            q,
            at,
            tuple(names[self.indices[exact & ~stuck]]),
            "" if self.likelihood is None else self.likelihood.whose,
            tuple(names[self.indices[stuck]]),
        )
