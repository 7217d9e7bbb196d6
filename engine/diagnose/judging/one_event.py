"""Steps that came at one time are one event: a payload that is picked up, a tool that is changed.

It alters all parameters that it enters, so a search finds several steps in turn, each with a time of its own.
Each of these was the best beside others that were not found yet, so one time may explain the data even better.
Where it does as well as several, they are no patches on a cause without a name.

Nor is a pulse of one sample next to a step. Steps of a model come at samples, in nature between two of them:
the pulse makes up for the part of that one sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.traits import Course
from engine.diagnose.refits.found import Search
from engine.distributions import chi2_isf
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, log_likelihoods, quasi_ml
from engine.words import enumerated, moment

TIMES = 50  # tried at most, of those from the first to the last that was found
BESIDE = 5  # samples before and after them, as their own times are those of a grid
REFITTED = 3  # of them
ITERATIONS = 10  # of the other parameters' fit beside one time
BY_CHANCE = 0.05  # that several times explain so much more than one
NEXT = 1.5  # samples from a step to a pulse that is a part of it: the next, whatever rounding does to times


def as_one_event(found: Search, series: Series) -> tuple[Search, str]:
    """The search with its steps at one time, and a sentence on them; as it was where they have several.

    Of more than two that came at different times all but one are tried.
    """
    # of several records each has a clock; outliers are judged by another filter
    if series.begins or any(one.effect.traits.outliers for one in found.named):
        return found, ""
    known = found.final.model.parameter_names
    steps = [one.effect for one in found.named if one.effect.traits.course is Course.STEP]
    steps = [effect for effect in steps if _time(effect) in known]
    for n in range(len(steps), max(1, len(steps) - 2), -1):
        for among in combinations(steps, n):
            fit = _at_one_time(among, found.final, series)
            if fit is None:
                continue
            names = tuple(effect.name for effect in among)
            when = moment(fit.theta[_time(among[0])], series.usual_step, series.time_unit)
            return replace(found, final=fit, at_once=names), (
                f"{enumerated(list(names))} are one event as far as these data tell: that all of them came "
                f"at t = {when} explains as much as a time of its own for each."
            )
    return found, ""


def as_between_samples(found: Search, series: Series) -> tuple[Search, tuple[str, ...]]:
    """The search with pulses by which a step came between two samples as a part of it; and sentences."""
    if series.begins:
        return found, ()
    theta, step = found.final.theta.asdict(), NEXT * series.usual_step
    effects = [one.effect for one in found.named if _time(one.effect) in theta]
    steps = [effect for effect in effects if effect.traits.course is Course.STEP]
    told = []
    for pulse in effects:
        at, width = theta[_time(pulse)], theta.get(f"{pulse.size.name}_width", np.inf)
        if pulse.traits.course is not Course.PULSE or width > step:
            continue
        near = [one for one in steps if abs(theta[_time(one)] - at) < step]
        if not near:
            continue
        found = replace(found, at_once=(*(found.at_once or (near[0].name,)), pulse.name))
        told.append(
            f"{pulse.name} lasts one sample, next to {near[0].name}: both are one event, which came between "
            "two samples."
        )
    return found, tuple(told)


def _time(effect: Effect) -> str:
    return f"{effect.size.name}_time"


def _at_one_time(steps: Sequence[Effect], fit: QuasiFit, series: Series) -> QuasiFit | None:
    """The fit with one time for all of them, None where several explain more than by chance."""
    names = [_time(effect) for effect in steps]
    own = np.array([fit.theta[name] for name in names])
    t = series.t[series.samples]
    first, last = np.searchsorted(t, own.min()), np.searchsorted(t, own.max(), side="right")
    times = t[max(1, first - BESIDE) : last + BESIDE]
    few = np.linspace(0, len(times) - 1, min(len(times), TIMES)).round().astype(int)
    times = np.unique([*own, *times[few]])
    free = [name for name in fit.free if name not in names]
    try:
        rows = [fit.model.theta(fit.theta.asdict() | dict.fromkeys(names, at)) for at in times]
        values = log_likelihoods(fit.model, [series], np.array(rows))
        best = np.argsort(-np.nan_to_num(values, nan=-np.inf), kind="stable")[:REFITTED]
        fits = [quasi_ml(fit.model, series, rows[k], free, ITERATIONS) for k in best]
    except (EngineError, np.linalg.LinAlgError):
        return None
    one = max(fits, key=lambda each: each.log_likelihood)
    lost = 2.0 * (fit.log_likelihood - one.log_likelihood)
    return one if lost <= chi2_isf(BY_CHANCE, len(steps) - 1) else None
