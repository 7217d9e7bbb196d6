"""Of a set that the record cannot tell apart, the members that held-out data do not contradict."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from engine.data.series import Series
from engine.diagnose.gain.gain import Gain, without
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import Round
from engine.diagnose.screening.noise_parameters import noise_of
from engine.estimation.quasi_ml import QuasiFit, derivatives, quasi_ml
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
    settled: Callable[[Round, Sequence[Refit]], Round],
    progress: Callable[[str, float], Any] = lambda stage, share: None,
) -> Narrowed:
    """The search without the members of its set that ``ask`` objects to.

    ``ask`` measures what an extension gains on held-out data, with a sentence where that contradicts it. Where
    all members are contradicted the set stays as it is, with the objection to its first one.

    A set is what comes near its best member. Without that one, what was too far behind it may be as near to the
    next one: ``settled`` makes the round of these refits anew, and who comes into its set is asked as well.
    """
    orders = each_in_front(found)
    gain, objection = ask(orders[0])
    if not objection:
        return Narrowed(found, gain)
    answers = {_name(orders[0]): (gain, objection)}
    now = found
    while True:
        orders = each_in_front(now)
        for j, order in enumerate(orders):
            if _name(order) not in answers:
                progress("gain", j / len(orders))
                answers[_name(order)] = ask(order)
        left = [order for order in orders if not answers[_name(order)][1]]
        if not left:
            return Narrowed(found, gain, objection)
        if len(left) == len(orders):
            break
        now = _without([name for name, (_, said) in answers.items() if said], left[0], settled)
    first = orders[0]
    gone = [name for name, (_, said) in answers.items() if said]
    apart = enumerated([*gone, *map(_name, orders)])
    note = (
        f"The record does not tell {apart} apart, the held-out data do: with {enumerated(gone, 'or')} the "
        "extension loses there what it should gain."
    )
    return Narrowed(first, answers[_name(first)][0], note=note)


def _without(
    gone: Sequence[str], found: Search, settled: Callable[[Round, Sequence[Refit]], Round]
) -> Search:
    """The search with its round made anew of the refits that are not ``gone``."""
    k = next(k for k, r in enumerate(found.rounds) if r.equivalent)
    one, rounds = found.rounds[k], [*found.rounds]
    against = tuple(r for r in one.refits if r.effect.name in gone)
    again = settled(one, [r for r in one.refits if r not in against])
    # those that held-out data contradict stay among the refits, so that the page says what became of them
    rounds[k] = replace(again, refits=(*again.refits, *against), contradicted=against)
    return replace(found, rounds=tuple(rounds), final=again.refits[0].fit)


def _name(found: Search) -> str:
    """The name in front."""
    return next(r for r in found.rounds if r.equivalent).refits[0].effect.name


def last_alone(found: Search, series: Series) -> Search:
    """Only what was named last, beside a model with all that was named before, which is fitted without it."""
    last = max(k for k, r in enumerate(found.rounds) if r.equivalent)
    effect, final = found.rounds[last].refits[0].effect, found.final
    own = [parameter.name for parameter in effect.parameters]
    theta = without(final, [effect]).theta
    free = [name for name in final.free if name not in own]
    base = quasi_ml(final.model, [series], theta, free)
    return replace(found, base=base, rounds=found.rounds[last:])


def with_fair_noise(found: Search, series: Series) -> Search:
    """The search with the noise of its models as great as their other parameters leave it."""
    base, final = (restricted(f, series, noise_of(f, series)) for f in (found.base, found.final))
    return replace(found, base=base, final=final)


def with_noise_of(records: Sequence[Series], found: Search, series: Series) -> Search:
    """The search with the noise of its models fitted to all ``records``, and all else as it was."""

    def again(fit: QuasiFit) -> QuasiFit:
        names = [name for name, yes in zip(fit.free, noise_of(fit, series), strict=True) if yes]
        if not names:
            return fit
        theta = quasi_ml(fit.model, records, fit.theta, names).theta
        indices = fit.model.free_indices(fit.free)
        value, _, H = derivatives(fit.model, [series], np.asarray(theta), indices)
        return replace(fit, theta=theta, log_likelihood=float(value), information=H)

    return replace(found, base=again(found.base), final=again(found.final))
