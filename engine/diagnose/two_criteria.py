"""The likelihood one step ahead, then the free run, on records whose steps are short enough for what is found.

How many steps a sample a model needs is known of the model as given. Where the free run finds a cause for
which they are too long, what it would find beside that may be the error of the steps, and the causes are
looked for again with as many as that one needs; so they are where the likelihood's sizes need more, and with
twice as many where they decide between names that it has. An answer of the free run that is lost by that stays
the one with fewer, but where the likelihood names a cause instead.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from operator import itemgetter

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.first_states import begins_as_said
from engine.diagnose.free_run.oversampled import (
    DECIDES,
    error_of_steps,
    fewer_samples,
    of_any_step,
    thinned_by,
)
from engine.diagnose.free_run.second_opinion import SecondOpinion, second_opinion
from engine.diagnose.free_run.windows import STRETCH, rows_searched
from engine.diagnose.free_run_fits.fitted import Fitted
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.judging.judgement import ENOUGH, NAMES
from engine.diagnose.records import ELSEWHERE, TOO_LONG, Records, others_left
from engine.diagnose.refits.checkpoint import Kept
from engine.diagnose.search.common_clock import came_in_all
from engine.diagnose.search.pipeline import Causes, Clock, find_causes, fit_base
from engine.diagnose.steps.substeps import Prepared, are_too_long, steps_for
from engine.errors import EngineError
from engine.estimation.beginnings import about_cuts
from engine.statespace.model import MixedModel, ThetaLike
from engine.words import enumerated, moment

NOT_YET = SecondOpinion(Verdict.UNKNOWN, (), False, "The free run is asked with shorter steps.")


@dataclass(frozen=True)
class Options:
    """What is looked for, as in :func:`engine.diagnose.diagnose`."""

    free: Sequence[str] | None
    alpha: float
    max_effects: int
    effects: Sequence[str] | None
    seed: int


@dataclass(frozen=True, eq=False)
class TwoAnswers:
    """What the likelihood and the free run say of ``fine`` records; the rows the likelihood ``searched``."""

    fine: Prepared
    causes: Causes
    asked: SecondOpinion
    searched: Series
    notes: tuple[str, ...]

    @property
    def of_free_run(self) -> bool:
        """Whether the free run has found something."""
        return self.asked.search is not None and bool(self.asked.search.found)

    @property
    def coarse(self) -> bool:
        """Whether shorter steps may say something else."""
        if self.causes.search.by_the_steps:
            return self.fine.finer
        by_likelihood = not (self.asked.decides and self.of_free_run) and self.fine.k < ENOUGH
        for_likelihood = by_likelihood and (self.causes.coarse or self.causes.steps > self.fine.k)
        return self.fine.finer and (for_likelihood or self._coarse_for_free_run)

    @property
    def steps(self) -> int:
        """How many steps a sample to go on with."""
        search = self.asked.search
        if search is None or not search.coarse:
            return self.causes.steps if self.causes.steps > self.fine.k else 2 * self.fine.k
        fit = search.final
        at, record = np.asarray(fit.theta), fit.records[0]
        return steps_for(self.causes.base.model, fit.names, at, record, fit.x1[0])

    @property
    def _coarse_for_free_run(self) -> bool:
        return self.asked.search is not None and self.asked.search.coarse


def ask_both(
    model: MixedModel,
    records: Records,
    fine: Prepared,
    theta: ThetaLike,
    options: Options,
    clock: Clock,
    kept: Kept,
) -> TwoAnswers:
    """Both answers; ``fine`` are the ``records`` with as many steps a sample as the model as given needs."""
    found = last = _with_these_steps(model, fine, theta, options, clock, kept)
    while last.coarse:
        fine = fine.with_shorter_steps(records, last.steps)
        own = kept.apart(f"{fine.k} steps a sample")
        last = _with_these_steps(model, fine, theta, options, clock, own)
        if last.causes.search.by_the_steps and last.coarse:
            continue  # it was left half-way for still shorter ones, and is no answer
        names = last.of_free_run or last.causes.verdict in NAMES
        if found.of_free_run and not names:
            break
        found = last
    return found


def _with_these_steps(
    model: MixedModel, fine: Prepared, theta: ThetaLike, options: Options, clock: Clock, kept: Kept
) -> TwoAnswers:
    start, train = theta if fine.theta is None else fine.theta, fine.records.train
    clock.start("fit")
    searched, notes = _searched(model, start, options.free, train, kept)
    if fine.records.others:
        left = {TOO_LONG: len(fine.records.others)}
        if searched is train:
            searched, left = _with_others(model, theta, start, options.free, fine.records, kept)
            # what one short record says may lie far along a ridge that all of them close
            of_one, start = start, theta if searched.begins else start
            fine.records.check_enough(searched, left)
            if fine.records.in_turn and searched.begins:
                as_given = fine.records.as_given()
                there, _ = _with_others(model, theta, of_one, options.free, as_given, kept)
                if _at_once(model, searched, there, start, options, kept):
                    fine, searched = replace(fine, records=as_given), there
        notes.append(_of_records(fine.records, 1 + len(searched.begins), left))
    if thinned_by(searched, train):
        setting = setting_for(model, searched, np.asarray(model.theta(start)))
        options = replace(options, effects=of_any_step(options.effects, setting, options.free))
    causes = find_causes(
        model, searched, start, **asdict(options), clock=clock, kept=kept, finer=fine.finer
    )
    if causes.search.by_the_steps:
        return TwoAnswers(fine, causes, NOT_YET, searched, tuple(notes))
    silent = np.diag(causes.base.information) == 0.0
    if searched is not train and not searched.begins and silent.any():
        untold = [name for name, none in zip(causes.base.free, silent, strict=True) if none]
        notes.append(
            f"Of {enumerated(untold)} these samples tell nothing: one step ahead they keep their start values."
        )
    base = causes.base.model

    def enough(fit: Fitted) -> bool:
        values = np.asarray(fit.theta)
        return not fine.finer or not are_too_long(
            base, fit.names, values, fit.records[0], fit.x1[0]
        )

    clock.start("free run")
    asked = second_opinion(
        causes,
        [train, *fine.records.others],
        model.theta(start),
        alpha=options.alpha,
        kinds=causes.kinds,
        seed=options.seed,
        progress=clock.progress,
        enough=enough,
    )
    return TwoAnswers(fine, causes, asked, searched, (*notes, *fine.notes, *causes.notes))


def _searched(
    model: MixedModel, theta: ThetaLike, free: Sequence[str] | None, train: Series, kept: Kept
) -> tuple[Series, list[str]]:
    """What of a record the likelihood searches, with a sentence where that is not all of it."""
    begin, end = rows_searched(model, theta, free, train)
    if end - begin == len(train):
        return train, []
    all_of_it, count = _on_fewer_samples(model, theta, free, train, kept), len(train.samples)
    if all_of_it is not None:
        return all_of_it, [
            f"The likelihood searched one in {thinned_by(all_of_it, train)} of {count} samples, those between "
            "say the same; what remembers a number of samples, as a dead time, was not looked for."
        ]
    part = train.part(begin, end)
    which = (
        "those that move most" if begin else "the first, as the model says where a record begins"
    )
    return part, [
        f"The likelihood searched {len(part.samples)} of {count} samples, {which}: from "
        f"t = {moment(part.t[0], part.usual_step)} to {moment(part.t[-1], part.usual_step, part.time_unit)}."
    ]


def _with_others(
    model: MixedModel,
    given: ThetaLike,
    start: ThetaLike,
    free: Sequence[str] | None,
    records: Records,
    kept: Kept,
) -> tuple[Series, dict[str, int]]:
    """What the likelihood searches of all records; also how many are left out, by the reason.

    They must begin where the model with its ``given`` values says, or fitted to the main one from ``start``.
    """
    own = kept.within("the longest record")
    fit = own.fit(model, partial(fit_base, model, records.train, start, free))
    said = partial(begins_as_said, model, model.theta(given), fit.theta)
    return records.searched(said, STRETCH)


def _at_once(
    model: MixedModel,
    in_turn: Series,
    as_given: Series,
    start: ThetaLike,
    options: Options,
    kept: Kept,
) -> bool:
    """Whether something came in all records at one time of their clocks."""
    fit = kept.fit(model, partial(fit_base, model, in_turn, start, options.free))
    return came_in_all(fit, in_turn, as_given, options.effects, options.alpha, options.seed)


def _of_records(records: Records, taken: int, left: Mapping[str, int]) -> str:
    """A sentence about how many of several records the likelihood has searched."""
    n = 1 + len(records.others)
    if taken == n:
        return (
            f"The likelihood searched all {n} records together, each from a first state of its own; what is "
            "wrong is shown on the longest."
        )
    which = "one, the longest" if taken == 1 else f"{taken} together"
    return (
        f"Of {n} records the likelihood searched {which}; what is wrong is shown on the longest. "
        f"{others_left(left)} The free run was asked on all.{_cut(records) if ELSEWHERE in left else ''}"
    )


def _cut(records: Records) -> str:
    """After a space, a sentence on records that may be parts of one; they are told by their numbers."""
    numbered = sorted(
        zip(records.numbers, (records.main, *records.others), strict=True), key=itemgetter(0)
    )
    numbers, every = zip(*numbered, strict=True)
    return about_cuts(every, range(len(every)), numbers)


def _on_fewer_samples(
    model: MixedModel, theta: ThetaLike, free: Sequence[str] | None, train: Series, kept: Kept
) -> Series | None:
    """Every k-th sample of the record, where the model fitted to these says as well that they are enough.

    One step ahead they are not where the longer steps are worth anything beside the noise.
    """
    few = fewer_samples(model, theta, [train], STRETCH)
    if few is None:
        return None
    own = kept.within("fewer samples")
    try:
        fit = own.fit(model, partial(fit_base, model, few[0], theta, free))
        again = fewer_samples(model, fit.theta, [train], STRETCH)
        if again is None or thinned_by(again[0], train) < thinned_by(few[0], train):
            return None
        worth = error_of_steps(model, np.asarray(fit.theta), train, few[0])
    except (EngineError, np.linalg.LinAlgError):
        return None
    return few[0] if worth <= DECIDES else None
