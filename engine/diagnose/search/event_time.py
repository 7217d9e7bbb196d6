"""From when to when a step that was found may as well have come."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.traits import Course
from engine.diagnose.refits.found import Search
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.words import moment, number

WITHIN = 3.84  # of 2 x log-likelihood: the 95 % point of chi2 with one degree of freedom
ITERATIONS = 3  # of the other parameters' fit beside another time
FINE = 0.1  # of the way from the time that was found: how finely an end of the range is told


def times_as_likely(found: Search, series: Series) -> list[str]:
    """A sentence for each step that was named, and that other times explain as well as its own.

    Where nothing happens that shows it, a step may have come hours before or after, or with the next record.
    Its time is one of a grid and has no standard error.
    """
    named = [r.refits[0].effect for r in found.rounds if r.equivalent]
    in_order = bool((np.diff(series.t) > 0.0).all())
    if not in_order or any(effect.traits.outliers for effect in named):
        return []  # records at one time are no row of times; outliers are judged by another filter
    steps = [effect for effect in named if effect.traits.course is Course.STEP]
    return [text for effect in steps if (text := _said(effect, found.final, series))]


def _said(effect: Effect, fit: QuasiFit, series: Series) -> str:
    name = f"{effect.size.name}_time"
    if name not in fit.model.parameter_names:
        return ""
    t, own = series.t[series.samples], float(fit.theta[name])
    free = [one for one in fit.free if one != name]

    def as_likely(row: int) -> bool:
        theta = fit.model.theta({**fit.theta.asdict(), name: float(t[row])})
        try:
            there = quasi_ml(fit.model, series, theta, free, max_iterations=ITERATIONS)
        except (EngineError, np.linalg.LinAlgError):
            return False
        return 2.0 * (fit.log_likelihood - there.log_likelihood) < WITHIN

    row = int(np.clip(np.searchsorted(t, own), 1, len(t) - 2))
    first, last = _end(as_likely, row, 1), _end(as_likely, row, len(t) - 2)
    if last - first <= 1:
        return ""
    step, unit = series.usual_step * series.substeps, series.time_unit
    return (
        f"{effect.name} may have come at any time from {moment(float(t[first]), step, unit)} to "
        f"{moment(float(t[last]), step, unit)}: 2 x log-likelihood is at most {number(WITHIN)} lower there."
    )


def _end(as_likely: Callable[[int], bool], row: int, last: int) -> int:
    """How far towards ``last`` from ``row`` what is as likely goes: by strides twice as long, then halves."""
    side, inside, stride, outside = (1 if last > row else -1), row, 1, None
    while inside != last:
        tried = row + side * min(stride, abs(last - row))
        if not as_likely(tried):
            outside = tried
            break
        inside, stride = tried, 2 * stride
    if outside is None:
        return inside
    while abs(outside - inside) > max(1.0, FINE * abs(inside - row)):
        tried = (inside + outside) // 2
        if as_likely(tried):
            inside = tried
        else:
            outside = tried
    return inside
