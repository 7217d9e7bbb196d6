"""From alarm to name: screen, refit the best, rank by likelihood, and look again.

Each round screens all effects on the model as extended so far. Without an alarm the search ends.
Otherwise the best effects are refitted together with all parameters, and ranked by

    score = 2 (log-likelihood gained) - log T (own parameters - 1).

An alarm counts where the likelihood ratio of some refit confirms it. Effects within MARGIN of the best
are an equivalence set. The unnamed slow force is refitted in every round, and belongs to the set within
UNNAMED_MARGIN: where it explains as much as any named effect, the cause is not in the catalogue.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import chi2

from engine.diagnose.catalogue import all_effects
from engine.diagnose.columns import Projection, effect_columns, parameter_columns
from engine.diagnose.effect import Effect
from engine.diagnose.families import family_test, is_timed
from engine.diagnose.kept import NOTHING, Kept
from engine.diagnose.look_back import look_back
from engine.diagnose.refits import Refit, cost, refit
from engine.diagnose.rounds import GENERIC, Round, settle
from engine.diagnose.screen import Screen, Test, make_test, screen
from engine.diagnose.setting import Setting
from engine.diagnose.tails import KIND as TAILS
from engine.diagnose.tails import (
    fit_tails,
    pit_of,
    standardised_errors,
    tail_test,
)
from engine.errors import EngineError, OptionError
from engine.model import MixedModel
from engine.moment_filter import moment_path
from engine.quasi_ml import QuasiFit, quasi_ml
from engine.series import Series

REFITS = 12  # effects refitted in a round
WORTH = 0.4  # of the best statistic: below this an effect is not refitted ...
AT_LEAST = 6  # ... unless it is among the first few: large effects bend the scores of others

# of alpha: for the first screen, whose p-values come out some 1.5 to 2 times too small (of 141 clean series
# 12 had one of at most 0.04); for the refits after it, whose maximum between a grid's points is larger than
# on it; and for later screens, as each round is a new chance
SCREENED, REFITTED, LATER = 0.6, 0.1, 0.1

SWALLOWED = ("step", "harmonic", "latent", "parameter-step", "ramp", "drift")  # by a fitted Q
SWALLOWED_REFITS = 6

OUTLYING = 3.5  # standardised one-step errors beyond this are taken out once outliers are named
TAILS_ALARM = 1e-3  # p-value from which outliers are refitted, whatever their rank

Progress = Callable[[str, float], Any]


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
    kept: Kept = NOTHING,
) -> Search:
    """Find the effects a series shows beyond ``base``, one after the other; ``kept`` is done already."""
    fit, rounds, alarm = base, [], False
    tails: Refit | None = None
    for k in range(max_effects + 1):
        taken = None if tails is None else tails.effect
        level = alpha if k == 0 else LATER * alpha
        here = kept.within(f"round {k + 1}")
        screened = partial(
            screen_effects, fit, series, setting, kinds, level, seed + k, progress, taken
        )
        progress("screen", 0.0)
        try:
            seen = here.screen(all_effects(setting, kinds), screened)
        except OptionError:
            if k == 0:
                raise
            alarm = False  # all that was asked for is found
            break
        if k == 0:
            seen = replace(seen, p_value=min(1.0, seen.p_value / SCREENED))
        alarm = seen.p_value <= level
        swallowed: list[Refit] = []
        if not alarm and k == 0:
            seen, swallowed = refit_swallowed(fit, series, seen, progress, here)
            alarm = seen.p_value <= alpha
        if not alarm or k == max_effects:
            rounds.append(Round(seen, (), None, ()))
            break
        found = refit_best(fit, series, seen, swallowed, progress, here)
        if not swallowed:
            found = confirmed(found)
            alarm = found.screen.p_value <= level or not found.refits
        if not alarm:
            rounds.append(replace(found, refits=(), generic=None, equivalent=()))
            break
        rounds.append(found)
        if not found.equivalent:
            break
        if found.refits[0].effect.kind != TAILS:
            best = found.refits[0].fit
            fit = here.fit(best.model, partial(_finished, best, series))
            continue
        # the moment filter does not see outliers, so they are taken out before it looks again
        tails, alarm = found.refits[0], False
        if tails.effect.family != "noise" or tails.effect.channel not in model.outputs:
            break
        series = without_outliers(fit, series, tails.effect.channel, seed)
        fit = here.fit(fit.model, partial(quasi_ml, fit.model, series, fit.theta, fit.free))
    named = [found for found in rounds if found.equivalent]
    if tails is None and len(named) > 1:
        fit, named = look_back(base, named, series, kept)
        rounds[: len(named)] = named
    return Search(base, fit if tails is None else _with_tails(fit, tails), tuple(rounds), alarm)


def _finished(fit: QuasiFit, series: Series) -> QuasiFit:
    """A refit to the usual tolerance; as it is where its likelihood is on an edge."""
    try:
        return quasi_ml(fit.model, series, fit.theta, fit.free)
    except EngineError:
        return fit


def without_outliers(fit: QuasiFit, series: Series, output: str, seed: int) -> Series:
    """The series with an output's outlying values missing."""
    j = list(fit.model.outputs).index(output)
    path = moment_path(fit.model, np.asarray(fit.theta), series)
    errors = standardised_errors(path, series.observed, pit_of(fit, series, seed))[:, j]
    y = series.y.copy()
    y[np.abs(np.nan_to_num(errors)) > OUTLYING, j] = np.nan
    return series.replace(y=y)


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
    outliers: Effect | None = None,
) -> Screen:
    """Every effect of the catalogue tested on a fitted model.

    With ``outliers`` found and taken out no others are looked for, nor is their channel's noise: what
    is left of it, smaller outliers and a cut, is no finding of its own.
    """
    model, theta = fit.model, np.asarray(fit.theta)
    indices = model.free_indices(fit.free)
    projection = Projection(parameter_columns(model, theta, indices, series))
    path = moment_path(model, theta, series)
    errors = None
    if outliers is None:
        errors = standardised_errors(path, series.observed, pit_of(fit, series, seed))
    # those of the base model: a change of what an effect itself added is no cause of its own
    effects = [e for e in all_effects(setting, kinds) if e.size.name not in model.parameter_names]
    if outliers is not None:
        left = outliers.channel
        effects = [e for e in effects if e.kind != TAILS and not _noise_of(e, left)]
    tests: list[Test] = []
    for i, effect in enumerate(effects):
        progress("screen", i / len(effects))
        try:
            if effect.kind == TAILS:
                test = None if errors is None else tail_test(effect, model, path, errors)
                if test is not None:
                    test = _confirmed(test, fit, series)
            elif is_timed(effect):
                test = family_test(effect, model, theta, series, path, projection)
            else:
                columns = effect_columns(effect, model, theta, series, path)
                test = make_test(effect, [columns], projection)
        except (EngineError, np.linalg.LinAlgError):
            test = None  # an extension whose filter is lost explains nothing
        if test is not None:
            tests.append(test)
    if not tests:
        raise OptionError(
            f"none of the effects asked for can be tested on model '{model.name}' and these data",
            "effects",
        )
    return screen(tests, np.random.default_rng(np.random.SeedSequence(seed)), alpha)


def _noise_of(effect: Effect, channel: str) -> bool:
    """Whether an effect changes the size of a channel's noise."""
    return effect.kind in ("level", "variance") and effect.channel.partition("->")[0] == channel


def _confirmed(test: Test, fit: QuasiFit, series: Series) -> Test:
    """A test of tails that would raise an alarm, judged by the refitted likelihood ratio instead.

    Predictions by few particles, or by moments where densities are far from Gaussian, look heavy-tailed
    too; then outliers in the model gain nothing.
    """
    if test.known is None or test.known[1] > TAILS_ALARM:
        return test
    gain, _ = fit_tails(fit, test.effect, series)
    ratio = max(gain, 0.0)
    if ratio >= test.known[0]:
        return test
    return replace(test, known=(ratio, 0.5 * float(chi2.sf(ratio, 1))))


def refit_swallowed(
    fit: QuasiFit, series: Series, seen: Screen, progress: Progress, kept: Kept = NOTHING
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
            once = partial(refit, fit, series, score)
            refits.append(kept.refit(fit.model, score.effect, once))
        except (EngineError, np.linalg.LinAlgError):
            continue
        p_value = min(p_value, len(families) / REFITTED * score.p_of(refits[-1].gain))
    return replace(seen, p_value=p_value), refits


def refit_best(
    fit: QuasiFit,
    series: Series,
    seen: Screen,
    done: list[Refit],
    progress: Progress,
    kept: Kept = NOTHING,
) -> Round:
    """Refit the effects with the largest scores, and the unnamed force where it scores best.

    ``done`` are refits that were made before.
    """
    named = [s for s in seen.scores if s.effect.kind != GENERIC and s.statistic > 0.0]
    worth = {s.effect.name: s.statistic - cost(s.effect, series) for s in named}
    named.sort(key=lambda s: -worth[s.effect.name])
    best = worth[named[0].effect.name] if named else 0.0
    chosen = [
        s
        for i, s in enumerate(named[:REFITS])
        if i < AT_LEAST or worth[s.effect.name] >= WORTH * best
    ]
    tails = [s for s in seen.scores if s.effect.kind == TAILS and s.p_value < TAILS_ALARM]
    chosen += [s for s in tails if s not in chosen]
    generic = [s for s in seen.scores if s.effect.kind == GENERIC and s.statistic > 0.0][:2]
    refits = list(done)
    names = {r.effect.name for r in done}
    left = [s for s in [*chosen, *generic] if s.effect.name not in names]
    for i, score in enumerate(left):
        progress("refit", i / len(left))
        try:
            leading = max((r.score for r in refits), default=-np.inf)
            once = partial(refit, fit, series, score, leading)
            refits.append(kept.refit(fit.model, score.effect, once))
        except (EngineError, np.linalg.LinAlgError):
            continue
    return settle(seen, refits, series)


def confirmed(found: Round) -> Round:
    """The round with the p-value of its best likelihood ratio, where that is larger than the scores'.

    A score can be large where an effect moves hardly anything and is divided by nearly nothing; the
    likelihood of the extended model then gains nothing.
    """
    scores = {s.effect.name: s for s in found.screen.scores}
    every = [*found.refits, *([found.generic] if found.generic else [])]
    best = min((scores[r.effect.name].p_of(r.gain) for r in every), default=0.0)
    p_value = max(found.screen.p_value, found.screen.family_wise(best))
    return replace(found, screen=replace(found.screen, p_value=p_value))
