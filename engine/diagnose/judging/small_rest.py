"""A small rest without a name takes nothing from the name of nearly all that is wrong.

Where a record is long or hardly noisy, what another program's integration, a clock or a second effect of no
weight leaves is seen beside the cause, too. As a patch on a patch it would be right to trust no name. But not
where one effect alone gains nearly all of the likelihood, and the free run with it over the whole record
keeps next to nothing of its error: then it has its name, and the rest is told. It need not be the first that
was found: what hides behind fitted noise may let a patch on it lead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from engine.data.series import Series
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.likeness import as_foreseen
from engine.diagnose.refits.refitted import Refit, finished
from engine.diagnose.refits.rounds import FORESEEN, Round
from engine.diagnose.screening.screen import Screen
from engine.diagnose.symptoms.runs import noise_free, start_state
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.simulation.free_run import output_scale

REST = 0.1  # of what the one effect gains in likelihood
LEFT_OVER = 0.01  # of the squared error of the free run


def main_alone(found: Search, series: Series) -> Search | None:
    """The search as the round of its main effect left it, None where all that came beside is not a small rest.

    What the model's own steps get wrong is no cause of its own: it stays beside the main effect.
    """
    if found.begun is None or not found.named:
        return None
    main = max((one for one in found.rounds if one.equivalent), key=lambda one: one.refits[0].gain)
    leading = main.refits[0].effect
    if found.begun.refits[0].effect.name == leading.name:
        main = found.begun  # as it was with nothing beside it
    best, named = main.refits[0], found.named
    if leading.family == "noise":
        return None
    own = next(one for one in named if one.effect.name == leading.name)
    steps = [one for one in named if one is not own and as_foreseen(one.effect, one.fit)]
    if len(named) == 1 + len(steps) and not found.alarm_left:
        return None
    fitted = partial(_fitted, found, best.fit, series=series)
    alone = main is found.begun and not steps
    fit = finished(best.fit, series) if alone else fitted((own, *steps))
    gain = 2.0 * (fit.log_likelihood - found.base.log_likelihood)
    rest = 2.0 * (found.final.log_likelihood - fit.log_likelihood) + _seen_after(found)
    if rest > REST * gain or not _runs_free(fit, found.base, series):
        return None
    rounds = [main]
    if steps:
        rounds = [one for one in found.rounds if one.equivalent and one.refits[0] in (own, *steps)]
    kept = [one.refits[0] for one in rounds]
    for k, one in enumerate(kept):
        others = [other for other in kept if other is not one]
        gained = 2.0 * (fit.log_likelihood - fitted(others).log_likelihood)
        rounds[k] = _led_anew(rounds[k], replace(one, fit=fit, gain=gained))
    rounds[0] = replace(rounds[0], screen=found.rounds[0].screen)
    seen = Round(_rest(found, own, steps), (), None, ())
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


def _rest(found: Search, main: Refit, steps: Sequence[Refit]) -> Screen:
    """The screen that saw what else there is; of what was found before the main effect that alone."""
    leads = [one.refits[0] if one.equivalent else None for one in found.rounds]
    place = leads.index(main)
    later = [i for i in range(place + 1, len(leads)) if leads[i] and leads[i] not in steps]
    if later or found.alarm_left:
        return found.rounds[later[0] if later else -1].screen
    first = next(i for i, one in enumerate(leads) if one is not None and one not in steps)
    before = found.rounds[first]
    name = before.refits[0].effect.name
    own = tuple(score for score in before.screen.scores if score.effect.name == name)
    return replace(before.screen, scores=own)


def _fitted(found: Search, begun: QuasiFit, refits: Sequence[Refit], series: Series) -> QuasiFit:
    """The base of a search with some of the effects that were found.

    It starts from the fit of the main one alone: beside all of them noise may have gone to a bound.
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
