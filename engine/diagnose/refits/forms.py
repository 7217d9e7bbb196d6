"""What else may be tried of a refit's effect: its manners, another beginning, its zero, one limit, no size.

Each form is taken where its score is the better one; a parameter more counts as any other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from engine.data.series import Series
from engine.diagnose.refits.refitted import HOPE, TOLERANCE, Refit, cost, weighed
from engine.diagnose.refits.starts import best_row
from engine.errors import EngineError
from engine.estimation.quasi_ml import log_likelihoods, quasi_ml
from engine.filters.neighbours import Visited
from engine.statespace.model import Array


def best_form(
    refit: Refit,
    null: float,
    series: Series,
    elsewhere: Sequence[Array] = (),
    visited: Visited | None = None,
) -> Refit:
    """The refit with what else is known, or may be estimated, of its effect."""
    begun = _with_other_beginning(_in_best_manner(refit, null, series), null, series)
    zero = _with_zero(begun, null, series, elsewhere, Visited() if visited is None else visited)
    return _with_shown_size(_on_one_side(zero, null, series), null, series)


def _in_best_manner(refit: Refit, null: float, series: Series) -> Refit:
    """The refit in whichever manner of its effect is the likeliest, at whichever probe that begins best."""
    effect, known = refit.effect, refit.fit
    if not effect.manners:
        return refit
    names = [p.name for p in effect.parameters]
    own = slice(len(known.theta) - len(names), len(known.theta))
    at = [names.index(name) for name in effect.manners]
    probed = np.array([[i not in at and name in effect.held for i, name in enumerate(names)]])
    best, first = known, np.asarray(known.theta)
    for values in product((0.0, 1.0), repeat=len(at)):
        if np.array_equal(first[own][at], values):
            continue
        starts = np.repeat(first[None], len(effect.probes), axis=0)
        probes = np.array([[np.nan, *probe] for probe in effect.probes])
        starts[:, own] = np.where(probed, probes, starts[:, own])
        starts[:, own.start + np.array(at)] = values
        try:
            here = log_likelihoods(known.model, [series], starts)
            start = starts[int(np.argmax(np.where(np.isfinite(here), here, -np.inf)))]
            found = quasi_ml(
                known.model,
                series,
                start,
                known.free,
                tolerance=TOLERANCE,
                target=best.log_likelihood,
                hope=HOPE,
            )
        except (EngineError, np.linalg.LinAlgError):
            continue
        best = max(best, found, key=lambda one: one.log_likelihood)
    return refit if best is known else weighed(effect, best, null, series)


def _with_other_beginning(refit: Refit, null: float, series: Series) -> Refit:
    """The refit with its memory at rest at first, anywhere, or of an input that was off until the record.

    Whichever explains more: many a record begins when something is switched on.
    """
    effect, known = refit.effect, refit.fit
    if effect.spread is None or known.given_up:
        return refit
    most = next(p.default for p in effect.parameters if p.name == effect.spread)
    spread = 0.0 if known.theta[effect.spread] > 0.0 else most
    others = [{effect.spread: spread}]
    if effect.before is not None and known.theta[effect.before] != 0.0:
        others.append({effect.spread: 0.0, effect.before: 0.0})
    try:
        told = known.theta.asdict()
        starts = np.array([known.model.theta({**told, **other}) for other in others])
        here = log_likelihoods(known.model, [series], starts)
        best = int(np.argmax(np.where(np.isfinite(here), here, -np.inf)))
        if not here[best] > known.log_likelihood:
            return refit
        found = quasi_ml(known.model, series, starts[best], known.free, tolerance=TOLERANCE)
    except (EngineError, np.linalg.LinAlgError):
        return refit
    return weighed(effect, found, null, series)


def _with_shown_size(refit: Refit, null: float, series: Series) -> Refit:
    """The refit with the score of the size that the readings show, where that is the better one.

    That costs a parameter less than the size of another effect: log T.
    """
    effect, known = refit.effect, refit.fit
    if effect.shown is None or known.given_up or not refit.gain > 0.0:
        return refit
    size = effect.size.name
    theta = known.model.theta({**known.theta.asdict(), size: effect.shown})
    free = [name for name in known.free if name != size]
    try:
        found = quasi_ml(known.model, series, theta, free, tolerance=TOLERANCE)
    except (EngineError, np.linalg.LinAlgError):
        return refit
    gain = 2.0 * (found.log_likelihood - null)
    score = gain - cost(effect, series) + float(np.log(series.n_measured))
    return replace(refit, score=max(score, refit.score))


def _with_zero(
    refit: Refit, null: float, series: Series, elsewhere: Sequence[Array], visited: Visited
) -> Refit:
    """The refit with the zero of its channel estimated too, where the data tell it.

    Nothing says that the zero of a unit is that of the physics, unless the model declares it: drag about
    20 m/s is not drag. One more parameter counts as any other. ``elsewhere`` are thetas (n,) with a zero from
    which the screen saw more than from the one that is held, one on either side. Its search is left where it
    will not gain what the parameter costs: most records tell of no zero, and each of them would be followed to
    the last digit.
    """
    effect, known = refit.effect, refit.fit
    if effect.zero not in effect.held:
        return refit
    if not elsewhere and (known.given_up or not refit.score > 0.0):
        return refit
    freed = effect.with_free_zero()
    for start in elsewhere or [np.asarray(known.theta)]:
        climb = partial(
            quasi_ml,
            known.model,
            series,
            free=[*known.free, effect.zero],
            tolerance=TOLERANCE,
            target=null + 0.5 * (refit.score + cost(freed, series)),
            hope=HOPE,
        )
        try:
            found = climb(start, visited=[visited.copy()])
            moved = np.asarray(found.theta)
            for name in effect.sought:  # from another zero it may have come at another row
                moved = best_row(known.model, series, moved, name, effect, visited)
            if not np.array_equal(moved, found.theta):
                again = climb(moved, visited=[visited.copy()])
                found = max(found, again, key=lambda one: one.log_likelihood)
        except (EngineError, np.linalg.LinAlgError):
            continue
        other = weighed(freed, found, null, series)
        refit = other if other.score > refit.score else refit
    return refit


def _on_one_side(refit: Refit, null: float, series: Series) -> Refit:
    """The refit of what is cut at two limits cut at one alone, unless the other gains what an effect must.

    That is log T, as of any size. A limit put where the extreme readings are fits their noise.
    """
    effect, known = refit.effect, refit.fit
    size = effect.size.name
    side, limit = f"{size}_side", f"{size}_limit"
    if side not in effect.held or known.theta[side] != 0.0 or not refit.score > 0.0:
        return refit
    told, zero = known.theta.asdict(), effect.zero
    limits = [told[limit], *([2.0 * told[zero] - told[limit]] if zero else [])]
    free = [name for name in known.free if name != zero]
    if zero and zero not in effect.held:
        effect = replace(effect, held=(*effect.held, zero))
    least = refit.score - float(np.log(series.n_measured))
    for which, at in ((1.0, max(limits)), (-1.0, min(limits))):
        start = known.model.theta({**told, side: which, limit: at})
        target = null + 0.5 * (least + cost(effect, series))
        try:
            found = quasi_ml(
                known.model, series, start, free, tolerance=TOLERANCE, target=target, hope=HOPE
            )
        except (EngineError, np.linalg.LinAlgError):
            continue
        cut = weighed(effect, found, null, series)
        if cut.score >= least and not found.given_up:
            refit, least = cut, cut.score
    return refit
