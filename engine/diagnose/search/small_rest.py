"""A small rest without a name takes nothing from the name of nearly all that is wrong.

Where a record is long or hardly noisy, what another program's integration, a clock or a second effect of no
weight leaves is seen beside the cause, too. As a patch on a patch it would be right to trust no name. But not
where the first effect alone gains nearly all of the likelihood, and the free run with it over the whole record
keeps next to nothing of its error: then the first has its name, and the rest is told.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from engine.data.series import Series
from engine.diagnose.search.found import Search
from engine.diagnose.search.refits import finished
from engine.diagnose.search.rounds import FORESEEN, Round
from engine.diagnose.symptoms.runs import noise_free, start_state
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit
from engine.simulation.free_run import output_scale

REST = 0.1  # of what the first effect gains in likelihood
LEFT_OVER = 0.01  # of the squared error of the free run


def first_alone(found: Search, series: Series) -> Search | None:
    """The search as its first round left it, None where what came after is not a small rest."""
    begun = found.begun
    if begun is None or not (len(found.named) > 1 or found.alarm_left):
        return None
    if begun.refits[0].effect.family == "noise":
        return None
    best = begun.refits[0]
    if best.effect.name != found.named[0].effect.name:
        return None
    fit = finished(best.fit, series)
    gain = 2.0 * (fit.log_likelihood - found.base.log_likelihood)
    rest = 2.0 * (found.final.log_likelihood - fit.log_likelihood) + _seen_after(found)
    if rest > REST * gain or not _runs_free(fit, found.base, series):
        return None
    alone = replace(best, fit=fit, gain=gain)
    first = replace(
        begun,
        refits=(alone, *begun.refits[1:]),
        equivalent=(alone, *(one for one in begun.equivalent if one is not best)),
    )
    seen = Round(found.rounds[1].screen, (), None, ())
    return replace(
        found,
        final=fit,
        rounds=(first, seen),
        alarm_left=False,
        of_the_steps="",
        unweighed=(),
        as_well=(),
        small_rest=True,
    )


def is_small(gain: float, found: Search, series: Series) -> bool:
    """Whether what would gain so much is a small rest beside all that was found."""
    if found.small_rest:
        return gain <= REST * found.named[0].gain
    if found.alarm_left or any(one.effect.family == "noise" for one in found.named):
        return False
    gained = 2.0 * (found.final.log_likelihood - found.base.log_likelihood)
    return gain <= REST * gained and _runs_free(found.final, found.base, series)


def _seen_after(found: Search) -> float:
    """2 x log-likelihood that a last alarm, which nothing explains, may be worth."""
    last = found.rounds[-1]
    if not found.alarm_left or last.equivalent:
        return 0.0
    gains = [one.gain for one in (*last.refits, last.generic) if one is not None]
    seen = max((score.statistic for score in last.screen.scores), default=0.0)
    return max(gains, default=FORESEEN * seen)


def _runs_free(fit: QuasiFit, base: QuasiFit, series: Series) -> bool:
    """Whether the free run keeps next to nothing of its error."""
    return _run_error(fit, series) <= LEFT_OVER * _run_error(base, series)


def _run_error(fit: QuasiFit, series: Series) -> float:
    """Mean squared error of the free run over a record, outputs weighed; NaN where it is lost."""
    theta = np.asarray(fit.theta)
    try:
        x1, _ = start_state(fit.model, theta, series)
        y, _ = noise_free(fit.model, theta, series, x1)
    except (EngineError, np.linalg.LinAlgError):
        return float("nan")
    if not np.isfinite(y[series.observed.any(axis=1)]).all():
        return float("nan")
    return float(np.nanmean(np.square((series.y - y) / output_scale([series]))))
