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

from engine.data.series import Series
from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.free_run_fits.candidates import leading
from engine.diagnose.refits.calibration import (
    BOLDEST,
    Question,
    calibrated,
    decides,
    sequential_floor,
    sequential_p,
    silent,
)
from engine.diagnose.refits.checkpoint import NOTHING, Kept
from engine.diagnose.refits.elsewhere import from_elsewhere
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.joint_refit import STAGE, look_back
from engine.diagnose.refits.refit import refit, with_tails
from engine.diagnose.refits.refitted import Refit, cost, finished
from engine.diagnose.refits.refitting import (
    FOLLOWED,
    confirmed,
    refit_best,
    refit_swallowed,
    swallowed_p,
)
from engine.diagnose.refits.rounds import FORESEEN, Round
from engine.diagnose.screening.screen import Screen
from engine.diagnose.screening.screening import Progress, screen_effects
from engine.diagnose.screening.tails import (
    AFTER,
    OUTLYING,
    first_of_each,
    pit_of,
    standardised_errors,
)
from engine.diagnose.search.beginnings import best_beginning, may_begin_otherwise
from engine.diagnose.steps.step_error import (
    by_shorter_steps,
    decided_by_steps,
    ranked_anew,
    steps_margin,
)
from engine.errors import EngineError, OptionError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml, share_done
from engine.filters.sigma_point import moment_path
from engine.statespace.model import MixedModel

FIRST = 0.7  # of alpha, for the first screen; the rest is for refits of what noise has swallowed
LATER = 0.1  # of alpha, for screens after the first, as each round is a new chance
LOOKED_BACK = 0.9  # of looking back: all but the last fit
ANEW = "another beginning"  # the stage of a search that begins with another effect
TWICE = 0.5  # of that stage, for the search without simulations, and for the one with them
PASSES = 3  # of taking outliers out: what follows one is judged again without it

# Whether the search ends with what was found so far, as it is to be done anew.
Ends = Callable[[Search], bool]


def search(  # noqa: PLR0913
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
    enough: int = 0,
    ends: Ends = lambda found: False,
) -> Search:
    """Find the effects a series shows beyond ``base``, one after the other; ``kept`` is done already.

    What came first decides what is found beside it. So where several are found, another beginning is tried.
    And with fewer than ``enough`` steps a sample the search ends where shorter ones may decide what came first.
    So it does after a round where ``ends``, asked of what was found so far, says so.
    """
    look = partial(
        _one_after_the_other,
        model,
        series,
        base,
        setting,
        alpha=alpha,
        max_effects=max_effects,
        kinds=kinds,
        seed=seed,
    )
    found, begun = look(progress=progress, kept=kept, enough=enough, ends=ends)
    if begun is None or not may_begin_otherwise(found, begun):
        return found

    def beside(rival: Refit, bend: bool) -> float:
        progress(ANEW, 0.0)
        own = kept.within(f"beside {rival.effect.name}")
        fit = own.fit(rival.fit.model, partial(finished, rival.fit, series))
        asked = _bends if bend else _has_a_name
        try:
            seen = _screened(
                series, setting, LATER * alpha, seed + 1, None, silent, fit, kinds, asked
            )
            best = max(seen.scores, key=lambda score: score.statistic)
            if not bend:
                return FORESEEN * best.statistic
            return own.refit(fit.model, best.effect, partial(refit, fit, series, best)).gain
        except (EngineError, np.linalg.LinAlgError):
            return 0.0  # as where it does not bend

    remembered = kept if kept.parts is not None else replace(kept, parts={})

    def other(first: Round, simulating: bool) -> Search:
        apart = remembered.apart(f"beginning with {first.refits[0].effect.name}")
        told = _by_rounds(progress, TWICE if simulating else 0.0, max_effects + 1)
        return look(progress=told, kept=apart, first=first, simulating=simulating)[0]

    return best_beginning(found, begun, series, beside, other)


def _one_after_the_other(  # noqa: PLR0913
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
    kept: Kept,
    first: Round | None = None,
    simulating: bool = True,
    enough: int = 0,
    ends: Ends = lambda found: False,
) -> tuple[Search, Round | None]:
    """The search and its first round as it was found, or that ``first`` with which it is to begin.

    Without ``simulating`` screens are believed as bold as they are: no less is found, and in less time.
    """
    fit, rounds, alarm, whole = base, list[Round](), False, series
    tails: Refit | None = None
    of_state: _OfState | None = None
    explained, by_steps, unweighed = "", 0.0, tuple[str, ...]()
    if first is not None:
        rounds.append(first)
        best = first.refits[0].fit
        told = _iterations(progress, "refit", FOLLOWED)
        fit = kept.within("round 1").fit(best.model, partial(finished, best, series, told))
    for k in range(len(rounds), max_effects + 1):
        taken = None if tails is None else tails.effect
        # outliers hide all else from the first screen, so that after them is held to its level once more
        behind_tails = tails is not None and len(rounds) == 1
        level = alpha if k == 0 else FIRST * alpha if behind_tails else LATER * alpha
        here = kept.within(f"round {k + 1}")
        setting = setting.beside(fit.model)
        question = Question(fit, series, setting, kinds)
        screened = partial(_screened, series, setting, level, seed + k, taken)
        progress("screen", 0.0)
        try:
            seen = here.screen(all_effects(setting, kinds), partial(screened, progress, fit, kinds))
        except OptionError:
            if k == 0:
                raise
            alarm = False  # all that was asked for is found
            break
        seen = seen.sharing(FIRST) if k == 0 else seen
        if simulating and decides(seen.family_wise_at, level, seen):
            seen = calibrated(seen, question, level, seed + k, progress, here)
        alarm = seen.p_value <= level
        swallowed: list[Refit] = []
        if not alarm and k == 0:
            swallowed = refit_swallowed(fit, series, seen, progress, here)
            refitted = swallowed_p(seen, swallowed)
            if refitted <= alpha < swallowed_p(seen, swallowed, BOLDEST):
                refitted = sequential_p(refitted, question, alpha, seed, progress, here)
                seen = replace(seen, refits_floor=sequential_floor(alpha))
            alarm = refitted <= alpha
            seen = replace(seen, p_value=min(seen.p_value, refitted))
        if not alarm or k == max_effects:
            rounds.append(Round(seen, (), None, ()))
            break
        asked = leading(fit, series, setting, kinds)
        every = all_effects(setting, kinds)
        quietly = partial(screened, silent)  # the stage is another one
        again = partial(from_elsewhere, fit, series, every, model.parameter_names, quietly)
        found = refit_best(fit, series, seen, setting, swallowed, progress, here, asked, again)
        if not swallowed:
            found = confirmed(found)
            alarm = found.screen.p_value <= level or not found.refits
        if alarm and rounds and found.refits and tails is None:
            before = [r.refits[0].effect.name for r in rounds]
            gain = max(refit.gain for refit in found.refits)
            by_steps = by_shorter_steps(gain, setting, before, fit, series, here)
            if by_steps:
                explained, alarm = found.refits[0].effect.name, False
                last, earlier = rounds[-1], before[:-1]
                rounds[-1] = ranked_anew(last, by_steps, earlier, series, setting, here)
                best = rounds[-1].refits[0].fit
                told = _iterations(progress, "refit", FOLLOWED)
                fit = here.fit(best.model, partial(finished, best, series, told))
        if not alarm:
            rounds.append(replace(found, refits=(), generic=None, equivalent=()))
            break
        rounds.append(found)
        if not found.equivalent:
            break
        if k == 0 and decided_by_steps(found, series, setting, here, enough):
            ended = Search(base, found.refits[0].fit, tuple(rounds), alarm, by_the_steps=True)
            return ended, None
        if tails is None:
            ended = Search(base, found.refits[0].fit, tuple(rounds), alarm)
            if ends(ended):
                return ended, None
        if not found.refits[0].effect.traits.outliers:
            best = found.refits[0].fit
            told = _iterations(progress, "refit", FOLLOWED)
            fit = here.fit(best.model, partial(finished, best, series, told))
            continue
        # the moment filter does not see outliers, so they are taken out before it looks again
        tails, alarm = found.refits[0], False
        if tails.effect.channel not in model.outputs:
            other = _of_a_reading(found, model)
            if other is None:
                break
            of_state, tails = _OfState(len(rounds) - 1, found, fit.log_likelihood), other
            others = tuple(one for one in found.refits if one is not other)
            beside = (one for one in found.equivalent if one not in (other, found.refits[0]))
            rounds[-1] = replace(found, refits=(other, *others), equivalent=(other, *beside))
        usual = replace(fit, theta=fit.model.theta(tails.fit.theta[: len(fit.theta)]))
        series = without_outliers(usual, series, tails.effect.channel, seed)
        fit = here.fit(fit.model, partial(quasi_ml, fit.model, series, fit.theta, fit.free))
    begun = rounds[0] if rounds[0].equivalent else None
    named = [found for found in rounds if found.equivalent]
    setting = setting.beside(fit.model)
    if tails is None and len(named) > 1:
        among = part_of(progress, 0.0, LOOKED_BACK)
        anew = partial(_screened, series, setting, LATER * alpha, seed, None, silent, kinds=kinds)
        margin = steps_margin(by_steps)
        rest = rounds[len(named) :]
        fit, named, unweighed = look_back(
            base, named, series, setting, kept, among, anew, margin, alpha
        )
        if explained and named[-1].refits[0].fit is fit:  # weighed anew, but by the longer steps
            earlier = [r.refits[0].effect.name for r in named[:-1]]
            own = kept.within("looking back by half steps")
            named[-1] = ranked_anew(named[-1], by_steps, earlier, series, setting, own)
            fit = named[-1].refits[0].fit
        rounds[:] = [*named, *rest]
        told = _iterations(progress, STAGE, LOOKED_BACK)
        fit = kept.within("finally").fit(fit.model, partial(finished, fit, series, told))
    if tails is None:
        ended = Search(base, fit, tuple(rounds), alarm, explained, unweighed, begun=begun)
        return ended, begun
    final = tails.fit if series is whole else _told_again(fit, tails, whole)
    if of_state is not None:
        better = of_state.better(rounds[of_state.place :], final, whole)
        if better is not None:
            ahead, best = better
            ahead = tuple(_of_last(one, of_state.found.refits[0], best, base) for one in ahead)
            return Search(base, best, (*rounds[: of_state.place], *ahead), False), None
    rounds[:] = [_of_last(found, tails, final, base) for found in rounds]
    return Search(base, final, tuple(rounds), alarm, explained, unweighed), None


def _screened(
    series: Series,
    setting: Setting,
    alpha: float,
    seed: int,
    outliers: Effect | None,
    progress: Progress,
    fit: QuasiFit,
    kinds: Sequence[str] | None,
    asked: Callable[[Effect], bool] = lambda _: True,
) -> Screen:
    """What of these ``kinds`` is seen at a fit, of those ``asked`` for."""
    beside = setting.beside(fit.model)
    return screen_effects(fit, series, beside, kinds, alpha, seed, progress, outliers, asked)


def _has_a_name(effect: Effect) -> bool:
    return not effect.traits.unnamed


def _bends(effect: Effect) -> bool:
    return effect.traits.bends


@dataclass(frozen=True, eq=False)
class _OfState:
    """A round, at its place, led by outliers of a state, and the log-likelihood before it.

    Those of a reading and an effect beside them may be likelier: a sensor that glitches and was knocked once
    looks like a state that jumps.
    """

    place: int
    found: Round
    before: float

    def better(
        self, rounds: Sequence[Round], final: QuasiFit, series: Series
    ) -> tuple[tuple[Round, ...], QuasiFit] | None:
        """Rounds led by them, and their fit, that score no less than outliers of a reading; else None.

        Those of the reading are the first of the ``rounds``, ``final`` the fit with all that was found after
        them. What was found there may show beside outliers of the state as well, as a cycle that has nothing
        to do with jumps does, and then says nothing for either. So each is weighed with as much beside it as
        it likes.
        """
        later = [found for found in rounds[1:] if found.equivalent]
        effects = [found.refits[0].effect for found in rounds if found.equivalent]
        least = self._score(final, effects, series)
        of_state = self.found.refits[0]
        ahead: tuple[Round, ...] = (self.found,)
        best, most = of_state.fit, of_state.score
        for k in range(1, len(later) + 1):
            beside = [found.refits[0].effect for found in later[:k]]
            try:
                fit = _told_again(later[k - 1].refits[0].fit, of_state, series)
            except (EngineError, np.linalg.LinAlgError):
                continue
            score = self._score(fit, [of_state.effect, *beside], series)
            if score > most:
                most, best, ahead = score, fit, (self.found, *later[:k])
        return (ahead, best) if most >= least else None

    def _score(self, fit: QuasiFit, effects: Sequence[Effect], series: Series) -> float:
        costs = sum(cost(effect, series) for effect in effects)
        return 2.0 * (fit.log_likelihood - self.before) - costs


def _of_a_reading(found: Round, model: MixedModel) -> Refit | None:
    """The likeliest outliers of an output in a round, None without any."""
    refits = [r for r in found.refits if r.effect.traits.outliers and r.score > 0.0]
    there = [r for r in refits if r.effect.channel in model.outputs]
    return max(there, key=lambda r: r.score, default=None)


def _told_again(fit: QuasiFit, tails: Refit, series: Series) -> QuasiFit:
    """The final fit with the outliers of an earlier round, left out meanwhile, as its last effect."""
    extended = tails.effect.apply(fit.model)
    found = with_tails(fit, extended, tails.effect, series)
    n = len(fit.model.parameters)
    if n + len(tails.effect.parameters) == len(tails.fit.theta):  # nothing was found beside them
        return max(found, tails.fit, key=lambda one: one.log_likelihood)
    return found


def _of_last(found: Round, tails: Refit, final: QuasiFit, base: QuasiFit) -> Round:
    """The round of the outliers with the size that they have in the end."""
    if not (found.refits and found.refits[0] is tails):
        return found
    gain = tails.gain
    if len(final.theta) == len(tails.fit.theta):
        gain = 2.0 * (final.log_likelihood - base.log_likelihood)
    told = replace(tails, fit=final, gain=gain)
    equivalent = tuple(told if one is tails else one for one in found.equivalent)
    return replace(found, refits=(told, *found.refits[1:]), equivalent=equivalent)


def part_of(progress: Progress, begin: float, end: float) -> Progress:
    """For a part of a stage that has this share of it."""
    return lambda stage, share: progress(stage, begin + (end - begin) * share)


def _by_rounds(progress: Progress, begin: float, most: int) -> Progress:
    """For a further search that is part of a stage: as far in it as rounds are begun, at most ``most``."""
    rounds, before = 0, ""

    def told(stage: str, share: float) -> None:
        nonlocal rounds, before
        rounds, before = rounds + (stage != before and stage == "screen"), stage
        progress(ANEW, begin + TWICE * min(rounds / most, 1.0))

    return told


def _iterations(progress: Progress, stage: str, begin: float) -> Callable[[int], Any]:
    """For the iterations of a fit that ends a stage."""
    return lambda k: progress(stage, begin + (1.0 - begin) * share_done(k))


def without_outliers(fit: QuasiFit, series: Series, output: str, seed: int) -> Series:
    """The series with an output's outlying values missing.

    A filter that took an outlier for true is off for a while, so what follows one is judged again without it.
    """
    j, after = list(fit.model.outputs).index(output), AFTER * series.substeps
    suspect = np.ones(len(series), dtype=bool)
    for _ in range(PASSES):
        path = moment_path(fit.model, np.asarray(fit.theta), series)
        errors = standardised_errors(path, series.observed, pit_of(fit, series, seed))[:, j]
        sizes = np.abs(np.nan_to_num(errors))
        outlying = np.flatnonzero((sizes > OUTLYING) & suspect)
        sure = first_of_each(sizes, outlying, after)
        if not sure:
            break
        y, suspect = series.y.copy(), np.isin(np.arange(len(series)), outlying)
        for t in sure:
            y[t, j] = np.nan
            suspect[t : t + after + 1] = True
        series = series.replace(y=y)
    return series
