"""Show what a model's simulation gets wrong, name the cause, extend the model, measure the gain.

:func:`diagnose` fits the model to the training part, screens every effect of the catalogue on it,
refits the best ones, and repeats on the extended model until nothing is left to see. What was found in
turn is then weighed again, each beside the others, and dropped where it is not seen beside them. Its verdict is

- ``nothing``: no alarm at the family-wise level alpha, or one above a tenth of it, where data that were not
  searched are predicted worse with what was found;
- ``named``: in every round with an alarm one effect is left, MARGIN ahead of all others in score and
  UNNAMED_MARGIN ahead of the unnamed force, and nothing is left to see after it;
- ``set``: in some round several effects, or the unnamed force with them, cannot be told apart;
- ``unknown``: the unnamed force explains as much as any named effect, or something is left that
  no further effect explains, or what was found in turn looks like patches on one cause that is not
  in the catalogue, or the model is far from the data whatever is added, or something contradicts the
  name: its size may as well be zero, or the particle filter sees no gain, or finds the moment filter, by
  which models are compared, further off than the name gains.

It is ``unknown``, too, where several records have parameters of their own, for which noise stands, or an
effect that explains less, or whose size is above zero in some and below in others. So it is where noise leads
and the record explains more with its inputs read otherwise. A name that is preferred by too little is one of a
set where another one predicts better at every horizon.

What is left or contradicted beside the main effect does not take that its name where it is a small part of
what the likelihood gains, and the free run with that one alone keeps next to nothing of its error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from operator import itemgetter
from typing import Any

import numpy as np

from engine.data.joined import apart, starts_of
from engine.data.series import Series
from engine.data.shared_rows import about_shared_rows
from engine.diagnose.diagnosis import Asked, Diagnosis
from engine.diagnose.early import EarlyAnswer, Told
from engine.diagnose.effects.catalogue import (
    all_effects,
    effect_kinds,
    extend,
    make_effect,
    register_effect,
    shadowed,
    unmade,
)
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.hide import hide
from engine.diagnose.effects.of_series import later_of
from engine.diagnose.effects.traits import Course, Traits
from engine.diagnose.free_run.second_opinion import overtaken
from engine.diagnose.free_run.windows import rows_searched
from engine.diagnose.gain.gain import Gain
from engine.diagnose.held_out import HeldOut, Judged
from engine.diagnose.judging.findings import Cause, Detectable, LookAlike, Verdict
from engine.diagnose.judging.judgement import has_tails
from engine.diagnose.judging.unsearched import begins_unsearched
from engine.diagnose.judging.verdict import at_most_in_words, detectable_of, named_by
from engine.diagnose.over_horizon import OverHorizon, over_horizon
from engine.diagnose.records import HELD_OUT, check_searched, records_of
from engine.diagnose.refits.bootstrap import STAGE, first_round_p
from engine.diagnose.refits.calibration import Question
from engine.diagnose.refits.checkpoint import Parts, kept_of
from engine.diagnose.search.pipeline import FIRST_FIT_SHARE, Callback, Clock, fit_base
from engine.diagnose.steps.own_steps import about_own_steps
from engine.diagnose.steps.substeps import is_enough, prepare
from engine.diagnose.symptoms.runs import covariance_of
from engine.diagnose.symptoms.symptoms import Symptoms, check_data, find_symptoms
from engine.diagnose.two_criteria import Options, ask_both
from engine.diagnose.wider_set import widened, widened_by_records
from engine.errors import OptionError, check_count
from engine.estimation.about_edges import about_edges
from engine.estimation.long_steps import FOR_ESTIMATES, about_predictions
from engine.forked import in_processes
from engine.randomness import check_seed
from engine.simulation.rates import check_no_rates
from engine.statespace.model import Array, MixedModel, ThetaLike
from engine.statespace.on_tape import about_calls
from engine.threads import single_threaded
from engine.words import enumerated, meant, moment

__all__ = [
    "Cause",
    "Course",
    "Detectable",
    "Diagnosis",
    "Effect",
    "Gain",
    "LookAlike",
    "Symptoms",
    "Traits",
    "Verdict",
    "all_effects",
    "diagnose",
    "effect_kinds",
    "extend",
    "hide",
    "make_effect",
    "register_effect",
]

LEAST_ALPHA = 0.005  # thousands of series and draws
REASONS = 2  # why names are not trusted, told beside the verdict; all of them are among the notes


@single_threaded
def diagnose(  # noqa: PLR0913
    model: MixedModel,
    series: Series | Sequence[Series],
    theta: ThetaLike = None,
    test: Series | Sequence[Series] | None = None,
    seed: int = 0,
    alpha: float = 0.05,
    effects: Sequence[str] | None = None,
    max_effects: int = 3,
    free: Sequence[str] | None = None,
    callback: Callback | None = None,
    bootstrap: int = 0,
    kept: Parts | None = None,
    early: Told | None = None,
    held_out: float = HELD_OUT,
    processes: int | None = None,
) -> Diagnosis:
    """Find what a model gets wrong on measured data, and which effect that it leaves out explains it.

    Extra channels of the series become inputs of the model that nothing depends on, until one is found to
    matter. A model that declares ``continuous`` makes as many steps from sample to sample as its effects need.
    Of more than 10,000 samples the likelihood searches a stretch, of more than 4000 the free run four windows.
    Of a plant that moves slowly beside its samples each looks at all of the record, on every k-th sample, where
    steps so long lose nothing to it. What the free run finds is fitted to all samples in the end; the page says
    what was looked at.

    Parameters
    ----------
    model : MixedModel
        The model, paper, eq. (1).
    series : Series or sequence of Series
        The data: y (T, ny) with NaN where missing, u (T, nu), times. Several records are searched together,
        each with a first state of its own. The likelihood takes those that are sampled like the longest and
        begin where the model says, the free run all. The page shows the longest. Where their clocks overlap
        and the model reads none, they are taken in turn (:func:`engine.in_turn`), unless something that came at
        one time of all their clocks explains more. A note says which if what is found comes with time.
    theta : Theta, mapping, array or None
        Start values (n_theta,); where None, they are searched for.
    test : Series or sequence of Series, optional
        Held-out data; by default a part of the records, as ``held_out`` says. Where its times go on at the end
        of a record, it begins at that record's last state, else at the model's initial density.
    seed : int
        Seed of all random numbers; the same seed gives the same result to the last bit.
    alpha : float
        Probability of a false alarm, over all effects together, where nothing is wrong; from 0.005 to below 1.
    effects : sequence of str, optional
        Kinds such as ``drag``, or names such as ``drag:velocity``, to look for; the whole catalogue by default.
    max_effects : int
        Upper limit on effects found in turn; more than two, beside outliers, make the verdict ``unknown``.
        Steps that came at one time count as one, as a wave and its overtones do.
    free : sequence of str, optional
        Names of the parameters to estimate, all by default; the others keep their start value.
    callback : callable, optional
        ``callback(stage, fraction)``; stops the run by raising StopIteration.
    bootstrap : int
        Number n of simulated series for a second p-value of the first round, 1 / (n + 1) at least: some 99, or
        0 for none. Each takes as long as a fit and a screen.
    kept : mutable mapping, optional
        Empty at first; finished parts are put there as JSON values. A run that was stopped goes on from them,
        when the same version is called with the same arguments, and gives the same numbers as one that was
        never stopped.
    early : callable, optional
        ``early(document)`` is called twice while the search goes on, with JSON values: the fitted model and
        what its simulation gets wrong; then also the first screen of effects.
    held_out : float
        Share, 0 to 0.5, that is not searched and judges what is found. It is the last part of the longest
        record, or that share of many records, one of five, if they hold as many rows. Where ``test`` is given
        it decides, and this is to be left out. With 0 all is searched: effects of time are judged on blocks
        left out of the fit in turn, and what others gain is not measured.
    processes : int, optional
        Among how many processes screens and refits are shared; the answer does not depend on it. By default
        one for each core, but one alone in a process of a pool. So it is where copies of a process are not
        safe, elsewhere than on Linux or beside threads of the caller, as in a notebook.

    Returns
    -------
    Diagnosis
        Verdict, causes, extended model, gain on held-out data, and which effects were testable; print it for
        a page of text.

    Raises
    ------
    SeriesError
        The data do not fit the model, or are too few.
    ModelError
        A function of the model fails, or returns a wrong shape or covariance; names the function and the time.
    OptionError
        An option is not known or out of its range; ``field`` names it.
    """
    _check_options(alpha, max_effects, effects)
    check_seed(seed)
    if processes is not None:
        check_count("processes", processes)
    if bootstrap < 0:
        raise OptionError(f"bootstrap = {bootstrap}; 0 or more is needed", "bootstrap")
    as_given = model
    model, records = records_of(model, series, test, held_out)
    options = {
        "theta": None if theta is None else model.theta(theta).tolist(),
        "seed": seed,
        "alpha": alpha,
        "effects": None if effects is None else list(effects),
        "max_effects": max_effects,
        "free": None if free is None else list(free),
        "held_out": float(held_out),
    }
    given = (as_given, series, test, {**options, "bootstrap": bootstrap})
    parts = {} if kept is None else kept
    check_searched(records.main, records.others)
    # whatever was finished before: a resumed run has the same digits
    model.transitions.look_again(records.main.u_step)
    model.observations.look_again(records.main.u)
    notes = list(check_data(model, records.main, sum(map(len, records.others))))
    clock = Clock(callback)
    done = kept_of(parts, model, records, options, clock.spent)
    plain = records.train
    part = plain.part(*rows_searched(model, theta, free, plain))
    if early is not None:
        done = replace(done, told=EarlyAnswer(early, model, plain, part, seed))
    clock.start("fit")
    check_no_rates(model, part, model.theta(theta))

    def first(share: float) -> None:
        clock.progress("fit", FIRST_FIT_SHARE * share)

    def fitted() -> Array:
        once = done.within("one step a sample")
        return np.asarray(once.fit(model, partial(fit_base, model, part, theta, free, first)).theta)

    fine = prepare(model, records, fitted, part)
    asked = Options(free, alpha, max_effects, effects, seed)
    with in_processes(processes):
        both = ask_both(model, records, fine, theta, asked, clock, done)
    fine, causes, searched, found = both.fine, both.causes, both.searched, both.causes.search
    shared = about_shared_rows([records.main, *records.others], records.tests)
    notes.extend([*both.notes, *([shared] if shared else [])])
    hidden = shadowed(causes.setting, effects)
    if hidden:
        notes.append(
            f"Not looked for: {enumerated(hidden)}, as parameters of the model have the names of theirs; name "
            "these otherwise."
        )

    unknown = unmade(causes.setting, effects)
    if unknown:
        notes.append(
            f"Not looked for: {enumerated(unknown)}, as this model and these data have no such effect."
        )

    bootstrapped = None
    if bootstrap:
        clock.start(STAGE)
        question = Question(causes.base, searched, causes.setting, causes.kinds)
        bootstrapped = first_round_p(question, found, bootstrap, seed, clock.progress, done)

    clock.start("gain")
    unseen = HeldOut(fine.records, searched, seed, alpha)
    shown = fine.records.train if searched.begins else searched
    judged = unseen.judge(causes, both.asked, clock.progress)
    beside = _beside_others(judged, shown)
    if judged.free_run.decides and beside is not None:
        better = beside.overtakes([cause.effect for cause in named_by(found)])
        if better:
            judged = unseen.judge(causes, overtaken(judged.free_run, better), clock.progress)
            beside = _beside_others(judged, shown)
    judged = widened_by_records(widened(judged, beside), searched)
    after = judged.after
    notes.extend(judged.notes)
    if records.kept_back:
        which = enumerated([str(k) for k in sorted(records.kept_back)])
        notes.append(
            f"Of the records, counted from 0, {which} {'were' if len(records.kept_back) > 1 else 'was'} held "
            "out and not searched: held_out=0 searches all of them, test= judges by other data."
        )
    if records.keeps_back and judged.verdict in (Verdict.NOTHING, Verdict.UNKNOWN):
        begun = moment(records.main.t[len(plain)], plain.usual_step, plain.time_unit)
        notes.append(
            f"The record from t = {begun} on was held out and not searched: held_out=0 searches all of it, "
            "test= judges by other data."
        )
    unsearched = None
    if (
        records.keeps_back
        and judged.verdict is Verdict.NOTHING
        and len(searched) == len(fine.records.train)
    ):
        whole, cut = fine.records.main, len(fine.records.train)
        tested = [score.effect for score in causes.search.rounds[0].screen.scores]
        unsearched = begins_unsearched(causes.base, whole, cut, tested, alpha, seed)

    timed = any(cause.where == "time" for cause in judged.causes)
    if records.in_turn and timed and not fine.records.in_turn:
        notes.append(
            "The clocks of the records overlap. That it came at one time in all of them explains more than "
            "that it came in one, so times are those of the records as they were given."
        )
    elif records.in_turn and timed:
        others = sorted(
            zip(records.numbers[1:], fine.records.others, strict=True), key=itemgetter(0)
        )
        begin = [
            f"record {k} at t = {moment(one.t[0], one.usual_step, one.time_unit)}"
            for k, one in others
        ]
        notes.append(
            "The clocks of the records overlap, so times are told as if one came after the other: "
            f"{enumerated(begin)}, counted from 0. The extended model needs them so: engine.in_turn(records)."
        )
    if (
        model.continuous
        and judged.causes
        and not is_enough(after.model, np.asarray(after.theta), plain, fine.k)
    ):
        notes.append(
            f"With what was found, the free run changes by more than a tenth of its error with {2 * fine.k} "
            f"steps a sample: the sizes are those of {fine.k}."
        )

    if fine.finer and not judged.causes:
        too_long = about_predictions(model, np.asarray(judged.before.theta), [shown])
        notes.extend([f"{too_long} {FOR_ESTIMATES}"] if too_long else [])
    fitted_last = judged.after if judged.causes else causes.base
    if judged.gain is not None and judged.gain.noise_of_all:
        fitted_last = judged.search.final
    if not (judged.causes and has_tails(judged.search)):
        notes.extend(filter(None, [about_own_steps(fitted_last, searched, causes.setting)]))
    notes.extend(at_most_in_words(after.model, after.theta, judged.causes, after.free))
    notes.extend(filter(None, [about_calls([model.transitions, model.observations])]))
    edge = about_edges(after.model, after.theta, after.free, [shown])
    notes.extend([edge] if edge else [])
    clock.start("symptoms")
    uncertain = covariance_of(judged.before)
    symptoms = find_symptoms(
        model, judged.before.theta, fine.records.train, uncertain, seed=seed, fitted=searched
    )
    clock.progress("symptoms", 1.0)

    clock.stop()
    return Diagnosis(
        model=model,
        verdict=judged.verdict,
        causes=judged.causes,
        p_value=found.rounds[0].screen.p_value,
        base_theta=judged.before.theta,
        extended=after.model,
        theta=after.theta,
        symptoms=symptoms,
        gain=judged.gain,
        detectable=detectable_of(found.rounds[0].screen, found.rounds[0].refits),
        search=judged.search,
        notes=tuple(notes),
        why=judged.why[:REASONS] if judged.verdict in (Verdict.UNKNOWN, Verdict.NOTHING) else (),
        seconds=clock.seconds,
        series=records.main,
        records=1 + len(records.others),
        p_bootstrap=None if bootstrapped is None else bootstrapped.p_value,
        p_bootstrap_at_floor=bootstrapped is not None and bootstrapped.at_floor,
        free_run=judged.free_run,
        substeps=fine.k,
        over_horizon=beside,
        asked=Asked(*given, parts=dict(parts)),
        later=later_of(apart(searched)),
        starts=starts_of(apart(searched)),
        unsearched=unsearched,
        by_record=judged.by_record,
    )


@single_threaded
def again(
    model: MixedModel,
    series: Series | Sequence[Series],
    test: Series | Sequence[Series] | None,
    options: Mapping[str, Any],
    parts: Mapping[str, Any],
) -> Diagnosis:
    """The diagnosis that was asked so before; ``parts`` that it finished are not computed again."""
    return diagnose(model, series, test=test, **options, kept=dict(parts))


def _beside_others(judged: Judged, series: Series) -> OverHorizon | None:
    """The answer beside the other leading candidates, over the horizon; see :func:`over_horizon`."""
    names = tuple(cause.effect for cause in judged.causes)
    return over_horizon(judged.before, judged.after, names, judged.search, series)


def _check_options(alpha: float, max_effects: int, effects: Sequence[str] | None) -> None:
    if not LEAST_ALPHA <= alpha < 1.0:
        raise OptionError(
            f"alpha = {alpha:g}; from {LEAST_ALPHA:g} to below 1 is needed: smaller shares of false alarms "
            "are not told by simulation",
            "alpha",
        )
    if max_effects < 1:
        raise OptionError(f"max_effects = {max_effects}; at least 1 is needed", "max_effects")
    if isinstance(effects, str):
        raise OptionError(f"effects = '{effects}'; a list is needed: ['{effects}']", "effects")
    if effects is not None:
        unknown = [name for name in effects if name.partition(":")[0] not in effect_kinds()]
        if unknown:
            raise OptionError(
                f"effect '{unknown[0]}' is not known{meant(unknown[0], effect_kinds())}; kinds are "
                f"{', '.join(effect_kinds())}",
                "effects",
            )
