"""Iterates that ended where they should not.

Few particles can lead EM from a good start to a bad end, and call it settled; with next to no noise its
steps are so short that they seem settled anywhere. The moment filter tells at next to no cost how likely
the end is beside what was passed before, and whether a maximum lies ahead. It is an approximation, so
where it says that the end is far less likely, the particle filter is asked, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from engine.estimation.e_steps import RETRIES, ParticleStep, or_none
from engine.estimation.em_result import EmResult
from engine.estimation.followable import followable
from engine.estimation.likelihood_step import LIKELIER, LikelihoodStep
from engine.estimation.outcome import Outcome
from engine.filters.lost import FAR_NATS, nats_short
from engine.statespace.base import BaseModel, Theta
from engine.words import number

CHECKS = 7  # particle filters at either of two points that the moment filter tells apart
SURE = 3.0  # standard errors of a difference of log-likelihoods
LIKELIEST = 2  # iterates by their E steps are looked at, besides the start and the last
LOST_NATS = 100.0  # by which filters scatter that have lost the series
EXACT_NATS = 0.5  # by which a point ahead is likelier where the likelihood is exact
MOVED = (
    " The particles' own steps ended {:.2g} nats below a point that {} likelihood found from there; it is "
    "the estimate, and filters with other random numbers find it likelier by {}."
)
PASSED_NATS = 2.0  # by which the last iterate must be below the likeliest one
PASSED = (
    " The estimate is iterate {}: the likelihood of the last ones is {} lower, as the steps "
    "of few particles may lead downhill. More particles would go on from there."
)
UNTOLD = (
    " By {} likelihood a point ahead is {:.2g} nats likelier than the estimate: {}. Particle filters of {} "
    "particles cannot tell ({:.2g} +- {:.1g} nats). More particles would; or start there."
)
LOST_THERE = (
    " By {} likelihood a point ahead is {:.2g} nats likelier than the estimate: {}. Particle filters of {} "
    "particles lose the series there, and cannot tell. More particles would, or a larger noise that is held."
)
AGAINST = (
    " By the moment filter the iterates passed parameters that are {:.0f} nats likelier than these; the "
    "particle filter does not say so. More particles would tell which is right."
)


@np.errstate(invalid="ignore")  # where the filter of moments is lost
def looked_back(
    found: EmResult,
    moment: Callable[[Theta], float],
    particles: ParticleStep,
    rows: int,
    seed: int,
) -> EmResult:
    """The result, at a theta of its trace that is far likelier than the last by both filters, if any is.

    ``moment`` gives the moment filter's log-likelihood, ``particles`` the particle filter's of all ``rows``.
    """
    likeliest = np.argsort(-found.log_likelihood)[:LIKELIEST].tolist()
    passed = [
        Theta(found.trace[k], found.theta.names)
        for k in sorted({0, len(found.trace) - 1, *likeliest})
    ]
    before = np.array([moment(theta) for theta in passed])
    k = int(np.argmax(np.where(np.isfinite(before), before, -np.inf)))
    fall = before[k] - moment(found.theta)
    if not fall > FAR_NATS:
        return found
    there, short = _by_particles(found.model, passed[k], particles, rows, seed)
    here, _ = _by_particles(found.model, found.theta, particles, rows, seed)
    if there - here >= FAR_NATS:
        outcome = Outcome.WANDERED
        message = found.message.replace(found.outcome.value, outcome.value)
        return moved(replace(found, outcome=outcome, message=message), passed[k])
    if there < before[k] - short:  # it has lost the series there: its word is none
        return replace(found, message=found.message + AGAINST.format(fall))
    return found


def looked_ahead(
    found: EmResult, likelihood: LikelihoodStep, particles: ParticleStep | None, seed: int
) -> EmResult:
    """The settled result, said to stand still where a point far likelier by both filters lies ahead.

    ``particles`` are not asked where ``likelihood`` is exact.
    """
    there, gain = likelihood.ahead(found.theta, found.free)
    if not gain > (EXACT_NATS if likelihood.exact else FAR_NATS):
        return found
    if particles is not None and not likelihood.exact:
        here, _ = _by_particles(found.model, found.theta, particles, likelihood.rows, seed)
        gain = _by_particles(found.model, there, particles, likelihood.rows, seed)[0] - here
        if not gain > FAR_NATS:
            return found
    outcome = Outcome.STALLED
    said = f"{outcome.value} {gain:.3g} nats were seen ahead."
    return replace(found, outcome=outcome, message=found.message.replace(found.outcome.value, said))


def moved_ahead(
    found: EmResult, likelihood: LikelihoodStep, particles: ParticleStep, seed: int
) -> EmResult:
    """The settled result, at a point that ``likelihood`` finds from there if particles find it likelier, too.

    Scores of few particles are far off where there is next to no process noise, and steps by them may settle
    where they should not.
    """
    whose, least = likelihood.whose, likelihood.telling
    there, ahead = likelihood.ahead(found.theta, found.free, least / 2.0)
    if not ahead > least:
        return found
    indices, first = found.model.free_indices(found.free), Theta(found.trace[0], found.theta.names)
    beside = followable(found.model, there, first, indices, particles, seed)
    if beside is not there:
        there, ahead = beside, likelihood.of(beside) - likelihood.of(found.theta)
    gain, error, n = gain_of(found.theta, there, particles, least, seed)
    # what its own filters find and what others do count alike, where neither is surely right
    against = -min(SURE * error, ahead)
    if gain > (against if likelihood.trusted else max(least, SURE * error)):
        return moved(found, there, MOVED.format(ahead, whose, nats(gain, error)))
    if min(gain, ahead) > FAR_NATS:  # far off filters scatter widely
        return moved(found, there, MOVED.format(ahead, whose, nats(np.inf, 0.0)))
    if ahead > LIKELIER and gain + SURE * error > ahead:
        known = whose, ahead, values_of(there, found), n
        lost = error > LOST_NATS
        said = LOST_THERE.format(*known) if lost else UNTOLD.format(*known, gain, error)
        return undecided(found, said)
    return found


def nats(gain: float, error: float) -> str:
    """A gain in words."""
    finite = np.isfinite(gain)
    return f"{gain:.2g} +- {error:.1g} nats" if finite else f"more than {FAR_NATS:g} nats"


def undecided(found: EmResult, said: str) -> EmResult:
    """The result where nothing can tell whether it is the maximum; other outcomes stay what they are."""
    outcome = Outcome.UNDECIDED if found.outcome is Outcome.CONVERGED else found.outcome
    message = found.message.replace(found.outcome.value, outcome.value) + said
    return replace(found, outcome=outcome, message=message)


def values_of(theta: Theta, found: EmResult) -> str:
    """Those of the free parameters, in words."""
    return ", ".join(f"{name} = {number(theta[name], 4)}" for name in found.free)


def kept_best(found: EmResult, particles: ParticleStep, seed: int) -> EmResult:
    """The result at the likeliest of its iterates, where the last ones have fallen below it.

    Steps by the score of few particles may lead downhill. Filters with other random numbers must find it
    likelier, too.
    """
    values = np.where(np.isfinite(found.log_likelihood), found.log_likelihood, -np.inf)
    k, elsewhere = int(np.argmax(values)), not np.array_equal(found.theta, found.trace[-1])
    if elsewhere or not values[k] - values[-1] > PASSED_NATS:
        return found
    best = Theta(found.trace[k], found.theta.names)
    gain, error, _ = gain_of(found.theta, best, particles, PASSED_NATS, seed, more=())
    if not gain > max(PASSED_NATS, SURE * error):
        return found
    return moved(found, best, PASSED.format(k, nats(gain, error)))


def moved(found: EmResult, theta: Theta, said: str = "") -> EmResult:
    """The result at another theta; ``said`` joins the message, whose end tells which bounds hold it."""
    free, ties = found.free, found.ties
    before, now = (found.model.held_in_words(one, free, ties) for one in (found.theta, theta))
    message = found.message.removesuffix(before).rstrip() + said
    return replace(found, theta=theta, message=f"{message} {now}".rstrip())


def gain_of(
    here: Theta,
    there: Theta,
    particles: ParticleStep,
    least: float,
    seed: int,
    more: Sequence[int] = RETRIES,
) -> tuple[float, float, int]:
    """By how many nats one theta is likelier than another, the standard error, and by how many particles.

    As many particles are taken, up to ``more`` times as many, as it takes to tell it from the ``least``. The
    gain is infinite where no particle is left at one of them.
    """
    seeds = np.random.SeedSequence(seed, spawn_key=(0,)).spawn(2 * CHECKS)
    for times in (1, *more):
        values = np.array(
            [
                particles.log_likelihood(theta, times, np.random.default_rng(s))
                for theta, some in ((here, seeds[:CHECKS]), (there, seeds[CHECKS:]))
                for s in some
            ]
        ).reshape(2, CHECKS)
        there_is, lost = np.isfinite(values[1]).all(), not np.isfinite(values).all()
        if lost:
            return np.inf if there_is else -np.inf, 0.0, times * particles.n_particles
        spread = values.var(axis=1, ddof=1)
        gain = float(np.diff(values.mean(axis=1))[0])
        # half the variance of such a log-likelihood is its bias
        error = float(np.sqrt(spread.sum() / CHECKS) + abs(np.diff(spread)[0]) / 2.0)
        if not abs(gain - least) < SURE * error:
            break
    return gain, error, times * particles.n_particles


def clearly_likelier(here: Theta, there: Theta, particles: ParticleStep, seed: int) -> bool:
    """Whether a theta is likelier than another by more than filters of particles may be wrong."""
    gain, error, _ = gain_of(here, there, particles, LIKELIER, seed)
    return gain > max(LIKELIER, SURE * error)


def _by_particles(
    model: BaseModel, theta: Theta, particles: ParticleStep, rows: int, seed: int
) -> tuple[float, float]:
    """Median log-likelihood of a few filters, and by how much such filters may fall short.

    -inf where the model cannot be had.
    """
    seeds = np.random.SeedSequence(seed, spawn_key=(0,)).spawn(CHECKS)
    steps = [or_none(model, particles.compared, theta, np.random.default_rng(s)) for s in seeds]
    values = np.median([step.log_likelihood for step in steps])
    return float(values), nats_short(rows, float(np.median([step.ess for step in steps])))
