"""Where the input is found to go on between its samples: the record read so, and looked at again.

The effect ``hold`` says it within a model, which is right up to what a straight line does beside its mean
over a sample. Said by the series and run on steps that are short enough it is exact, and what the effect leaves
over, which other names would be found for, is gone. Of size 1 it is a straight line (``hold="foh"``). Of size 2
it is the next row's value (``hold="past"``), as in a table of daily totals: rain and flow of one row are of the
same day. Which of the two is asked of the record, not of a size that what else is wrong moves.

A record that is read wrongly has large errors wherever its input moves, and noise takes these first, outliers
above all: after them the effect is no more seen. So where noise leads, the record is read otherwise as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from engine.data.series import Series
from engine.diagnose.judging.feedback import answering
from engine.diagnose.records import Records
from engine.diagnose.refits.found import Search, size_cost
from engine.diagnose.refits.rounds import MARGIN
from engine.diagnose.steps.substeps import prepare
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.words import enumerated, number

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
    first, base = found.rounds[0], found.base
    effect = first.refits[0].effect if first.equivalent else None
    if effect is None or len(first.equivalent) > 1 or not effect.traits.says_hold:
        return None
    try:
        model = effect.apply(base.model)
        own = [first.refits[0].fit.theta[p.name] for p in effect.parameters]
        names = [p.name for p in effect.parameters if p.name not in effect.held]
        extended = quasi_ml(model, series, [*base.theta, *own], [*base.free, *names])
        read, other = read_with(effect.traits.says_hold, base, series)
        if read.log_likelihood < extended.log_likelihood - AS_GOOD:
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
    if further or again.alarm_left:
        said = ", ".join(further) or "something without a name"
        return ReadOtherwise(found, f"{note} So read, it still shows {said}: diagnose it so again.")
    search = replace(found, final=extended, rounds=(first, again.rounds[0]), alarm_left=False)
    return ReadOtherwise(search, f"{note} So read, nothing else is left to see.")


def read_wrongly(
    found: Search,
    series: Series,
    holds: Sequence[str],
    look: Callable[[QuasiFit, Series], Search],
) -> str:
    """A sentence where noise leads, and the record read as one of ``holds`` explains more; else "".

    What is found beside either reading counts, less what its parameters cost; a reading has none. It must be
    likelier by itself, else ``look`` is spared. Not where the input answers the readings: that of a later row
    does for any error.
    """
    first, base = found.rounds[0], found.base
    if not first.equivalent or first.refits[0].effect.family != "noise" or not holds:
        return ""
    try:
        read, other = read_with(holds, base, series)
        gain = 2.0 * (read.log_likelihood - base.log_likelihood)
        if gain <= size_cost(series) or answering(read, other):
            return ""
        again = look(read, other)
    except (EngineError, np.linalg.LinAlgError):
        return ""
    if gain + again.score(series) <= found.score(series) + MARGIN:
        return ""
    names = enumerated([one.effect.name for one in found.named])
    further = enumerated([one.effect.name for one in again.named])
    beside = f", with {further}," if further else ""
    return (
        f"Read with hold='{other.hold}' the model as it is gains {number(gain)} in 2 x log-likelihood, and"
        f"{beside} explains more than {names} with the record as given. That is how the input goes on between "
        "its samples, so no cause is named: diagnose it so again."
    )


def read_with(holds: Sequence[str], base: QuasiFit, series: Series) -> tuple[QuasiFit, Series]:
    """A fit of the base model to the record with its inputs read as one of ``holds``, and that record.

    The one that makes the record likeliest. Raises EngineError where none can be fitted.
    """
    read: list[tuple[QuasiFit, Series]] = []
    for k, hold in enumerate(holds, 1):
        try:
            records = Records(series.held(hold))
            other = prepare(base.model, records, lambda: np.asarray(base.theta)).records.main
            read.append((quasi_ml(base.model, other, base.theta, base.free), other))
        except EngineError:
            if k == len(holds) and not read:
                raise
    return max(read, key=lambda one: one[0].log_likelihood)
