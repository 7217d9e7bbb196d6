"""Of a set that the record cannot tell apart, the members that held-out data do not contradict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from engine.data.series import Series
from engine.diagnose.gain.gain import Gain
from engine.diagnose.screening.noise_parameters import noise_of
from engine.diagnose.search.found import Search
from engine.diagnose.search.rounds import Round
from engine.estimation.restricted import restricted
from engine.words import enumerated


def each_in_front(found: Search) -> list[Search]:
    """The search with each member of its set in front, the first one as it is.

    Only that one where several rounds named something: which of them is contradicted nobody knows.
    """
    named = [k for k, r in enumerate(found.rounds) if r.equivalent]
    if len(named) != 1:
        return [found]
    (k,), out = named, [found]
    one = found.rounds[k]
    for member in one.equivalent:
        if member is one.refits[0]:
            continue
        refits = (member, *(r for r in one.refits if r is not member))
        rounds = [*found.rounds]
        rounds[k] = replace(one, refits=refits)
        out.append(replace(found, rounds=tuple(rounds), final=member.fit))
    return out


@dataclass(frozen=True, eq=False)
class Narrowed:
    """What is left of a set: the search, its gain on held-out data, what contradicts it there, a note."""

    search: Search
    gain: Gain | None
    objection: str = ""
    note: str = ""


def narrowed(
    found: Search,
    ask: Callable[[Search], tuple[Gain | None, str]],
    progress: Callable[[str, float], Any] = lambda stage, share: None,
) -> Narrowed:
    """The search without the members of its set that ``ask`` objects to.

    ``ask`` measures what an extension gains on held-out data, with a sentence where that contradicts it. Where
    all members are contradicted the set stays as it is, with the objection to its first one.
    """
    orders = each_in_front(found)
    gain, objection = ask(orders[0])
    if not objection:
        return Narrowed(found, gain)
    asked = []
    for j, order in enumerate(orders[1:], 1):
        progress("gain", j / len(orders))
        asked.append((order, *ask(order)))
    kept = [(order, there) for order, there, said in asked if not said]
    if not kept:
        return Narrowed(found, gain, objection)
    first, there = kept[0]
    left = [_leading(order).refits[0] for order, _ in kept]
    rounds = tuple(
        replace(r, equivalent=tuple(x for x in r.equivalent if x in left)) if r.equivalent else r
        for r in first.rounds
    )
    gone = [r.effect.name for r in _leading(found).equivalent if r not in left]
    kept_names = [r.effect.name for r in left]
    note = (
        f"The record does not tell {enumerated([*gone, *kept_names])} apart, the held-out data do: with "
        f"{enumerated(gone, 'or')} the extension loses there what it should gain."
    )
    return Narrowed(replace(first, rounds=rounds), there, note=note)


def with_fair_noise(found: Search, series: Series) -> Search:
    """The search with the noise of its models as great as their other parameters leave it."""
    base, final = (restricted(f, series, noise_of(f, series)) for f in (found.base, found.final))
    return replace(found, base=base, final=final)


def _leading(found: Search) -> Round:
    return next(r for r in found.rounds if r.equivalent)
