"""A record that begins where the model's first state says that none does, as a part of a longer run.

What is found first may do nothing but make up for that: of a drive whose record was cut from a run a gain of
the sensor was named, ten times the reading, as it widens the first state too. The model as it is, begun
anywhere that the record has been, tells.
"""

from __future__ import annotations

import numpy as np

from engine.data.series import Series
from engine.diagnose.first_states import anywhere
from engine.diagnose.refits.found import Search
from engine.errors import EngineError
from engine.estimation.beginnings import about_beginnings
from engine.estimation.quasi_ml import quasi_ml
from engine.words import number

OF_BEGINNINGS = ("start", "start-scatter")


def begun_elsewhere(found: Search, series: Series) -> str:
    """A sentence where the record, begun anywhere, explains more than what was found first; else "".

    Not of several records, whose beginnings are compared with each other, nor where another first value leads.
    """
    first, base = found.rounds[0], found.base
    if series.begins or not first.equivalent or first.refits[0].effect.kind in OF_BEGINNINGS:
        return ""
    try:
        said = about_beginnings(base.model, np.asarray(base.theta), [series])
        if not said:
            return ""
        wide, _ = anywhere(base, base, series)
        fit = quasi_ml(wide.model, series, base.theta, base.free)
    except (EngineError, np.linalg.LinAlgError):
        return ""
    gain = 2.0 * (fit.log_likelihood - base.log_likelihood)
    if gain <= first.refits[0].score:
        return ""
    name = first.refits[0].effect.name
    return (
        f"{said} Begun anywhere, the model as it is gains {number(gain)} in 2 x log-likelihood, more than "
        f"{name} explains: no cause is named."
    )
