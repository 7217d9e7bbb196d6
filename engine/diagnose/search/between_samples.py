"""Where the input is found to go on between its samples: the record read so, and looked at again.

The effect ``hold`` says it within a model, which is right up to what a straight line does beside its mean
over a sample. Said by the series and run on steps that are short enough it is exact, and what the effect leaves
over, which other names would be found for, is gone. Of size 1 it is a straight line (``hold="foh"``). Of size 2
it is the next row's value (``hold="past"``), as in a table of daily totals: rain and flow of one row are of the
same day. Which of the two is asked of the record, not of a size that what else is wrong moves.

A direct path from the input is nearly the same as the next row's value, which a plant of first order answers
at once. Where it leads, the reading that needs no size at all is preferred if it explains as much.

A record that is read wrongly has large errors wherever its input moves, and noise takes these first, outliers
above all: after them the effect is no more seen. So where noise or a sensor leads, the record is read otherwise
as well. A logger may also write an input one row late. Then even a reading that the input enters at once is
there before it, and the record is read with the input's column moved up.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from engine.data.series import Series
from engine.diagnose.judging.feedback import answering
from engine.diagnose.records import Records
from engine.diagnose.refits.found import Search, size_cost
from engine.diagnose.refits.rounds import MARGIN, Round
from engine.diagnose.steps.substeps import prepare
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.words import enumerated, number

NEARLY = 0.5  # of the leading effect's gain, that one which a series can say has at least
AS_GOOD = 3.0  # log-likelihood that the record read otherwise may lack of the effect's


@dataclass(frozen=True)
class ReadOtherwise:
    """The search as it then is, and a sentence about it."""

    search: Search
    note: str


def read_otherwise(
    found: Search, series: Series, look: Callable[[QuasiFit, Series], Search]
) -> ReadOtherwise | None:
    """What the record shows when its inputs are read as the first effect that was found says.

    ``look`` searches beside a fit of the base model. None where the first effect is not one that a series can
    say, or where a series does not say it as well.
    """
    first, base = _led_by_a_hold(found.rounds[0]), found.base
    if first is None:
        return None
    effect, lead = first.refits[0].effect, found.rounds[0].refits[0]
    try:
        model = effect.apply(base.model)
        own = [first.refits[0].fit.theta[p.name] for p in effect.parameters]
        names = [p.name for p in effect.parameters if p.name not in effect.held]
        extended = quasi_ml(model, series, [*base.theta, *own], [*base.free, *names])
        read, other = read_with(effect.traits.says_hold, base, series)
        if read.log_likelihood < extended.log_likelihood - AS_GOOD:
            return None
        instead = lead is not first.refits[0]
        least = lead.score - size_cost(series) + MARGIN
        if instead and 2.0 * (read.log_likelihood - base.log_likelihood) < least:
            return None
        again = look(read, other)
    except EngineError:
        return None
    gains = [fit.log_likelihood - base.log_likelihood for fit in (read, extended)]
    note = (
        f"The record says it better than an extension: read with hold='{other.hold}' the model as it is gains "
        f"{gains[0]:.1f} in log-likelihood, the extension {gains[1]:.1f}."
    )
    further = [r.refits[0].effect.name for r in again.rounds if r.equivalent]
    if instead and (further or again.alarm_left):
        return None
    if instead:
        note += f" {lead.effect.name}, which says nearly the same, gains {number(0.5 * lead.gain)}."
    if further or again.alarm_left:
        said = ", ".join(further) or "something without a name"
        return ReadOtherwise(found, f"{note} So read, it still shows {said}: diagnose it so again.")
    search = replace(found, final=extended, rounds=(first, again.rounds[0]), alarm_left=False)
    return ReadOtherwise(search, f"{note} So read, nothing else is left to see.")


def _led_by_a_hold(first: Round) -> Round | None:
    """The round as it is, if a series can say what leads it; or so led, if something of a sensor leads it.

    None where a series can say none of its effects, or they explain much less.
    """
    if not first.equivalent:
        return None
    lead = first.refits[0]
    if lead.effect.traits.says_hold:
        return first if len(first.equivalent) == 1 else None
    if lead.effect.family != "measurement":
        return None
    for refit in first.refits:
        if refit.effect.traits.says_hold and refit.gain >= NEARLY * lead.gain:
            others = (one for one in first.refits if one is not refit)
            return replace(first, refits=(refit, *others), equivalent=(refit,))
    return None


def read_wrongly(
    found: Search,
    series: Series,
    holds: Sequence[str],
    look: Callable[[QuasiFit, Series], Search],
) -> str:
    """A sentence where noise or a sensor leads, and the record read otherwise explains more; else "".

    Otherwise is as one of ``holds``, or with inputs one row earlier. What is found beside either reading
    counts, less what its parameters cost; a reading has none. It must be likelier by itself, beside a sensor's
    fault as likely as what was found, else ``look`` is spared. Not where the input answers the readings: that
    of a later row does for any error.
    """
    first, base = found.rounds[0], found.base
    lead = first.refits[0].effect if first.equivalent else None
    if lead is None or lead.family not in ("noise", "measurement") or not series.u.shape[1]:
        return ""
    try:
        said, read, other = _likeliest(base, series, holds)
        gain = 2.0 * (read.log_likelihood - base.log_likelihood)
        cost, score = size_cost(series), found.score(series)
        least = cost if lead.family == "noise" else max(cost, score - cost)
        if gain <= least or answering(read, other):
            return ""
        again = look(read, other)
    except (EngineError, np.linalg.LinAlgError):
        return ""
    if gain + again.score(series) <= score + MARGIN:
        return ""
    names = enumerated([one.effect.name for one in found.named])
    further = enumerated([one.effect.name for one in again.named])
    beside = f", with {further}," if further else ""
    how, then = said
    return (
        f"Read with {how} the model as it is gains {number(gain)} in 2 x log-likelihood, and"
        f"{beside} explains more than {names} with the record as given. {then}"
    )


Read: TypeAlias = tuple[tuple[str, str], QuasiFit, Series]


def _likeliest(base: QuasiFit, series: Series, holds: Sequence[str]) -> Read:
    """How the record is likeliest, in words, and what to do; the fit of the base model to it, and the record.

    Raises EngineError where it can be read in no other way.
    """
    read: list[Read] = []
    with suppress(EngineError):
        if holds:
            fit, other = read_with(holds, base, series)
            then = (
                "That is how the input goes on between its samples, so no cause is named: diagnose it so "
                "again."
            )
            read.append(((f"hold='{other.hold}'", then), fit, other))
    names, every = base.model.inputs, range(series.u.shape[1])
    for columns in [[*every], *([k] for k in every if len(every) > 1)]:
        # of several records the last row of one would be the first of the next
        if series.begins:
            break
        moved = [list(names)[k] for k in columns]
        then = (
            f"So {enumerated(moved)} may be written one row late, and no cause is named: move "
            f"{'its column' if len(moved) == 1 else 'their columns'} up by a row, and diagnose it again."
        )
        with suppress(EngineError):
            fit, other = _fitted(base, earlier(series, columns))
            read.append(((f"{enumerated(moved)} one row earlier", then), fit, other))
    if not read:
        raise EngineError("the record can be read in no other way")
    first = read[0]
    best = max(read, key=lambda one: one[1].log_likelihood)
    return best if best[1].log_likelihood > first[1].log_likelihood + AS_GOOD else first


def earlier(series: Series, columns: Sequence[int]) -> Series:
    """The samples of a series with some columns of u one row earlier; the last one is held."""
    given = series.held(series.hold)
    u = given.u.copy()
    u[:-1, columns] = given.u[1:, columns]
    return given.replace(u=u)


def read_with(holds: Sequence[str], base: QuasiFit, series: Series) -> tuple[QuasiFit, Series]:
    """A fit of the base model to the record with its inputs read as one of ``holds``, and that record.

    The one that makes the record likeliest. Raises EngineError where none can be fitted.
    """
    read: list[tuple[QuasiFit, Series]] = []
    for k, hold in enumerate(holds, 1):
        try:
            read.append(_fitted(base, series.held(hold)))
        except EngineError:
            if k == len(holds) and not read:
                raise
    return max(read, key=lambda one: one[0].log_likelihood)


def _fitted(base: QuasiFit, read: Series) -> tuple[QuasiFit, Series]:
    """The base model fitted to the record as it is ``read``, on steps that are short enough, and this."""
    other = prepare(base.model, Records(read), lambda: np.asarray(base.theta)).records.main
    return quasi_ml(base.model, other, base.theta, base.free), other
