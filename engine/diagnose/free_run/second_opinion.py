"""Which criterion decides: the likelihood one step ahead, or the free run.

The likelihood asks what the noise is like; a record nearly free of noise, of a model wrong in several places,
lets it explain the physics as noise. So where the likelihood settles nothing, or patches on the noise, the
free run is asked; and where it names a cause whose free run is still further off than noise explains, its
answer competes with those of the free run on rows left out. A name whose shape the likelihood has refuted is
refuted for the free run, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.free_run.answer import (
    TRUSTED,
    FreeRunSearch,
    noise_fit,
    search_free_runs,
    setting_of,
)
from engine.diagnose.free_run.missing_function import MissingFunction, missing_function
from engine.diagnose.free_run.null import Alarm, alarm
from engine.diagnose.free_run.oversampled import of_any_step, steps_are_too_long, thinned_by
from engine.diagnose.free_run.search import STAGE, FreeRound
from engine.diagnose.free_run.windows import telling
from engine.diagnose.free_run_fits.candidates import FAMILIES, candidates, fit_of
from engine.diagnose.free_run_fits.columns import CANNOT, columns
from engine.diagnose.free_run_fits.fitted import Fitted, Pick, Rival
from engine.diagnose.free_run_fits.folds import Folds, folds_of, losses, times
from engine.diagnose.free_run_fits.linear import Linear
from engine.diagnose.gain.adoption import Decision
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.judging.judgement import NAMES
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.screening.screening import Progress
from engine.diagnose.search.pipeline import Causes
from engine.diagnose.search.search import part_of, without_outliers
from engine.estimation.quasi_ml import QuasiFit
from engine.statespace.model import MixedModel, Theta
from engine.words import enumerated, moment

ALARM_SHARE = 0.1  # of the free run's part of a diagnosis
UNLIKELY = 0.1  # p-value of the alarm below which it is not said that noise explains it all
SETTLED = 0.2  # of alpha: level of the free run's alarm where the likelihood has an answer
READ_OTHERWISE = (
    "The likelihood decides: the free run has nothing to say before the record is read otherwise."
)
FAR_BETTER = 0.5  # of its error on rows left out: so much less displaces the likelihood's answer


@dataclass(frozen=True, eq=False)
class SecondOpinion:
    """What the free run says of the same question.

    ``likelihood`` is the verdict of the other criterion, with the ``names`` that it chose. ``decides`` whether
    the free run's answer is the diagnosis'; ``reason`` why, or why not, in a sentence; ``alarm`` of the model
    that the likelihood ended with, ``search`` where there was one; both None where no free run can be had.
    ``missing`` is a force without a name, where no name settles it. ``refutes`` whether the noise that the
    likelihood named does not explain the free run either, and is not named.
    """

    likelihood: Verdict
    names: tuple[str, ...]
    decides: bool
    reason: str
    alarm: Alarm | None = None
    search: FreeRunSearch | None = None
    missing: MissingFunction | None = None
    refutes: bool = False

    def sees(self, alpha: float) -> bool:
        """Whether the free run has something that noise does not explain, at a level ``alpha``."""
        return self.alarm is not None and self.alarm.p_value <= alpha


def second_opinion(
    causes: Causes,
    given: Sequence[Series],
    theta: Theta,
    *,
    alpha: float,
    kinds: Sequence[str] | None,
    seed: int,
    progress: Progress,
    enough: Callable[[Fitted], bool] = lambda fit: True,
) -> SecondOpinion:
    """Ask the free run of the records ``given``; ``theta`` is another start for the base's parameters.

    ``enough`` tells whether their steps are short enough for a fit with effects.
    """
    base, named = causes.base, [r.refits[0] for r in causes.search.rounds if r.equivalent]
    whole = given
    if causes.verdict is not Verdict.UNKNOWN:  # else they may be what the model gets wrong
        given = [_without_outliers(base, named, one, seed) for one in given]
    patches = any(refit.effect.family == "noise" for refit in named)
    patches = patches and not causes.search.has_noise_apart
    settled = causes.verdict is not Verdict.UNKNOWN and not patches
    level = alpha if causes.verdict is Verdict.UNKNOWN else SETTLED * alpha
    start, said = base, (causes.verdict, tuple(refit.effect.name for refit in named))
    if settled:
        start = causes.search.final
    held = tuple(name for name in base.model.parameter_names if name not in base.free)
    if causes.misread or any(refit.effect.traits.says_hold for refit in named):
        return SecondOpinion(*said, False, READ_OTHERWISE)
    records, rivals = telling(start.model, start.theta, start.free, given), named
    close = enough
    if thinned_by(records[0], given[0]):

        def close(fit: Fitted) -> bool:
            return enough(fit) and not steps_are_too_long(fit, given[0])

        setting = setting_for(base.model, records[0], np.asarray(base.theta))
        kinds = of_any_step(kinds, setting, base.free)
        rivals = named if all(refit.effect.name in kinds for refit in named) else []
    try:
        beside = _beside(start, records, given, held, kinds)
        progress(STAGE, 0.5 * ALARM_SHARE)
        seen = beside.alarm(seed, level)
        progress(STAGE, ALARM_SHARE)
        explained = seen.p_value > level
        if _is_noise_alone(causes) and (explained or _is_of_readings(causes, base.model)):
            left = _beside(causes.search.final, records, given, held, kinds).alarm(seed, alpha)
            if explained and left.p_value <= alpha:
                reason = f"{_stands_for_more(left)}{_part(records, given, whole)}"
                return SecondOpinion(*said, False, reason, left, refutes=True)
            if not explained and left.p_value > alpha:
                reason = f"{_noise_explains(left, alpha, True)}{_part(records, given, whole)}"
                return SecondOpinion(*said, False, reason, left)
        if explained:
            extended = settled and bool(named)
            reason = f"{_noise_explains(seen, level, extended)}{_part(records, given, whole)}"
            # a function of a signal follows what noise did, too, wherever noise adds up
            missing = None if settled or seen.p_value >= UNLIKELY else beside.missing()
            return SecondOpinion(*said, False, reason, seen, missing=missing)
        found = search_free_runs(
            base,
            records,
            theta,
            levels=(level, SETTLED * alpha),
            kinds=kinds,
            rivals=_rivals(rivals, causes.search.final),
            seed=seed,
            progress=part_of(progress, ALARM_SHARE, 1.0),
            whole=() if records == list(given) else given,
            enough=close,
        )
    except CANNOT as error:
        return SecondOpinion(*said, False, f"The free run was not asked: {error}")
    decides, reason = _decided(causes, settled, named, found)
    reason = f"{reason}{_part(records, given, whole)}"
    return SecondOpinion(*said, decides, reason, seen, found, found.missing)


def _without_outliers(base: QuasiFit, named: Sequence[Refit], series: Series, seed: int) -> Series:
    """The record without what the likelihood found to be outliers of a reading: Gaussian noise has none."""
    for found in named:
        effect = found.effect
        if effect.traits.outliers and effect.channel in base.model.outputs:
            theta = base.model.theta(found.fit.theta[: len(base.theta)])
            series = without_outliers(replace(base, theta=theta), series, effect.channel, seed)
    return series


def heeding(
    asked: SecondOpinion,
    verdict: Verdict,
    held_out: Decision | None,
    nothing_better: bool = False,
) -> tuple[SecondOpinion, Verdict]:
    """The free run's answer and its verdict, once data are asked that neither criterion has seen.

    ``held_out`` is what they say of its extension, None where it has none or there are no such data. Where the
    likelihood sees nothing, a pattern in the free run alone counts only if an extension gains there, or a force
    without a name does on rows left out; an extension that loses there is no answer, nor is one of which
    ``nothing_better`` is seen there, in free run or one step ahead.
    """
    gains = held_out is Decision.ADOPTED or (held_out is None and asked.missing is not None)
    if asked.likelihood is Verdict.NOTHING and not gains:
        unseen = held_out is None and asked.search is not None and bool(asked.search.found)
        but = "no extension for it gains on data that it has not seen"
        if unseen:
            but = "nothing was held out on which an extension for it could gain"
        reason = f"The likelihood decides: the free run has a pattern that noise does not have, but {but}."
        return replace(asked, decides=False, reason=reason), Verdict.NOTHING
    if held_out is Decision.LOSES or nothing_better:
        but = "loses" if held_out is Decision.LOSES else "does nothing better, and predicts worse,"
        reason = (
            f"{asked.reason} Its extension {but} on data that it has not seen, so it is not named."
        )
        return replace(asked, reason=reason), Verdict.UNKNOWN
    return asked, verdict


def overtaken(asked: SecondOpinion, by: Sequence[str]) -> SecondOpinion:
    """The free run's answer where one of the likelihood's does better at every horizon and with any noise."""
    reason = (
        f"The likelihood decides: {enumerated(list(by))} does better at every horizon, the free run included, "
        "than what the free run found."
    )
    return replace(asked, decides=False, reason=reason)


@dataclass(frozen=True, eq=False)
class _Beside:
    """The free run of a fitted model, with the effects that may be missing in it."""

    start: QuasiFit
    linear: Linear
    setting: Setting
    folds: Folds

    def alarm(self, seed: int, level: float) -> Alarm:
        """Whether noise explains what it gets wrong, at this level."""
        noisy = np.asarray(noise_fit(self.linear.fit).theta)
        return alarm(self.linear, noisy, self.folds, seed, self.start.theta, level)

    def missing(self) -> MissingFunction | None:
        """A force without a name."""
        fit = self.linear.fit
        return missing_function(fit, losses(fit, self.folds), self.setting)


def _beside(
    start: QuasiFit,
    records: Sequence[Series],
    whole: Sequence[Series],
    held: tuple[str, ...],
    kinds: Sequence[str] | None,
) -> _Beside:
    fit = fit_of(start, records)
    setting = setting_of(fit, held, whole)
    linear = Linear(fit, columns(fit, candidates(fit, setting, kinds)))
    return _Beside(start, linear, setting, folds_of(fit.records))


def _rivals(named: Sequence[Refit], final: QuasiFit) -> list[Rival]:
    """The likelihood's answer, as far as a free run shows it, with its ``final`` parameters."""
    picks = []
    for refit in named:
        effect = refit.effect
        if effect.family in FAMILIES and effect.readings is None:
            own = [float(refit.fit.theta[p.name]) for p in effect.parameters]
            picks.append(Pick(effect, own[0], tuple(own[1:])))
    return [Rival(tuple(picks), final.theta.asdict())] if picks else []


def _decided(
    causes: Causes, settled: bool, named: Sequence[Refit], found: FreeRunSearch
) -> tuple[bool, str]:
    """Whether the free run decides, and the reason."""
    verdict, first = causes.verdict, found.rounds[0]
    if not first.alarmed:
        return False, _noise_explains(first.alarm, first.level)
    if causes.another_shape and _names_no_other(named, found):
        return False, (
            "The likelihood decides: what the free run finds has another shape, as one step ahead shows."
        )
    names = {name for chosen in found.found for name in chosen.names}
    if wrong := [name for name in causes.refuted if name in names]:
        return False, (
            f"The likelihood decides: {enumerated(wrong)}, of what the free run finds, is refuted one "
            "step ahead."
        )
    if settled and verdict is not Verdict.NOTHING and not _displaced(named, first):
        return False, (
            "The likelihood decides: noise does not explain all that its extension gets wrong in free run, "
            "but no other cause does far better on rows left out."
        )
    reason = f"The free run decides: {_too_far(first.alarm)}, and {_why(verdict, settled)}."
    if found.is_patchwork:
        reason += (
            " What it found looks like patches on a cause that is not in the catalogue: more than "
            f"{TRUSTED} effects are needed, so none is named."
        )
    return True, f"{reason}{_of_one_record(found.alone)}"


def _of_one_record(alone: Series | None) -> str:
    """Why what holds throughout is not named, as a further sentence."""
    if alone is None:
        return ""
    begin = moment(alone.t[0], alone.usual_step, alone.time_unit)
    return (
        f" What it found takes the error of one record alone, that of {len(alone.samples)} samples from "
        f"t = {begin} on, and gains nothing one step ahead: something "
        "is wrong there that the others do not have, so it is not named. Diagnose that record by itself, or "
        "give each record times of its own: what comes once is then looked for in each."
    )


def _names_no_other(named: Sequence[Refit], found: FreeRunSearch) -> bool:
    """Whether the free run has names, and the likelihood has all of them."""
    answer = {refit.effect.name for refit in named}
    return bool(found.found) and all(answer.issuperset(c.names) for c in found.found)


def _is_noise_alone(causes: Causes) -> bool:
    """Whether what the likelihood names is nothing but noise: its free run is the model's as given.

    Outliers do not count: they come at times of their own, and no simulation has them where the record does.
    """
    named = [refit.effect for r in causes.search.rounds for refit in r.equivalent]
    every = all(effect.family == "noise" and not effect.traits.outliers for effect in named)
    return bool(named) and every and causes.verdict in NAMES


def _is_of_readings(causes: Causes, model: MixedModel) -> bool:
    """Whether what is named is how large the noise of readings is.

    It adds up to nothing and explains no pattern. But the errors of readings that are noisier than others have
    patterns that noise of one size does not have.
    """
    named = [refit.effect for r in causes.search.rounds for refit in r.equivalent]
    return all(
        e.traits.noise_level and e.channel.partition("->")[0] in model.outputs for e in named
    )


def _stands_for_more(seen: Alarm) -> str:
    """Why noise is not named."""
    return (
        f"Noise that is named one step ahead must explain the free run, too, and does not: {_too_far(seen)}. "
        "It stands for something else, so it is not named."
    )


def _too_far(seen: Alarm) -> str:
    """What of the free run's error noise does not explain."""
    if seen.p_near < min(seen.p_size, seen.p_gain):
        return (
            "the noise that is fitted one step ahead would lead it further astray than it goes "
            f"({seen.probability}), so that this noise stands for something else"
        )
    if seen.p_size < seen.p_gain:
        return f"it is further off than noise makes it ({seen.probability})"
    return f"what it gets wrong has a pattern that noise does not have ({seen.probability})"


def _why(verdict: Verdict, settled: bool) -> str:
    """What speaks against the likelihood's answer."""
    if verdict is Verdict.UNKNOWN:
        return "one step ahead nothing is settled"
    if verdict is Verdict.NOTHING:
        return "one step ahead noise hides it"
    if not settled:
        return "one step ahead it is taken for noise"
    return "the answer one step ahead runs free far worse on rows left out"


def _displaced(named: Sequence[Refit], first: FreeRound) -> bool:
    """Whether the free run's choice runs far better on rows left out than the likelihood's answer."""
    answer = {refit.effect.name for refit in named}
    own = [c for c in first.candidates if set(c.names) == answer]
    chosen = first.chosen
    return bool(own) and chosen is not None and times(chosen.losses, own[0].losses) < FAR_BETTER


def _part(records: Sequence[Series], given: Sequence[Series], whole: Sequence[Series]) -> str:
    """What of the ``whole`` records was looked at, as further sentences; ``given`` have no outliers."""
    read, left = (sum(int(one.observed.sum()) for one in some) for some in (whole, given))
    gone = f" Outliers, {read - left} of {read} readings, were left out." if left < read else ""
    seen, every = (sum(len(one.samples) for one in some) for some in (records, given))
    if seen == every:
        return gone
    if fewer := thinned_by(records[0], given[0]):
        return (
            f" It was looked at on one in {fewer} of {every} samples; those between say the same."
            f"{gone}"
        )
    return f" It was looked at on {seen} of {every} samples, in {len(records)} stretches.{gone}"


def _noise_explains(seen: Alarm, level: float, extended: bool = False) -> str:
    what = "still gets wrong with what was found" if extended else "gets wrong"
    unlikely = seen.p_value < UNLIKELY
    may, asked = ("may explain", f", where {level:g} is asked") if unlikely else ("explains", "")
    return (
        f"The likelihood decides: noise {may} what the free run {what} ({seen.probability}{asked})."
    )
