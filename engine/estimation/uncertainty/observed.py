"""Standard errors from the observed information, by differences of the score.

The observed information is the negative derivative of the score. Louis' identity would subtract the
variance of the complete-data score from the complete-data information: where EM contracts slowly the
two nearly cancel, and their Monte Carlo noise does not. Differences of the score over half a standard
error to either side need far fewer trajectories. The directions of the differences are the columns of a
square root of the covariance.

The moment filter's information gives these directions, and is what the differences are weighed against: it
has no noise, but is an approximation. In its units the information of the particles is the identity up to the
approximation's error, whose size is that of the differences' deviations in excess of their noise; each is
taken as far as it is known, which takes a few smoothers in place of a hundred. Where it is off by more than a
part, or cannot be had, the directions are found in a first round and refined in a second, and the
differences alone count.

Along a curved ridge they need care: :mod:`engine.estimation.uncertainty.score_differences`.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np

from engine.data.given import as_series_list
from engine.data.series import Series
from engine.distributions import student_quantile
from engine.errors import ModelError, NotSettledWarning
from engine.estimation.long_steps import about_predictions
from engine.estimation.outcome import Outcome
from engine.estimation.own_steps import about_own_steps
from engine.estimation.particle_likelihood import ParticleLikelihood
from engine.estimation.quasi_newton import bounded
from engine.estimation.uncertainty.at_bounds import pressed_onto_bounds, said_of_bounds
from engine.estimation.uncertainty.observed_result import StandardErrors
from engine.estimation.uncertainty.roots import (
    FLOOR,
    floored_inverse,
    good_guess,
    relative_errors,
    root_of_inverse,
    symmetric_root,
)
from engine.estimation.uncertainty.score import Score, inside
from engine.estimation.uncertainty.score_differences import bend_of, whitened_information
from engine.estimation.uncertainty.ties import tied_to_bounds, undetermined
from engine.estimation.vanished import revived_by_particles
from engine.randomness import check_seed
from engine.statespace.model import Array, MixedModel, Theta, ThetaLike
from engine.threads import single_threaded
from engine.ties import tied, ties_in_words, to_hold
from engine.words import enumerated, hardly_told, percent

ROUNDS = 3  # of finding the directions; only the last uses all replicates ...
MOST_ROUNDS = 15  # ... and so many where a round may not widen a direction as far as it should
GUESS = 0.1  # share of the complete-data information that the data usually hold, to start with
REPLICATES = 8
# Standard errors from the maximum; a 95 % interval then holds the truth in 92 % of cases.
SETTLED_ERRORS = 0.5
# So far from a maximum may be by the noise of a few scores: then there are more.
DOUBTFUL_ERRORS = 3.0
FURTHER_SCORES = 12
FEW_REPLICATES = 4  # where the moment filter's information is a good guess
UNCHECKED = (
    "These errors are {} alone: scores by particles are too noisy here to check them (more n_particles and "
    "n_trajectories would)."
)
TRUSTED = 0.1  # relative error that it has at least
# Of the complete-data information, held by the data where there is hardly any noise.
NEXT_TO_NOTHING = 1e-10
DROWNED = 0.25  # variance of whitened differences from which on they tell nothing of the guess ...
SURELY_OFF = 30.0  # ... unless they are off by so many times that
SURELY_DROWNED = 0.5  # the same, where not all of them are made: as much as all would leave
WELL_KNOWN = 0.25 * TRUSTED**2  # from which on further ones would hardly make it better known
MAYBE_SHORT = (Outcome.UNDECIDED, Outcome.STALLED, Outcome.WANDERED)
KNOWN = 0.25  # relative error of an error that is not worth a word


@runtime_checkable
class Estimate(Protocol):
    """What an estimation returns, as far as it matters here; an :class:`engine.EmResult` is one."""

    theta: Theta
    free: tuple[str, ...]
    not_estimated: tuple[str, ...]
    message: str


def of_estimate(
    theta: ThetaLike | Estimate, free: Sequence[str] | None
) -> tuple[ThetaLike, Sequence[str] | None]:
    """The parameters, and the names of those that were estimated where an estimation's result says it."""
    if not isinstance(theta, Estimate):
        return theta, free
    return theta.theta, free or [name for name in theta.free if name not in theta.not_estimated]


@single_threaded
def standard_errors(
    model: MixedModel,
    theta: ThetaLike | Estimate,
    series: Series | Sequence[Series],
    free: Sequence[str] | None = None,
    n_particles: int = 100,
    n_trajectories: int = 100,
    replicates: int | None = None,
    seed: int = 0,
    exact: bool = False,
) -> StandardErrors:
    """Standard errors at an estimate; observed information by differences of the score.

    A free parameter at one of its bounds is held, and so is one next to a bound up to which the likelihood
    rises by next to nothing. Where theta is no maximum of the likelihood, or the end of an estimation that was
    lost, the result is not ``settled``, and a NotSettledWarning is given. Parameters that the data only
    determine together are ``tied``: their errors are infinite, and ``warning`` names them.

    Parameters
    ----------
    model : MixedModel
        The model, paper, eq. (1).
    theta : Theta, mapping, array or EmResult
        The estimate (n_theta,), in the parameters' units; an EmResult also says which parameters are free.
    series : Series or sequence of Series
        One experiment or several; y (T, ny) with NaN where missing, u (T, nu), times.
    free : sequence of str, optional
        Names of the parameters to estimate, all by default; the others keep their start value.
    n_particles : int
        Number of particles M.
    n_trajectories : int
        Number of trajectories N that are drawn, each of weight 1/N.
    replicates : int, optional
        Number of smoothers that each of the 2 n scores is averaged over. By default 4 where the moment filter's
        information is a good guess, else 8; a number given is used with the differences alone.
    seed : int
        Seed of all random numbers; the same seed gives the same result to the last bit.
    exact : bool
        Use the Kalman smoother instead of particles (linear Gaussian models). Without nonlinear states it is
        used unless ``replicates`` is given: nothing is random there.

    Returns
    -------
    StandardErrors
        Covariance (n, n) and standard errors (n_theta,) in the parameters' units.

    Raises
    ------
    ModelError
        The data hold no information on a parameter.
    """
    check_seed(seed)
    found = theta if isinstance(theta, Estimate) else None
    theta, free = of_estimate(theta, free)
    theta = model.theta(theta)
    all_series = as_series_list(series, model)
    exact = exact or (model.na == 0 and replicates is None)  # particles would repeat one another
    every = Score.of(
        model, theta, all_series, model.free_indices(free), n_particles, n_trajectories, exact
    )
    within = np.isin(every.indices, inside(every.model, theta, free))
    score = replace(every, indices=every.indices[within])
    guessing = replicates is None and not exact
    names, most = score.names, 1 if exact else replicates or REPLICATES
    seeds = np.random.SeedSequence(seed).spawn(most)
    if guessing:
        seeds = seeds[:FEW_REPLICATES]
    centre = [every.at(every.x, which) for which in seeds]
    scores, H = np.array([g for g, _ in centre]), np.mean([h for _, h in centre], axis=0)
    drawn, beyond = _drawn_at_bounds(every, scores, np.diag(H))
    drawn = drawn or _vanished(every, seed)
    scores, H = scores[:, within], H[np.ix_(within, within)]
    silent = [name for name, h in zip(names, np.diag(H), strict=True) if not h > 0.0]
    if silent:
        raise ModelError(
            f"the data hold no information on {', '.join(silent)} at this theta; hold it fixed "
            "(free=) or choose other data"
        )
    pressed = pressed_onto_bounds(score, scores, seeds)
    at_bound = [name for name, yes in zip(names, pressed, strict=True) if yes]
    score, scores = replace(score, indices=score.indices[~pressed]), scores[:, ~pressed]
    names, H = score.names, H[np.ix_(~pressed, ~pressed)]
    directions = undetermined(score, H, seed)
    kept = np.delete(np.arange(len(names)), to_hold(directions))
    whole, score = score, replace(score, indices=score.indices[kept])
    H = H[np.ix_(kept, kept)]
    covariance, relative = np.zeros((len(names), len(names))), np.zeros(len(names))
    said = ""
    if kept.size:
        known, known_relative, said = (
            _guessed(score, H, seeds, scores[:, kept]) if guessing else None
        ) or _differences(score, H, np.random.SeedSequence(seed).spawn(most))
        covariance[np.ix_(kept, kept)], relative[kept] = known, known_relative
    # scores that tell nothing of the errors tell nothing of the distance, either: where another filter does
    by_moments = bool(said) and not isinstance(score.likelihood, ParticleLikelihood)
    if by_moments:
        moment = score.likelihood.score(theta, score.indices)[0]
        decrement, noise = float(moment @ covariance[np.ix_(kept, kept)] @ moment), 0.0
    else:
        decrement, noise = score_decrement(covariance, scores)
        if not exact and _doubtful(decrement, noise, len(scores)):
            further = np.random.SeedSequence(seed).spawn(most + FURTHER_SCORES)[most:]
            scores = np.array([*scores, *(whole.at(whole.x, which)[0] for which in further)])
            decrement, noise = score_decrement(covariance, scores)
    away = _surely_away(scores[:, kept], np.diag(H))
    decrement = max(decrement, away)
    failed = said_of_failure(found)
    settled = decrement <= SETTLED_ERRORS**2 + noise and not (away or drawn or failed)
    warning = failed or ("" if settled else _warning(found, decrement, drawn, by_moments))
    if warning:
        warnings.warn(warning, NotSettledWarning, stacklevel=3)  # to the caller
    mean = scores.mean(axis=0)
    error = scores.std(axis=0, ddof=min(len(scores) - 1, 1)) / np.sqrt(len(scores))
    together = [name for name, yes in zip(names, tied(directions), strict=True) if yes]
    errors = dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    sentences = (
        warning or _said_of_the_end(found),
        said,
        ties_in_words(names, directions),
        tied_to_bounds(every, within),
        said_of_bounds(at_bound),
        hardly_told(
            model.hardly_known(theta, {n: e for n, e in errors.items() if n not in together})
        ),
        _said_of_stopped(beyond),
        _said_of_noise(relative),
    )
    warning = " ".join(filter(None, sentences))
    note = about_predictions(model, theta, all_series)
    note = note or about_own_steps(model, theta, names, all_series)
    return StandardErrors(
        model=model,
        theta=theta,
        names=names,
        covariance=covariance,
        score=mean,
        score_error=error,
        relative_error=relative,
        decrement=decrement,
        settled=settled,
        warning=warning,
        note="" if note in warning else note,  # the estimation that it quotes may have said so
        tied=tuple(together),
        drawn=tuple(drawn),
    )


def _differences(
    score: Score, complete: Array, seeds: Sequence[np.random.SeedSequence]
) -> tuple[Array, Array, str]:
    """Covariance (n, n) and relative errors (n,) from differences of the score alone, and no remark."""
    L = before = root_of_inverse(complete / GUESS)
    found = score.information(score.x) if score.exact else None
    guess = None if found is None else bounded(found, complete, NEXT_TO_NOTHING)
    if guess is not None:
        L = before = root_of_inverse(guess)
    for k in range(MOST_ROUNDS - 1):
        G = whitened_information(score, L, seeds[0])
        if not np.isfinite(G).all():  # noise has widened a direction to where no filter follows
            L = before
            break
        before, L = L, L @ symmetric_root(floored_inverse(G))
        if (k >= ROUNDS - 2 or guess is not None) and np.linalg.eigvalsh(G)[0] > FLOOR:
            break  # with little noise the data hold a millionth of the complete-data information
    every = np.array([whitened_information(score, L, which) for which in seeds])
    if not np.isfinite(every).all():
        raise ModelError(
            "the likelihood is not finite within half a standard error of this theta; start the estimation "
            "elsewhere, or use more n_particles"
        )
    every -= bend_of(score, L, every.mean(axis=0))
    refined = L @ symmetric_root(floored_inverse(every.mean(axis=0)))
    relative = relative_errors(L, every)
    if len(every) > 1:  # an inverse kept above FLOOR hides how much of it is noise
        noise = float(np.sqrt(every.var(axis=0, ddof=1).mean() / len(every)))
        relative = np.maximum(relative, 0.5 * noise)
    return refined @ refined.T, relative, ""


def _guessed(
    score: Score, complete: Array, seeds: Sequence[np.random.SeedSequence], scores: Array
) -> tuple[Array, Array, str] | None:
    """The same from the moment filter's information and what differences add; None where it is no guide.

    With a remark where differences, which drown in noise, do not check it. No more of them are made than it
    takes: ``scores`` (R, n) at theta tell beforehand how they will scatter.
    """
    found = score.likelihood.information(np.asarray(score.theta), score.indices)
    guess = None if found is None else bounded(found, complete, NEXT_TO_NOTHING)
    if guess is None:
        return None
    L = root_of_inverse(guess)
    expected = float((scores @ L).var(axis=0, ddof=1).mean())
    made: list[Array] = []
    bend = bend_of(score, L)
    for which in seeds:
        made.append(whitened_information(score, L, which) - bend)
        G = np.array(made)
        n = len(made)
        noise = float(G.var(axis=0, ddof=1).mean() / n) if n > 1 else expected
        deviation = float(((G.mean(axis=0) - np.eye(len(L))) ** 2).mean())
        least = SURELY_DROWNED * len(seeds) / n if n < len(seeds) else DROWNED
        if noise > least and deviation < SURELY_OFF * noise:
            return L @ L.T, np.full(len(L), TRUSTED), UNCHECKED.format(score.likelihood.whose)
        if n > 1 and max(noise, expected / n) < WELL_KNOWN:
            break
    error = max(deviation - noise, TRUSTED**2)
    share = error / (error + noise)  # of a deviation that is believed
    believed = np.eye(len(L)) + share * (G - np.eye(len(L)))
    if not good_guess(believed.mean(axis=0)):
        return None
    refined = L @ symmetric_root(floored_inverse(believed.mean(axis=0)))
    return refined @ refined.T, relative_errors(L, believed), ""


def score_decrement(covariance: Array, scores: Array) -> tuple[float, float]:
    """Newton's decrement of the mean of scores (R, n), and what their noise may add to it (95 %)."""
    mean, R = scores.mean(axis=0), len(scores)
    decrement = float(mean @ covariance @ mean)
    if R < 2:
        return decrement, 0.0
    variance = (scores - mean).T @ (scores - mean) / (R - 1) / R
    # a sum of squares with this mean has its largest quantiles where it is a single square
    return decrement, float(np.trace(covariance @ variance) * student_quantile(0.975, R - 1) ** 2)


def _doubtful(decrement: float, noise: float, R: int) -> bool:
    """Whether more than these R scores are needed to tell a maximum from a point short of one.

    It may be short of one by the noise of so few, or that may hide that it is far from one.
    """
    on_average = noise / float(student_quantile(0.975, max(R - 1, 1))) ** 2
    settled = SETTLED_ERRORS**2
    return settled + on_average < decrement < max(DOUBTFUL_ERRORS**2, settled + noise)


def _surely_away(scores: Array, information: Array) -> float:
    """A squared distance to the maximum that needs no covariance, which noise may make anything; 0 for none.

    In errors that complete data of ``information`` (n,) would leave one parameter by its scores (R, n): what
    they would still gain, the data, which know less, gain more than that.
    """
    mean, R = scores.mean(axis=0), len(scores)
    noise = scores.std(axis=0, ddof=min(R - 1, 1)) / np.sqrt(R)
    surely = np.abs(mean) - float(student_quantile(0.975, max(R - 1, 1))) * noise
    far = surely > SETTLED_ERRORS * np.sqrt(information)
    return float((mean[far] ** 2 / information[far]).max(initial=0.0))


def _drawn_at_bounds(
    score: Score, scores: Array, information: Array
) -> tuple[list[str], list[str]]:
    """Names of parameters at a bound from which the likelihood clearly draws them away, and beyond it."""
    lower, upper = score.bounds
    mean, noise = scores.mean(axis=0), scores.std(axis=0) / np.sqrt(len(scores))
    inward = np.where(score.x <= lower, mean, np.where(score.x >= upper, -mean, 0.0))
    clearly = 2.0 * noise + SETTLED_ERRORS * np.sqrt(np.maximum(information, 0.0))
    names = np.array(score.names)
    return names[inward > clearly].tolist(), names[-inward > clearly].tolist()


def _vanished(score: Score, seed: int) -> list[str]:
    """The parameter next to its lower bound that particles find clearly likelier far from there, if any.

    No score there tells of it.
    """
    if score.particles is None:
        return []
    model, theta = score.model, score.theta
    there = revived_by_particles(model, theta, score.indices, score.particles, seed)
    each = () if there is None else zip(theta.names, theta, there, strict=True)
    return [f"{name} (to some {far:.2g})" for name, here, far in each if far != here]


def _said_of_stopped(names: Sequence[str]) -> str:
    """A sentence about parameters that the likelihood draws beyond their bounds."""
    if not names:
        return ""
    return (
        f"The data draw {enumerated(list(names))} beyond the bound: the errors of the others are right only if "
        "the bound is, as a variance held too small makes them too small."
    )


def _said_of_noise(relative: Array) -> str:
    """A sentence where errors are not known to a quarter."""
    worst = float(relative.max(initial=0.0))
    if worst <= KNOWN:
        return ""
    return (
        f"By the scatter of the particles the errors themselves may be {percent(worst)} off: more n_particles, "
        "n_trajectories or replicates make them better known."
    )


def _warning(
    found: Estimate | None, decrement: float, drawn: list[str], by_moments: bool = False
) -> str:
    said = (
        f"These are no standard errors of an estimate: the likelihood rises from here to a maximum some "
        f"{np.sqrt(decrement):.2g} of them away. Let the estimation go on (more iterations, resume=), or "
        "start it elsewhere."
    )
    if by_moments:
        said = (
            "These may be no standard errors of an estimate: the moment filter's likelihood, exact for linear "
            f"models only, has a maximum some {np.sqrt(decrement):.2g} of them away; particles scatter "
            "too much to tell."
        )
    if drawn:
        said = said_of_drawn("standard errors", drawn)
    return said if found is None else f"{said} The estimation said: {found.message}"


def said_of_drawn(what: str, drawn: Sequence[str]) -> str:
    """A sentence where the likelihood draws parameters away from their bounds, "" without any."""
    if not drawn:
        return ""
    return (
        f"These are no {what} of an estimate: the likelihood rises away from the bound of {', '.join(drawn)}. "
        "Start inside the bounds."
    )


def said_of_failure(found: Estimate | None) -> str:
    """A sentence where an estimation was lost: where the likelihood is flat there, no score tells of it."""
    outcome = getattr(found, "outcome", None)
    if found is None or outcome is None or outcome.success:
        return ""
    return (
        f"There is no estimate that these could be errors of. The estimation said: {found.message}"
    )


def _said_of_the_end(found: Estimate | None) -> str:
    """What an estimation said that may have ended short; scores of a few smoothers may see nothing of it."""
    if found is None or getattr(found, "outcome", None) not in MAYBE_SHORT:
        return ""
    return f"The estimation itself was not sure that this is a maximum. It said: {found.message}"
