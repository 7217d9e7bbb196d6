"""What begins in rows that were held out of the search, where nothing was found before them.

The last part of a record is kept back to judge what is found. Where nothing is, it has judged nothing, and an
event in it, a step or a pulse, is plain in a picture and in no verdict. So the model is fitted to the whole
record then, and events are screened on it. One that lies in the rows held out is told, and not named: it was
neither refitted nor compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.traits import Course
from engine.diagnose.screening.screening import screen_effects
from engine.errors import EngineError, OptionError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.words import moment, probability

EVENTS = (Course.STEP, Course.PULSE)


@dataclass(frozen=True)
class Unsearched:
    """An event that the screen sees at ``time`` among rows held out from ``since`` on.

    ``step`` is the time between samples; all three in ``clock``. Which event it is only a refit tells: a step
    of a reading and one of the state behind it have their scores close together.
    """

    time: float
    since: float
    step: float
    clock: str
    p_value: float
    at_floor: bool

    @property
    def sentence(self) -> str:
        """For the first lines of a diagnosis that found nothing."""
        since, time = (moment(t, self.step, self.clock) for t in (self.since, self.time))
        return (
            f"That is of the rows before t = {since}. Those held out were not searched, and something seems to "
            f"happen there, near t = {time} ({probability(self.p_value, self.at_floor)}): held_out=0 searches "
            "all of the record."
        )


def begins_unsearched(
    fit: QuasiFit,
    whole: Series,
    cut: int,
    tested: Sequence[Effect],
    alpha: float,
    seed: int,
) -> Unsearched | None:
    """The event that leads on the ``whole`` record, where it lies in the rows from ``cut`` on, if one does.

    ``fit`` is to the rows before, on which the effects ``tested`` were asked; ``alpha`` is the family-wise
    level of all events in the whole record.
    """
    events = [e.name for e in tested if _is_event(e)]
    if not events:
        return None
    try:
        again = quasi_ml(fit.model, whole, fit.theta, fit.free)
        setting = setting_for(fit.model, whole, np.asarray(again.theta))
        seen = screen_effects(again, whole, setting, events, alpha, seed, lambda *_: None)
    except (EngineError, OptionError, np.linalg.LinAlgError):
        return None
    best, since = seen.scores[0], float(whole.t[cut])
    if seen.p_value > alpha or not best.at or best.at[0] < since:
        return None
    return Unsearched(
        float(best.at[0]),
        since,
        whole.usual_step * whole.substeps,
        whole.time_unit,
        seen.p_value,
        seen.at_floor,
    )


def _is_event(effect: Effect) -> bool:
    """Whether an effect is a step or pulse of a channel, as which one of a parameter or gain shows, too."""
    return effect.traits.course in EVENTS and not effect.traits.alters
