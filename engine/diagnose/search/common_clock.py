"""Whether what comes with time came in all records at once, by their clocks, or in one of them.

Clocks that overlap are of either kind. Those of places that were watched together are one: what came at noon
came in all. Those of experiments begin at 0 each time, and what comes with time came in one of them; or it
belongs to the experiment, as a valve that opens after a minute, and came in each. Which it is the readings say.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.traits import Course
from engine.diagnose.screening.screening import screen_effects
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit

# what runs otherwise counts anew in each record
PLACED = {Course.STEP, Course.PULSE, Course.EPISODE, Course.HARMONIC}
SURE = 0.2  # of the level: a second clock is a second chance of a false alarm


def came_in_all(
    fit: QuasiFit,
    in_turn: Series,
    as_given: Series,
    kinds: Sequence[str] | None,
    alpha: float,
    seed: int,
) -> bool:
    """Whether something at one time of all records' clocks explains more than anything in one of them.

    Parameters
    ----------
    fit : QuasiFit
        The model, fitted to the records; it reads no clock.
    in_turn, as_given : Series
        The same records, one after the other, on clocks that overlap nowhere, and on their own.
    kinds : sequence of str or None
        Effects that are looked for.
    alpha : float
        Probability of a false alarm. What is not clearer than a part of it leaves them in turn.
    seed : int
        Of the screens.
    """
    all_at_once = _most(fit, as_given, kinds, alpha, seed)
    if all_at_once is None or all_at_once[0] > SURE * alpha:
        return False
    in_one = _most(fit, in_turn, kinds, alpha, seed)
    return in_one is None or all_at_once[1] < in_one[1]


def _most(
    fit: QuasiFit, series: Series, kinds: Sequence[str] | None, alpha: float, seed: int
) -> tuple[float, tuple[float, float]] | None:
    """The p-value of all that comes at a time, and the best effect's own with its score; None without one."""
    setting = setting_for(fit.model, series, np.asarray(fit.theta))
    try:
        screen = screen_effects(
            fit,
            series,
            setting,
            kinds,
            alpha,
            seed,
            lambda stage, share: None,
            asked=lambda effect: effect.traits.course in PLACED,
        )
    except (EngineError, np.linalg.LinAlgError):
        return None
    # so clear that no p-value is left, the score tells
    return screen.p_value, min((one.p_value, -one.statistic) for one in screen.scores)
