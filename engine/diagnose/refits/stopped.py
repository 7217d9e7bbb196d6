"""A changed parameter that a bound stops, only because a fit has led it there: it is held where it was before.

Where the record tells little but the ratio of two parameters, the fit of a step in one of them may lead both to
where the bound cuts the step. Its size is then any that is large enough, and the data seem not to tell it.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.kinds.parameters import ONTO, stopped_share
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.statespace.model import Array

LOSS = (
    0.5  # of the log-likelihood: what a parameter may lose that is held where the base fit has it
)
SHORTER = 0.5 ** np.arange(8)  # of the size, from which it is looked for again


def off_the_bound(
    base: QuasiFit, found: QuasiFit, effect: Effect, series: Series, climb: Callable[..., QuasiFit]
) -> QuasiFit:
    """The fit ``found`` of a model with the effect, or one as likely in which no bound stops what it changes.

    ``climb(start, free=names)`` is another fit of that model.
    """
    if effect.runs is None or not stopped_share(effect, found.model, found.theta, series):
        return found
    name = effect.channel.rpartition(ONTO)[2]
    if name not in base.free:
        return found
    start = _within(base, found, effect, series, name)
    if start is None:
        return found
    others = [other for other in found.free if other != name]
    with suppress(EngineError, np.linalg.LinAlgError):
        held = climb(start, free=others)
        freed = stopped_share(effect, held.model, held.theta, series) == 0.0
        if freed and held.log_likelihood >= found.log_likelihood - LOSS:
            # what all of them are known by, where it is
            known = quasi_ml(found.model, series, held.theta, found.free, max_iterations=0)
            return replace(known, converged=held.converged, iterations=held.iterations)
    return found


def _within(
    base: QuasiFit, found: QuasiFit, effect: Effect, series: Series, name: str
) -> Array | None:
    """theta (n,) as the base fit has it, with as much of the effect as no bound stops; None where none does."""
    n = len(base.theta)
    theta = np.concatenate([np.asarray(base.theta), np.asarray(found.theta)[n:]])
    before, after = base.theta[name], found.theta[name]
    if before * after > 0.0:  # a change in the same ratio
        theta[n : n + len(effect.amplitudes)] *= min(before / after, 1.0)
    for share in SHORTER:
        trial = theta.copy()
        trial[n : n + len(effect.amplitudes)] *= share
        if not stopped_share(effect, found.model, found.model.theta(trial), series):
            return trial
    return None
