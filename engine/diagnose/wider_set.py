"""A name that another one beats over the horizon, and that the likelihood prefers by little, is one of a set.

The likelihood one step ahead weighs errors by the noise that each model has for itself. Where that prefers a
name by too little to rule another one out, and the other one predicts better one step ahead, farther on and in
free run, the record has not decided.
"""

from __future__ import annotations

from dataclasses import replace

from engine.diagnose.held_out import Judged
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.judging.judgement import NAMES
from engine.diagnose.judging.verdict import RULED_OUT, named_by
from engine.diagnose.over_horizon import OverHorizon
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import Round
from engine.words import enumerated


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
    rounds = (replace(found, equivalent=(*found.equivalent, *wide)), *judged.search.rounds[1:])
    search = replace(judged.search, rounds=rounds)
    are = "is" if len(more) == 1 else "are"
    note = (
        f"{enumerated([*more])} {are} less likely than {first.effect.name}, by too little to be ruled out, and "
        "better at every horizon, the free run included: the record does not tell them apart."
    )
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
    known = (*found.equivalent, *found.contradicted)
    return [
        one
        for one in found.refits
        if one not in known
        and not (one.fit.given_up or one.effect.traits.outliers)
        and min(first.gain - one.gain, first.score - one.score) <= RULED_OUT
        and one.gain > 0.0
    ]
