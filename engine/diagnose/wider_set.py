"""A name that another one beats over the horizon, and that the likelihood prefers by little, is one of a set.

The likelihood one step ahead weighs errors by the noise that each model has for itself. Where that prefers a
name by too little to rule another one out, and the other one predicts better one step ahead, farther on and in
free run, the record has not decided.

Nor have several records where another name with values of their own explains as much. Growth that its size
limits, each tree at a limit of its own, is by one set of values less likely than growth that falls with time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.traits import Course
from engine.diagnose.held_out import Judged
from engine.diagnose.judging.by_record import own_values
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.judging.judgement import NAMES, has_tails
from engine.diagnose.judging.verdict import RULED_OUT, named_by
from engine.diagnose.over_horizon import OverHorizon
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import MARGIN, Round
from engine.estimation.quasi_ml import QuasiFit
from engine.words import enumerated

ASKED = 8  # names, the likeliest first, that are asked whether records have values of their own beside them
# families of names of which records may have values of their own
PHYSICAL = ("state", "measurement", "input")
EVENTS = (Course.STEP, Course.PULSE, Course.EPISODE)


def widened(judged: Judged, beside: OverHorizon | None) -> Judged:
    """The answer with those beside its first name that neither the likelihood nor the horizon rules out."""
    if judged.verdict not in NAMES or judged.free_run.decides or beside is None:
        return judged
    found = judged.search.rounds[0]
    if not found.equivalent:
        return judged
    first, near = found.refits[0], _not_ruled_out(found)
    more = beside.as_good([one.effect.name for one in near], first.effect.name)
    if not more:
        return judged
    wide = [next(one for one in near if one.effect.name == name) for name in more]
    are = "is" if len(more) == 1 else "are"
    note = (
        f"{enumerated([*more])} {are} less likely than {first.effect.name}, by too little to be ruled out, and "
        "better at every horizon, the free run included: the record does not tell them apart."
    )
    return _with(judged, wide, note)


def widened_by_records(judged: Judged, series: Series) -> Judged:
    """The answer with names that explain as much as its first one, once records have values of their own.

    ``series`` are the records that the likelihood has searched.
    """
    if judged.verdict not in NAMES or judged.free_run.decides or not series.begins:
        return judged
    named = [r for r in judged.search.rounds if r.equivalent]
    alone = len(named) == 1
    # of several names the last rounds have the rivals of each beside the others
    found = judged.search.rounds[0] if alone else judged.search.begun or judged.search.rounds[0]
    others = [one for one in _rivals(found) if one.effect.family in PHYSICAL][:ASKED]
    if not found.equivalent or not others or has_tails(judged.search):
        return judged
    if any(r.refits[0].effect.traits.course in EVENTS for r in named):
        return judged  # what happens at one time is of one record, whose value would say no more
    cost = float(np.log(series.n_measured))

    def with_own(fit: QuasiFit, score: float) -> tuple[float, tuple[str, ...]]:
        own = own_values(fit, series)
        return (score, ()) if own is None else (score + own.gain - own.further * cost, own.names)

    final, first = judged.search.final, found.refits[0]
    gained = 2.0 * (final.log_likelihood - judged.search.base.log_likelihood)
    costs = sum(r.refits[0].gain - r.refits[0].score for r in named) + (len(named) - 1) * cost
    least = with_own(*((first.fit, first.score) if alone else (final, gained - costs)))[0] - MARGIN
    each = [(one, *with_own(one.fit, one.score)) for one in others]
    near = [(one, names) for one, score, names in each if names and score >= least]
    if not near:
        return judged
    what = [f"{one.effect.name} with values of {enumerated([*names])}" for one, names in near]
    which = "these data do not tell which it is" if alone else "no cause is named"
    note = (
        f"Where records may have values of their own, {enumerated(what)} for each of them "
        f"{'explains' if len(near) == 1 else 'explain'} as much as "
        f"{enumerated([r.refits[0].effect.name for r in named])}: {which}."
    )
    if alone:
        return _with(judged, [one for one, _ in near], note)
    return replace(judged, verdict=Verdict.UNKNOWN, notes=(*judged.notes, note))


def _with(judged: Judged, wide: Sequence[Refit], note: str) -> Judged:
    """The answer with more names in its first set, and why."""
    found = judged.search.rounds[0]
    rounds = (replace(found, equivalent=(*found.equivalent, *wide)), *judged.search.rounds[1:])
    search = replace(judged.search, rounds=rounds)
    return replace(
        judged,
        verdict=Verdict.SET,
        causes=named_by(search),
        search=search,
        notes=(*judged.notes, note),
    )


def _not_ruled_out(found: Round) -> list[Refit]:
    """Refits behind the leading one of a round by too little, that are not in its set."""
    first = found.refits[0]
    return [
        one
        for one in _rivals(found)
        if not one.fit.given_up and min(first.gain - one.gain, first.score - one.score) <= RULED_OUT
    ]


def _rivals(found: Round) -> list[Refit]:
    """Refits of a round that gain something, but are not in its set."""
    known = (*found.equivalent, *found.contradicted)
    return [
        one
        for one in found.refits
        if one not in known and not one.effect.traits.outliers and one.gain > 0.0
    ]
