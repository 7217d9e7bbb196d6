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
from engine.diagnose.tails import KIND as TAILS
from engine.diagnose.tails import (
    fit_tails,
    pit_of,
    standardised_errors,
    tail_test,
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
SWALLOWED = ("step", "harmonic", "latent", "parameter-step", "ramp", "drift")
SWALLOWED_REFITS = 6
PLAIN = ("bias", "step", "force", "input-offset", "coulomb", "cubic")  # plainer names first
NESTS = {  # a kind with a width of its own, and plainer ones it becomes at the end of its range
    "stribeck": ("coulomb",),
    "deadzone": ("coulomb", "coupling"),
    "saturation": ("coulomb", "coupling"),
    "variance": ("level",),
}
NEEDED = 2.0  # of the score, that the wider kind must be ahead
SAME = 2.0  # total difference of log-densities below which two refits say the same
OUTLYING = 3.5  # standardised one-step errors beyond this are taken out once outliers are named
TAILS_ALARM = 1e-3  # p-value from which outliers are refitted, whatever their rank

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
    tails: Refit | None = None
    for k in range(max_effects + 1):
        looked_for = None if tails is None else TAILS
        seen = screen_effects(fit, series, setting, kinds, alpha, seed + k, progress, looked_for)
        alarm = seen.p_value <= (alpha if k == 0 else LATER * alpha)
        swallowed: list[Refit] = []
        if not alarm and k == 0:
            seen, swallowed = refit_swallowed(fit, series, seen, progress)
            alarm = seen.p_value <= alpha
        if not alarm or k == max_effects:
            rounds.append(Round(seen, (), None, ()))
            break
        found = refit_best(fit, series, seen, swallowed, progress)
        rounds.append(found)
        if not found.equivalent:
            break
        if found.refits[0].effect.kind != TAILS:
            fit = found.refits[0].fit
            continue
        # the moment filter does not see outliers, so they are taken out before it looks again
        tails, alarm = found.refits[0], False
        if tails.effect.family != "noise" or tails.effect.channel not in model.outputs:
            break
        series = without_outliers(fit, series, tails.effect.channel, seed)
        fit = quasi_ml(fit.model, series, fit.theta, fit.free)
    return Search(base, fit if tails is None else _with_tails(fit, tails), tuple(rounds), alarm)


def without_outliers(fit: QuasiFit, series: Series, output: str, seed: int) -> Series:
    """The series with an output's outlying values missing."""
    j = list(fit.model.outputs).index(output)
    path = moment_path(fit.model, np.asarray(fit.theta), series)
    errors = standardised_errors(path, series.observed, pit_of(fit, series, seed))[:, j]
    y = series.y.copy()
    y[np.abs(np.nan_to_num(errors)) > OUTLYING, j] = np.nan
    return Series(y, series.u, t=series.t, y_names=series.y_names, u_names=series.u_names)


def _with_tails(fit: QuasiFit, tails: Refit) -> QuasiFit:
    """The final fit with the outliers of an earlier round as its last effect."""
    own = [tails.fit.theta[p.name] for p in tails.effect.parameters]
    model = tails.effect.apply(fit.model)
    names = tuple(p.name for p in tails.effect.parameters)
    n, k = len(fit.free), len(names)
    information = np.zeros((n + k, n + k))
    information[:n, :n], information[n:, n:] = fit.information, tails.fit.information[-k:, -k:]
    return replace(
        fit,
        model=model,
        theta=model.theta([*fit.theta, *own]),
        log_likelihood=fit.log_likelihood + 0.5 * tails.gain,
        free=(*fit.free, *names),
        information=information,
    )


def screen_effects(
    fit: QuasiFit,
    series: Series,
    setting: Setting,
    kinds: Sequence[str] | None,
    alpha: float,
    seed: int,
    progress: Progress,
    without: str | None = None,
) -> Screen:
    """Every effect of the catalogue tested on a fitted model, but those of kind ``without``."""
    model, theta = fit.model, np.asarray(fit.theta)
    indices = model.free_indices(fit.free)
    projection = Projection(parameter_columns(model, theta, indices, series))
    path = moment_path(model, theta, series)
    errors = None
    if without != TAILS:
        errors = standardised_errors(path, series.observed, pit_of(fit, series, seed))
    # those of the base model: a change of what an effect itself added is no cause of its own
    effects = [e for e in all_effects(setting, kinds) if e.size.name not in model.parameter_names]
    tests: list[Test] = []
    for i, effect in enumerate(effects):
        progress("screen", i / len(effects))
        try:
            if effect.kind == TAILS:
                test = None if errors is None else tail_test(effect, model, path, errors)
            elif is_timed(effect):
                test = family_test(effect, model, theta, series, path, projection)
            else:
                columns = effect_columns(effect, model, theta, series, path)
                test = make_test(effect, [columns], projection)
        except (EngineError, np.linalg.LinAlgError):
            test = None  # an extension whose filter is lost explains nothing
        if test is not None:
            tests.append(test)
    return screen(tests, np.random.default_rng(np.random.SeedSequence(seed)), alpha)


def refit_swallowed(
    fit: QuasiFit, series: Series, seen: Screen, progress: Progress
) -> tuple[Screen, list[Refit]]:
    """Refits of effects that a fitted Q can swallow, so that their scores see nothing.

    Where process noise has grown to explain a step, the score of the step is small, but refitting
    both gives the noise back. The best few such families are refitted, and the likelihood ratio is
    judged by the tail of the family's own maximum, with Bonferroni over all of these families.
    """
    families = [s for s in seen.scores if s.effect.kind in SWALLOWED and s.statistic > 0.0]
    p_value, refits = seen.p_value, []
    for i, score in enumerate(families[:SWALLOWED_REFITS]):
        progress("refit", i / SWALLOWED_REFITS)
        try:
            refits.append(refit(fit, series, score))
        except (EngineError, np.linalg.LinAlgError):
            continue
        p_value = min(p_value, 2.0 * len(families) * score.p_of(refits[-1].gain))
    return replace(seen, p_value=p_value), refits


def refit_best(
    fit: QuasiFit, series: Series, seen: Screen, done: list[Refit], progress: Progress
) -> Round:
    """Refit the effects with the largest scores, and the unnamed force where it scores best.

    ``done`` are refits that were made before.
    """
    named = [s for s in seen.scores if s.effect.kind != GENERIC and s.statistic > 0.0]
    named.sort(key=lambda s: -_screen_score(s))
    best = _screen_score(named[0]) if named else 0.0
    chosen = [s for s in named[:REFITS] if _screen_score(s) >= WORTH * best]
    tails = [s for s in seen.scores if s.effect.kind == TAILS and s.p_value < TAILS_ALARM]
    chosen += [s for s in tails if s not in chosen]
    generic = [s for s in seen.scores if s.effect.kind == GENERIC and s.statistic > 0.0][:2]
    refits = list(done)
    names = {r.effect.name for r in done}
    left = [s for s in [*chosen, *generic] if s.effect.name not in names]
    for i, score in enumerate(left):
        progress("refit", i / len(left))
        try:
            refits.append(refit(fit, series, score))
        except (EngineError, np.linalg.LinAlgError):
            continue
    unnamed = [r for r in refits if r.effect.kind == GENERIC]
    ranked = sorted((r for r in refits if r.effect.kind != GENERIC), key=lambda r: -r.score)
    equivalent = distinct([r for r in ranked if r.score >= ranked[0].score - MARGIN], series)
    if equivalent:  # of effects that are the same here, the plainer name leads
        ranked = [equivalent[0], *(r for r in ranked if r is not equivalent[0])]
    top = max(unnamed, key=lambda r: r.score) if unnamed else None
    return Round(seen, tuple(ranked), top, equivalent)


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
            rank > _plainness(refits[j]) and np.abs(terms[i] - terms[j]).sum() < SAME for j in kept
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


def _screen_score(score: Score) -> float:
    return score.statistic - cost(score.effect)


def cost(effect: Effect) -> float:
    """What an effect's further parameters must gain before they count."""
    further = len(effect.parameters) - 1 - len(effect.held)
    return 2.0 * further + (TIME_COST if is_timed(effect) else 0.0)


def refit(fit: QuasiFit, series: Series, score: Score) -> Refit:
    """Maximum likelihood of the extended model, started at the score's one-step estimate."""
    effect = score.effect
    extended = effect.apply(fit.model)
    n = len(fit.theta)
    if effect.kind == TAILS:
        return _refit_tails(fit, extended, effect, series)
    start = np.concatenate([fit.theta, [score.size], score.at])
    null = start.copy()
    null[n] = 0.0
    start = np.clip(start, extended.lower, extended.upper)
    own = [p.name for p in effect.parameters]
    sought = [name for name in own if name.endswith("_time")] if is_timed(effect) else []
    fixed = {*sought, *effect.held}
    free = [*fit.free, *(name for name in own if name not in fixed)]
    start = _best_start(extended, series, start, n)
    found = quasi_ml(extended, series, start, free)
    if sought:
        found = _refine_time(extended, series, found, free, sought[0], effect)
    zero = float(log_likelihoods(extended, [series], null[None])[0])
    gain = 2.0 * (found.log_likelihood - zero)
    return Refit(effect, found, gain, gain - cost(effect))


def _refit_tails(fit: QuasiFit, extended: MixedModel, effect: Effect, series: Series) -> Refit:
    """By particles: the moment filter's likelihood does not see outliers."""
    gain, theta = fit_tails(fit, extended, series, seed=0)
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
