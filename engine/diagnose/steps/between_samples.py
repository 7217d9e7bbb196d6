"""Where the input is found to go on between its samples: the record read so, and looked at again.

The effect ``hold`` says it within a model, which is right up to what a straight line does beside its mean
over a sample. Said by the series and run on steps that are short enough it is exact, and what the effect leaves
over, which other names would be found for, is gone. Of size 1 it is a straight line (``hold="foh"``). Of size 2
it is the next row's value (``hold="past"``), as in a table of daily totals: rain and flow of one row are of the
same day. Which of the two is asked of the record, not of a size that what else is wrong moves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from engine.data.series import Series
from engine.diagnose.records import Records
from engine.diagnose.refits.found import Search
from engine.diagnose.steps.substeps import prepare
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml

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
