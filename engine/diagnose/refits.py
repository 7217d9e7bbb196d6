"""Effects estimated together with the model's parameters, ranked, and told apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine.diagnose.effect import Effect
from engine.diagnose.families import grid, is_timed
from engine.diagnose.screen import (
    Score,
)
from engine.diagnose.tails import KIND as TAILS
from engine.diagnose.tails import (
    fit_tails,
)
from engine.model import Array, MixedModel
from engine.moment_filter import moment_filter
from engine.quasi_ml import QuasiFit, log_likelihoods, quasi_ml
from engine.series import Series

TOLERANCE = 0.02  # of a log-likelihood: refits are compared, the best one is then finished


HOPELESS = 10.0  # of the score behind the best refit, from which another one is given up


PLAIN = (
    "bias",
    "step",
    "force",
    "input-offset",
    "coulomb",
    "cubic",
    "quantisation",
)  # plainer names first


NESTS = {  # a kind with a width of its own, and plainer ones it becomes at the end of its range
    "stribeck": ("coulomb",),
    "deadzone": ("coulomb", "coupling", "linear"),
    "saturation": ("coulomb", "coupling", "linear"),
    "pole": ("linear", "coupling"),
    "mode": ("linear", "coupling", "pole"),
    "variance": ("level",),
}


NEEDED = 2.0  # of the score, that the wider kind must be ahead


SAME = 0.5  # sum of squared differences of log-densities below which two refits say the same


@dataclass(frozen=True, eq=False)
class Refit:
    """An effect estimated together with the model's parameters.

    ``gain`` is 2 (log-likelihood gained), ``score`` that less its costs.
    """

    effect: Effect
    fit: QuasiFit
    gain: float
    score: float

    @property
    def size(self) -> float:
        """The estimated size."""
        return float(self.fit.theta[self.effect.size.name])

    @property
    def standard_error(self) -> float:
        """Its standard error."""
        return float(self.fit.standard_errors[self.fit.free.index(self.effect.size.name)])


def distinct(refits: Sequence[Refit], series: Series) -> tuple[Refit, ...]:
    """The refits without those that say the same in other words.

    A pulse on an integrator is a step of its reading: where two refits predict alike at every
    sample, the plainer kind (see PLAIN) stands for both.
    """
    refits = [r for r in refits if not _merely_wider(r, refits)]
    terms = [held_out_terms(r.fit, series) for r in refits]
    kept: list[int] = []
    for i in sorted(range(len(refits)), key=lambda i: _plainness(refits[i])):
        rank = _plainness(refits[i])
        if not any(
            rank > _plainness(refits[j]) and ((terms[i] - terms[j]) ** 2).sum() < SAME for j in kept
        ):
            kept.append(i)
    return tuple(refits[i] for i in sorted(kept))


def _merely_wider(found: Refit, others: Sequence[Refit]) -> bool:
    """Whether a plainer effect at the same place does as well."""
    effect = found.effect
    return any(
        other.effect.kind in NESTS.get(effect.kind, ())
        and other.effect.channel in (effect.channel, effect.channel.partition("->")[0])
        and found.score < other.score + NEEDED
        for other in others
    )


def _plainness(found: Refit) -> int:
    kind = found.effect.kind
    return PLAIN.index(kind) if kind in PLAIN else len(PLAIN)


def cost(effect: Effect, series: Series) -> float:
    """What an effect's further parameters must gain before they count: log T each (Schwarz 1978)."""
    return further_parameters(effect) * float(np.log(len(series)))


def further_parameters(effect: Effect) -> int:
    """How many parameters are estimated beside the size."""
    return len(effect.parameters) - 1 - len(effect.held)


def _sought(effect: Effect) -> list[str]:
    """Times at which the likelihood jumps: sought on rows, not by slopes."""
    return [p.name for p in effect.parameters if p.name.endswith("_time") and is_timed(effect)]


def free_parameters(effect: Effect) -> list[str]:
    """The effect's own parameters that are estimated by slopes."""
    fixed = {*_sought(effect), *effect.held}
    return [p.name for p in effect.parameters if p.name not in fixed]


def refit(fit: QuasiFit, series: Series, score: Score, best: float = -np.inf) -> Refit:
    """Maximum likelihood of the extended model, started at the score's one-step estimate.

    Given up early where its score will stay far below ``best``, the score of another refit.
    """
    effect = score.effect
    extended = effect.apply(fit.model)
    n = len(fit.theta)
    if effect.kind == TAILS:
        return _refit_tails(fit, extended, effect, series)
    start = np.concatenate([fit.theta, [score.size], score.at])
    null = start.copy()
    null[n] = 0.0
    start = np.clip(start, extended.lower, extended.upper)
    sought = _sought(effect)
    free = [*fit.free, *free_parameters(effect)]
    start, zero = _best_start(extended, series, start, null, n)
    if sought:
        start = _best_row(extended, series, start, sought[0], effect)
    target = zero + 0.5 * (best - HOPELESS + cost(effect, series))
    found = quasi_ml(extended, series, start, free, tolerance=TOLERANCE, target=target)
    if sought and found.log_likelihood > target:
        moved = _best_row(extended, series, np.asarray(found.theta), sought[0], effect)
        if not np.array_equal(moved, found.theta):
            again = quasi_ml(extended, series, moved, free, tolerance=TOLERANCE)
            found = max(found, again, key=lambda one: one.log_likelihood)
    gain = 2.0 * (found.log_likelihood - zero)
    return Refit(effect, found, gain, gain - cost(effect, series))


def _refit_tails(fit: QuasiFit, extended: MixedModel, effect: Effect, series: Series) -> Refit:
    """By a filter that knows outliers, over a grid."""
    gain, theta = fit_tails(fit, effect, series)
    own = [p.name for p in effect.parameters]
    information = np.zeros((len(fit.free) + len(own), len(fit.free) + len(own)))
    information[: len(fit.free), : len(fit.free)] = fit.information
    share = float(theta[len(fit.theta)])
    k = len(fit.free)
    information[k, k] = len(series) / (share * (1.0 - share))  # as if every outlier were known
    found = QuasiFit(
        extended,
        extended.theta(theta),
        fit.log_likelihood + 0.5 * gain,
        (*fit.free, *own),
        information,
        1,
        True,
    )
    return Refit(effect, found, gain, gain - cost(effect, series))


def _best_start(
    extended: MixedModel, series: Series, start: Array, null: Array, n: int
) -> tuple[Array, float]:
    """The best of a few sizes around the one-step estimate, which may overshoot; log-likelihood at null."""
    sizes = np.array([1.0, 0.5, 0.25, 0.1, 2.0, 0.01]) * start[n]
    starts = np.repeat(start[None], len(sizes), axis=0)
    starts[:, n] = np.clip(sizes, extended.lower[n], extended.upper[n])
    values = log_likelihoods(extended, [series], np.concatenate([null[None], starts]))
    return np.asarray(starts[int(np.argmax(values[1:]))]), float(values[0])


def _best_row(
    extended: MixedModel, series: Series, theta: Array, name: str, effect: Effect
) -> Array:
    """Theta with the effect's time moved to the row near it where the likelihood is largest."""
    k = extended.index(name)
    here = int(np.argmin(np.abs(series.t - theta[k])))
    reach = 2
    if effect.kind != "pulse":  # its grid leaves rows out
        reach = int(np.ceil(len(series) / max(len(grid(effect, series)), 1)))
    rows = np.arange(max(here - reach, 1), min(here + reach + 1, len(series) - 1))
    thetas = np.repeat(theta[None], len(rows) + 1, axis=0)
    thetas[1:, k] = series.t[rows]
    values = log_likelihoods(extended, [series], thetas)
    return np.asarray(thetas[int(np.argmax(values))])


def held_out_terms(fit: QuasiFit, series: Series) -> Array:
    """One-step predictive log-densities (T,) of a series under a fitted model."""
    return np.asarray(moment_filter(fit.model, np.asarray(fit.theta)[None], series).log_terms[:, 0])
