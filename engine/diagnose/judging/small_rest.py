"""A small rest without a name takes nothing from the name of nearly all that is wrong.

Where a record is long or hardly noisy, what another program's integration, a clock or a second effect of no
weight leaves is seen beside the cause, too. As a patch on a patch it would be right to trust no name. But not
where the first effect alone gains nearly all of the likelihood, and the free run with it over the whole record
keeps next to nothing of its error: then the first has its name, and the rest is told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import takewhile

import numpy as np

from engine.data.series import Series
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.likeness import as_foreseen
from engine.diagnose.refits.refit import Refit, finished
from engine.diagnose.refits.rounds import FORESEEN, Round
from engine.diagnose.symptoms.runs import noise_free, start_state
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.simulation.free_run import output_scale

REST = 0.1  # of what the first effect gains in likelihood
LEFT_OVER = 0.01  # of the squared error of the free run


def first_alone(found: Search, series: Series) -> Search | None:
    """The search as its first round left it, None where what came after is not a small rest.

    What the model's own steps get wrong is no cause of its own: found next, it stays beside the first.
    """
    begun = found.begun
    if begun is None or begun.refits[0].effect.family == "noise":
        return None
    best, named = begun.refits[0], found.named
    if best.effect.name != named[0].effect.name:
        return None
    steps = list(takewhile(lambda one: as_foreseen(one.effect, one.fit), named[1:]))
    if len(named) == 1 + len(steps) and not found.alarm_left:
        return None
    fitted = partial(_fitted, found, best.fit, series=series)
    fit = fitted((named[0], *steps)) if steps else finished(best.fit, series)
    gain = 2.0 * (fit.log_likelihood - found.base.log_likelihood)
    rest = 2.0 * (found.final.log_likelihood - fit.log_likelihood) + _seen_after(found)
    if rest > REST * gain or not _runs_free(fit, found.base, series):
        return None
    rounds = [begun]
    if steps:
        rounds = [one for one in found.rounds if one.equivalent][: 1 + len(steps)]
    kept = [one.refits[0] for one in rounds]
    for k, one in enumerate(kept):
        others = [other for other in kept if other is not one]
        gained = 2.0 * (fit.log_likelihood - fitted(others).log_likelihood)
        rounds[k] = _led_anew(rounds[k], replace(one, fit=fit, gain=gained))
    seen = Round(found.rounds[len(rounds)].screen, (), None, ())
    return replace(
        found,
        final=fit,
        rounds=(*rounds, seen),
        alarm_left=False,
        of_the_steps="",
        unweighed=(),
        as_well=(),
        small_rest=True,
    )


def _fitted(found: Search, begun: QuasiFit, refits: Sequence[Refit], series: Series) -> QuasiFit:
    """The base of a search with some of the effects that were found.

    It starts from the fit of the first alone: beside all of them noise may have gone to a bound.
    """
    if not refits:
        return found.base
    model = found.base.model
    for one in refits:
        model = one.effect.apply(model)
    known = found.final.theta.asdict() | begun.theta.asdict()
    theta = model.theta({name: known[name] for name in model.parameter_names})
    free = [name for name in found.final.free if name in model.parameter_names]
    return quasi_ml(model, series, theta, free)


def _led_anew(found: Round, best: Refit) -> Round:
    """The round with another fit of what leads it."""
    before = found.refits[0]
    others = tuple(one for one in found.equivalent if one is not before)
    return replace(found, refits=(best, *found.refits[1:]), equivalent=(best, *others))


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
