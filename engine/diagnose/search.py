"""From alarm to name: screen, refit the best, rank by likelihood, and look again.

Each round screens all effects on the model as extended so far. Without an alarm the search ends.
Otherwise the best effects are refitted together with all parameters, and ranked by

    score = 2 (log-likelihood gained) - 2 (own parameters - 1) - TIME_COST for a time that was sought.

Effects within MARGIN of the best are an equivalence set. The unnamed slow force is refitted in every
round: where it explains clearly more than any named effect, the cause is not in the catalogue.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from engine.diagnose.catalogue import Setting, all_effects
from engine.diagnose.effect import Effect
from engine.diagnose.families import family_test, grid, is_timed
from engine.diagnose.screen import (
    Projection,
    Score,
    Screen,
    Test,
    effect_columns,
    make_test,
    parameter_columns,
    screen,
)
from engine.errors import EngineError
from engine.model import Array, MixedModel
from engine.moment_filter import moment_filter, moment_path
from engine.quasi_ml import QuasiFit, log_likelihoods, quasi_ml
from engine.series import Series

MARGIN = 4.0  # of the score: a likelihood ratio of e^2 = 7
TIME_COST = 4.0  # for a time or frequency found on a grid
REFITS = 12  # effects refitted in a round
WORTH = 0.25  # of the best statistic: below this an effect is not refitted
LATER = 0.2  # of alpha: a second effect needs more than a first, as each round is a new chance
GENERIC = "latent"

Progress = Callable[[str, float], Any]


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


@dataclass(frozen=True, eq=False)
class Round:
    """One round: what the screen saw, what was refitted (best first), and the set that remains."""

    screen: Screen
    refits: tuple[Refit, ...]
    generic: Refit | None
    equivalent: tuple[Refit, ...]


@dataclass(frozen=True, eq=False)
class Search:
    """All rounds; the last one without refits has no alarm. ``base`` and ``final`` fits."""

    base: QuasiFit
    final: QuasiFit
    rounds: tuple[Round, ...]
    alarm_left: bool


def search(
    model: MixedModel,
    series: Series,
    base: QuasiFit,
    setting: Setting,
    *,
    alpha: float,
    max_effects: int,
    kinds: Sequence[str] | None,
    seed: int,
    progress: Progress,
) -> Search:
    """Find the effects a series shows beyond ``base``, one after the other."""
    fit, rounds, alarm = base, [], False
    for k in range(max_effects + 1):
        seen = screen_effects(fit, series, setting, kinds, alpha, seed + k, progress)
        alarm = seen.p_value <= (alpha if k == 0 else LATER * alpha)
        if not alarm or k == max_effects:
            rounds.append(Round(seen, (), None, ()))
            break
        found = refit_best(fit, series, setting, seen, progress)
        rounds.append(found)
        if not found.equivalent:
            break
        fit = found.refits[0].fit
    return Search(base, fit, tuple(rounds), alarm)


def screen_effects(
    fit: QuasiFit,
    series: Series,
    setting: Setting,
    kinds: Sequence[str] | None,
    alpha: float,
    seed: int,
    progress: Progress,
) -> Screen:
    """Every effect of the catalogue tested on a fitted model."""
    model, theta = fit.model, np.asarray(fit.theta)
    indices = model.free_indices(fit.free)
    here = replace(setting, model=model)
    projection = Projection(parameter_columns(model, theta, indices, series))
    path = moment_path(model, theta, series)
    effects = [e for e in all_effects(here, kinds) if e.size.name not in model.parameter_names]
    tests: list[Test] = []
    for i, effect in enumerate(effects):
        progress("screen", i / len(effects))
        try:
            if is_timed(effect):
                test = family_test(effect, model, theta, series, path, projection)
            else:
                columns = effect_columns(effect, model, theta, series, path)
                test = make_test(effect, columns, projection)
        except (EngineError, np.linalg.LinAlgError):
            test = None  # an extension whose filter is lost explains nothing
        if test is not None:
            tests.append(test)
    return screen(tests, np.random.default_rng(np.random.SeedSequence(seed)), alpha)


def refit_best(
    fit: QuasiFit, series: Series, setting: Setting, seen: Screen, progress: Progress
) -> Round:
    """Refit the effects with the largest scores, and the unnamed force where it scores best."""
    named = [s for s in seen.scores if s.effect.kind != GENERIC and s.statistic > 0.0]
    named.sort(key=lambda s: -_screen_score(s))
    best = _screen_score(named[0]) if named else 0.0
    chosen = [s for s in named[:REFITS] if _screen_score(s) >= WORTH * best]
    generic = [s for s in seen.scores if s.effect.kind == GENERIC and s.statistic > 0.0][:2]
    refits: list[Refit] = []
    for i, score in enumerate([*chosen, *generic]):
        progress("refit", i / (len(chosen) + len(generic)))
        try:
            refits.append(refit(fit, series, score))
        except (EngineError, np.linalg.LinAlgError):
            continue
    unnamed = [r for r in refits if r.effect.kind == GENERIC]
    ranked = sorted((r for r in refits if r.effect.kind != GENERIC), key=lambda r: -r.score)
    equivalent = tuple(r for r in ranked if r.score >= ranked[0].score - MARGIN)
    top = max(unnamed, key=lambda r: r.score) if unnamed else None
    return Round(seen, tuple(ranked), top, equivalent)


def _screen_score(score: Score) -> float:
    return score.statistic - cost(score.effect)


def cost(effect: Effect) -> float:
    """What an effect's further parameters must gain before they count."""
    further = len(effect.parameters) - 1
    return 2.0 * further + (TIME_COST if is_timed(effect) else 0.0)


def refit(fit: QuasiFit, series: Series, score: Score) -> Refit:
    """Maximum likelihood of the extended model, started at the score's one-step estimate."""
    effect = score.effect
    extended = effect.apply(fit.model)
    n = len(fit.theta)
    start = np.concatenate([fit.theta, [score.size], score.at])
    null = start.copy()
    null[n] = 0.0
    start = np.clip(start, extended.lower, extended.upper)
    own = [p.name for p in effect.parameters]
    sought = [name for name in own if name.endswith("_time")] if is_timed(effect) else []
    free = [*fit.free, *(name for name in own if name not in sought)]
    start = _best_start(extended, series, start, n)
    found = quasi_ml(extended, series, start, free)
    if sought:
        found = _refine_time(extended, series, found, free, sought[0], effect)
    zero = float(log_likelihoods(extended, [series], null[None])[0])
    gain = 2.0 * (found.log_likelihood - zero)
    return Refit(effect, found, gain, gain - cost(effect))


def _best_start(extended: MixedModel, series: Series, start: Array, n: int) -> Array:
    """The best of a few sizes around the one-step estimate, which may overshoot."""
    sizes = np.array([1.0, 0.5, 0.25, 0.1, 2.0, 0.01]) * start[n]
    starts = np.repeat(start[None], len(sizes), axis=0)
    starts[:, n] = np.clip(sizes, extended.lower[n], extended.upper[n])
    values = log_likelihoods(extended, [series], starts)
    return np.asarray(starts[int(np.argmax(values))])


def _refine_time(
    extended: MixedModel,
    series: Series,
    found: QuasiFit,
    free: Sequence[str],
    name: str,
    effect: Effect,
) -> QuasiFit:
    """Move a time to the row where the likelihood is largest, then fit once more."""
    k = extended.index(name)
    theta = np.asarray(found.theta)
    here = int(np.argmin(np.abs(series.t - theta[k])))
    reach = (
        2
        if effect.kind == "pulse"
        else int(np.ceil(len(series) / max(len(grid(effect, series)), 1)))
    )
    rows = np.arange(max(here - reach, 1), min(here + reach + 1, len(series) - 1))
    thetas = np.repeat(theta[None], len(rows), axis=0)
    thetas[:, k] = series.t[rows]
    values = log_likelihoods(extended, [series], thetas)
    best = int(np.argmax(values))
    if rows[best] == here or not values[best] > found.log_likelihood:
        return found
    return quasi_ml(extended, series, thetas[best], free)


def setting_for(model: MixedModel, series: Series, theta: Array) -> Setting:
    """Typical sizes of every channel, from the data and the filter's means."""
    path = moment_path(model, theta, series)
    scale: dict[str, float] = {}
    for i, name in enumerate([*model.nonlinear, *model.linear]):
        scale[name] = float(np.sqrt(np.mean(path.filtered[:, i] ** 2)))
    for i, name in enumerate(model.inputs):
        scale[name] = float(np.sqrt(np.mean(series.u[:, i] ** 2)))
    for i, name in enumerate(model.outputs):
        scale[name] = float(np.sqrt(np.nanmean(series.y[:, i] ** 2)))
    return Setting(
        model, scale, (float(series.t[0]), float(series.t[-1])), float(np.median(series.steps))
    )


def held_out_terms(fit: QuasiFit, series: Series) -> Array:
    """One-step predictive log-densities (T,) of a series under a fitted model."""
    return np.asarray(moment_filter(fit.model, np.asarray(fit.theta)[None], series).log_terms[:, 0])
