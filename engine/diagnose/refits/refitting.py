"""Which effects of a round are refitted, and how far: none that may yet be the cause is left half-way."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import Course
from engine.diagnose.refits.checkpoint import NOTHING, Kept
from engine.diagnose.refits.echoes import without_echoes
from engine.diagnose.refits.elsewhere import bent
from engine.diagnose.refits.likeness import contains
from engine.diagnose.refits.refit import Way, refit, taken_up, way_of
from engine.diagnose.refits.refitted import Refit, cost, further_parameters
from engine.diagnose.refits.rounds import MARGIN, Round, settle
from engine.diagnose.screening.screen import Score, Screen
from engine.diagnose.screening.screening import TAILS_ALARM, Progress
from engine.diagnose.screening.tails import tails_left
from engine.distributions import chi2_isf
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.statespace.model import Array, MixedModel

REFITS = (
    12  # effects refitted in a round: a sensor that clips may gain four times what its score shows
)
# Where a statistic is above the number of readings: so large an effect bends all scores ...
MORE_REFITS = 24
WORTH = 0.4  # ... but of these only what has so much of the best statistic is refitted
# Where something for a while leads, which makes up for any law that is bent: so many laws behind it.
LAWS_BEHIND = 4
# p-value of the tails that are left beside one bad reading: then there are more of them
AGAIN = 0.01
TIED = 1e-6  # share of a statistic: rounding, and so units, may not decide which of two is refitted
REACH = 0.5  # of the best score: a refit left half-way that has this much is taken up again

# Of refitting a round: the first refits, and those followed to their end; the choice is finished then.
REFITTED_ONCE, FOLLOWED = 0.7, 0.9

SWALLOWED_REFITS = 6
ALARM = 0.1  # family-wise p-value from which no alarm is to be feared at any usual level
REFITTED = 0.1  # of alpha, for these refits: maxima between a grid's points are larger than on it


def refit_swallowed(
    fit: QuasiFit, series: Series, seen: Screen, progress: Progress, kept: Kept = NOTHING
) -> list[Refit]:
    """Refits of the best few effects that a fitted Q can swallow, so that their scores see nothing.

    Where process noise has grown to explain a step, the score of the step is small, but refitting
    both gives the noise back. A refit is left half-way where it will not be an alarm.
    """
    way = cache(partial(way_of, fit, series))
    families = _swallowed(seen)[:SWALLOWED_REFITS]
    least = [_alarming(score, len(families), series) for score in families]
    tasks = [
        (score.effect, partial(refit, fit, series, score, at_least, way=way))
        for score, at_least in zip(families, least, strict=True)
    ]
    return _all_made(
        kept, fit.model, tasks, lambda i: progress("refit swallowed", i / len(families))
    )


def _alarming(score: Score, families: int, series: Series) -> float:
    """Half the score from which such a refit would be an alarm at ALARM: below it, it is left half-way."""
    ratio = chi2_isf(ALARM * REFITTED / (families * max(score.tests, 1.0)), score.degrees)
    return 0.5 * float(ratio) - cost(score.effect, series)


def swallowed_p(seen: Screen, refits: Sequence[Refit], boldness: float = 1.0) -> float:
    """The p-value of the largest likelihood ratio of these refits.

    Each is judged by the tail of its family's own maximum, with Bonferroni over all such families.
    """
    families = {score.effect.name: score for score in _swallowed(seen)}
    single = [families[r.effect.name].p_of(r.gain) ** (1.0 / boldness) for r in refits]
    return float(min([1.0, *(len(families) / REFITTED * p for p in single)]))


def _swallowed(seen: Screen) -> list[Score]:
    return [s for s in seen.scores if s.effect.traits.swallowed and s.statistic > 0.0]


def refit_best(
    fit: QuasiFit,
    series: Series,
    seen: Screen,
    setting: Setting,
    done: Sequence[Refit],
    progress: Progress,
    kept: Kept = NOTHING,
    asked: Mapping[str, Array] | None = None,
    again: Callable[
        [Sequence[Refit], Kept], tuple[list[Refit], list[Score]]
    ] = lambda refits, kept: ([], []),
) -> Round:
    """Refit the effects with the largest scores, and the unnamed force where it scores best.

    ``done`` are refits that were made before; ``asked`` names effects that are refitted whatever their
    scores, with theta (n,) to start from. A refit that seemed hopeless is left half-way at first;
    in the end all that are within reach of the best one are followed to their own maximum. ``again`` makes
    further refits where an effect is so large that it bends the scores.
    """
    refits = list(done)
    names = {r.effect.name for r in done}
    asked = asked or {}
    way = cache(partial(way_of, fit, series))
    left = [s for s in _worth_refitting(seen, series, asked) if s.effect.name not in names]
    # the first leads as a rule, and the others need not wait for each other
    for done_before, some in enumerate((left[:1], left[1:])):

        def told(i: int, before: int = done_before) -> None:
            progress("refit", REFITTED_ONCE * (before + i) / len(left))

        leading = max((r.score for r in refits), default=-np.inf)
        tasks = [
            (s.effect, partial(refit, fit, series, s, leading, asked.get(s.effect.name), way))
            for s in some
        ]
        refits += _all_made(kept, fit.model, tasks, told)
    refits = without_echoes(followed(refits, series, fit, progress, kept), series)
    refits = _beside_look_alikes(refits, fit, series, seen, way, progress, kept)
    if bent(refits, series):
        elsewhere, scores = again(refits, kept)
        # at the bent fit an effect may not be testable at all, as a correlation with a noise that went to 0
        seen = seen.with_untested(scores)
        refits = _best_of_each([*refits, *elsewhere])
        refits = followed(refits, series, fit, progress, kept.further("from elsewhere"))
    refits = without_echoes(without_one_of_many(refits, series), series)
    return settle(seen, refits, series, setting)


def _beside_look_alikes(
    refits: Sequence[Refit],
    fit: QuasiFit,
    series: Series,
    seen: Screen,
    way: Way,
    progress: Progress,
    kept: Kept,
) -> list[Refit]:
    """The refits, and those of what looks like one that leads, whatever the screen saw of it.

    The screen sees the slope at no effect: of a kink, of a long time constant, and of a step that noise has
    swallowed, hardly anything. Of an effect in proportion to its size it sees enough. A look-alike that takes
    the lead is asked for its own. Of a wave that noise has swallowed it may see another frequency: that of the
    one that leads is tried, too.
    """
    refits, asked, waves = list(refits), {r.effect.name for r in refits}, set[str]()
    while True:
        named = [r for r in refits if not r.effect.traits.unnamed]
        leading = max(named, key=lambda r: r.score, default=None)
        if leading is None or not leading.score > 0.0:
            return refits
        apart = _at_other_frequencies(refits, leading, series)
        again = {r.effect.name for r in apart} - waves
        waves |= again
        alike = [s for s in seen.scores if s.effect.name not in asked and s.statistic > 0.0]
        even = [r.effect for r in named if r.score >= leading.score - MARGIN]
        alike = [
            s for s in alike if _look_alikes(s.effect, leading.effect) or _is_wider(s.effect, even)
        ]
        alike += [s for s in seen.scores if s.effect.name in again]
        if not alike:
            return refits
        asked |= {score.effect.name for score in alike}
        tasks = [
            (score.effect, partial(_from_the_leading, leading, fit, series, score, way))
            for score in alike
        ]
        refits += _all_made(kept.further("beside"), fit.model, tasks)
        refits = followed(_best_of_each(refits), series, fit, progress, kept)


def _best_of_each(refits: Sequence[Refit]) -> list[Refit]:
    """One refit of each effect."""
    best: dict[str, Refit] = {}
    for found in refits:
        known = best.get(found.effect.name)
        best[found.effect.name] = found if known is None or found.score > known.score else known
    return list(best.values())


def _at_other_frequencies(refits: Sequence[Refit], leading: Refit, series: Series) -> list[Refit]:
    """Where a wave leads, the refits of waves more than a cycle of the record away from its frequency."""
    if leading.effect.traits.course is not Course.HARMONIC:
        return []

    length = float(np.ptp(series.t))

    def cycles(found: Refit) -> float:
        return float(found.fit.theta[found.effect.timing.name]) * length

    waves = [r for r in refits if r.effect.traits.course is Course.HARMONIC]
    return [r for r in waves if abs(cycles(r) - cycles(leading)) > 1.0]


def _look_alikes(one: Effect, other: Effect) -> bool:
    """Whether either says so, or both are steps; ``one`` is not in proportion to its size alone.

    A time constant, a threshold or a step of rounding is one-sided, and has a size only. Of outliers: effects
    of a sensor that say so.
    """
    if one.traits.unnamed or one.traits.outliers or not (further_parameters(one) or one.one_sided):
        return False
    if other.traits.outliers:
        return one.family == "measurement" and other.kind in one.look_alikes
    steps = one.traits.course is other.traits.course is Course.STEP
    return steps or one.kind in other.look_alikes or other.kind in one.look_alikes


def _is_wider(one: Effect, leading: Sequence[Effect]) -> bool:
    """Whether a plainer effect among those that lead is the end of its range that the screen sees.

    As damping is of a slow lag, which the screen asks for no longer than its probes are.
    """
    return not one.traits.outliers and any(contains(one, other) for other in leading)


def _from_the_leading(
    leading: Refit, fit: QuasiFit, series: Series, score: Score, way: Way
) -> Refit:
    """A refit that may start at the time and with the noise of the one that leads, too."""
    further = None
    courses = {score.effect.traits.course, leading.effect.traits.course}
    if courses <= {Course.STEP, Course.PULSE} or courses == {Course.HARMONIC}:
        further = _in_time_with(leading, fit, series, score)
    return refit(fit, series, score, leading.score, further, way)


def _in_time_with(leading: Refit, fit: QuasiFit, series: Series, score: Score) -> Array | None:
    """Theta (n,) with the effect at the time or frequency of another, at its likeliest size there."""
    effect, other = score.effect, leading.effect
    model, n = effect.apply(fit.model), len(fit.theta)
    theta = model.theta([*np.asarray(leading.fit.theta)[:n], 0.0, *score.at])
    when = float(leading.fit.theta[other.timing.name])
    theta = model.theta(theta.asdict() | {effect.timing.name: when})
    try:
        sizes = [p.name for p in effect.amplitudes]
        return np.asarray(quasi_ml(model, series, theta, sizes).theta)
    except (EngineError, np.linalg.LinAlgError):
        return None


def without_one_of_many(refits: Sequence[Refit], series: Series) -> list[Refit]:
    """The refits without the pulse of a reading, where more such readings are left beside it.

    A pulse of an output is one bad reading. Where that or outliers lead, and the tails of the errors are
    still heavy with that reading explained, it is the largest of several: outliers.
    """
    named = [r for r in refits if not r.effect.traits.unnamed]
    leading = max(named, key=lambda r: r.score, default=None)
    if leading is None:
        return list(refits)
    there = [r for r in named if r.effect.channel == leading.effect.channel]
    pulse = next((r for r in there if r.effect.traits.course is Course.PULSE), None)
    tails = next((r for r in there if r.effect.traits.outliers), None)
    if pulse is None or tails is None or leading not in (pulse, tails):
        return list(refits)
    if tails_left(pulse.fit, tails.effect, series) > AGAIN:
        return list(refits)
    return [r for r in refits if r is not pulse]


def followed(
    refits: Sequence[Refit],
    series: Series,
    fit: QuasiFit,
    progress: Progress = lambda stage, share: None,
    kept: Kept = NOTHING,
) -> list[Refit]:
    """The refits, those given up early taken up again where they are within reach of the best."""
    refits, further = list(refits), kept.further("to its end")
    given_up = sum(r.fit.given_up for r in refits)
    while True:
        left = sum(r.fit.given_up for r in refits) / max(given_up, 1)
        progress("refit", REFITTED_ONCE + (FOLLOWED - REFITTED_ONCE) * (1.0 - left))
        best = max((r.score for r in refits), default=-np.inf)
        reach = REACH * best if best > 0.0 else -np.inf
        open_ = [i for i, r in enumerate(refits) if r.fit.given_up and r.score >= reach]
        if not open_:
            return refits
        i = max(open_, key=lambda i: refits[i].score)
        again = partial(taken_up, refits[i], series)
        refits[i] = further.refit(fit.model, refits[i].effect, again)


def _worth_refitting(seen: Screen, series: Series, asked: Iterable[str]) -> list[Score]:
    """The best named effects, those asked for, outliers where they are likely, the best unnamed forces."""
    named = [s for s in seen.scores if not s.effect.traits.unnamed and s.statistic > 0.0]
    worth = {s.effect.name: s.statistic - cost(_as_refitted(s), series) for s in named}
    named.sort(key=lambda s: -worth[s.effect.name])
    best = worth[named[0].effect.name] if named else 0.0
    most = REFITS if best <= series.observed.sum() else MORE_REFITS
    values = [worth[s.effect.name] for s in named]
    first, most = _with_ties(values, REFITS), _with_ties(values, most)
    chosen = [s for i, s in enumerate(named[:most]) if i < first or values[i] >= WORTH * best]
    if named and _for_a_while(named[0].effect):
        laws = [s for i, s in enumerate(named) if values[i] > 0.0 and not _makes_up(s.effect)]
        chosen += [s for s in laws if s not in chosen][:LAWS_BEHIND]
    chosen += [s for s in seen.scores if s.effect.name in asked and s not in chosen]
    tails = [s for s in seen.scores if s.effect.traits.outliers]
    if any(s.p_value < TAILS_ALARM for s in tails):  # which noise it is, their test cannot tell
        chosen += [s for s in tails if s not in chosen]
    return chosen + [s for s in seen.scores if s.effect.traits.unnamed and s.statistic > 0.0][:2]


def _makes_up(effect: Effect) -> bool:
    """Whether it is noise, or acts for a while: some of it is seen wherever a law is another one."""
    return effect.family == "noise" or _for_a_while(effect)


def _for_a_while(effect: Effect) -> bool:
    """Whether it begins and is over. Noise that leads is no last word: laws show beside it in a later round."""
    return effect.traits.course in (Course.PULSE, Course.EPISODE)


def _as_refitted(score: Score) -> Effect:
    """The effect of a score, its zero estimated where the screen saw it best from elsewhere.

    From far away all that is in proportion to something is a constant. Were that zero free of cost, there would
    be more such effects ahead of the constant itself than are refitted.
    """
    effect = score.effect
    return effect.with_free_zero() if effect.from_elsewhere(score.at) else effect


def _with_ties(values: Sequence[float], n: int) -> int:
    """How many of these, from the largest, are the first n and those that rounding alone puts behind."""
    if len(values) <= n:
        return len(values)
    least = values[n - 1] - TIED * abs(values[n - 1])
    return sum(value >= least for value in values)


def _all_made(
    kept: Kept,
    model: MixedModel,
    tasks: Sequence[tuple[Effect, Callable[[], Refit]]],
    told: Callable[[int], Any] = lambda i: None,
) -> list[Refit]:
    """Refits that do not depend on each other; ``told`` the number of each that is begun."""
    made = []
    with closing(kept.refits(model, tasks)) as refits:
        for i, refitted in enumerate(refits):
            told(i)
            made.append(_made(refitted))
    return [found for found in made if found is not None]


def _made(compute: Callable[[], Refit]) -> Refit | None:
    """A refit, None where the extended model's filter is lost."""
    try:
        return compute()
    except (EngineError, np.linalg.LinAlgError):
        return None


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
