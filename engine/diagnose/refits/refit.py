"""Effects estimated together with the model's parameters."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.refits.forms import best_form
from engine.diagnose.refits.refitted import (
    HOPE,
    TOLERANCE,
    Refit,
    cost,
    free_parameters,
    weighed,
)
from engine.diagnose.refits.spikes import off_spikes
from engine.diagnose.refits.starts import (
    also_at_rest,
    best_row,
    best_start,
    by_side,
    from_elsewhere,
    places,
    probed_apart,
)
from engine.diagnose.refits.stopped import off_the_bound
from engine.diagnose.screening.noise_parameters import noise_of
from engine.diagnose.screening.screen import Score
from engine.diagnose.screening.tails import fit_tails, tails_information
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.filters.neighbours import Visited, visited_on
from engine.filters.sigma_point import moment_path
from engine.statespace.model import Array, MixedModel

Way = Callable[[], Visited]  # called where it is needed

HOPELESS = 10.0  # of the score behind the best refit, from which another one is left for later


def refit(
    fit: QuasiFit,
    series: Series,
    score: Score,
    best: float = -np.inf,
    further: Array | None = None,
    way: Way = lambda: Visited(),
) -> Refit:
    """Maximum likelihood of the extended model, started at the score's one-step estimate.

    Or at ``further`` (n,), theta with the effect, where the likelihood is larger there. And from the fit's
    other maxima: with the effect in the model another one may be the highest.
    Given up early where its score seems to stay far below ``best``, the score of another refit; see
    :func:`taken_up`. ``way`` tells where the filter of ``fit`` went, see :func:`way_of`.
    """
    effect = score.effect
    extended = effect.apply(fit.model)
    n = len(fit.theta)
    if effect.traits.outliers:
        return _refit_tails(fit, extended, effect, series)
    start = np.concatenate([fit.theta, [score.size], score.at])
    # a zero elsewhere is estimated from there, never held there: the data chose it
    elsewhere = from_elsewhere(effect, start, further, n)
    if elsewhere:
        start[-1] = effect.probes[0][-1]
        further = None if elsewhere[-1] is further else further
    null = start.copy()
    null[n : n + len(effect.amplitudes)] = 0.0
    sought = effect.sought
    free = [*fit.free, *free_parameters(effect)]
    begun = also_at_rest(effect, places(effect, start, n), n)
    starts = np.clip(begun, extended.lower, extended.upper)
    # without a size the filter of the extended model goes this way, and not far from it with one
    visited = _along(way, fit.model, extended)
    start, zero = best_start(extended, series, starts, null, n, further, visited)
    for name in sought:
        start = best_row(extended, series, start, name, effect, visited)
    target = zero + 0.5 * (best - HOPELESS + cost(effect, series))
    climb = partial(
        quasi_ml, extended, series, free=free, tolerance=TOLERANCE, visited=[visited.copy()]
    )
    found = climb(start, target=target, hope=HOPE)
    if sought and found.log_likelihood > target:
        moved = np.asarray(found.theta)
        for name in sought:
            moved = best_row(extended, series, moved, name, effect, visited)
        if not np.array_equal(moved, found.theta):
            found = max(found, climb(moved), key=lambda one: one.log_likelihood)
    others = [np.concatenate([rival, np.asarray(found.theta)[n:]]) for rival in fit.rivals]
    for other in [*others, *_with_usual_noise(fit, found, series)]:
        at_least = max(target, found.log_likelihood)
        again = climb(other, target=at_least, hope=HOPE)
        found = max(found, again, key=lambda one: one.log_likelihood)
    found = _at_next_probes(effect, found, climb, target, n)
    if found.log_likelihood > target:
        found = off_the_bound(fit, found, effect, series, climb)
    best_elsewhere = [
        best_start(extended, series, np.array(side), null, n, None, visited)[0]
        for side in by_side(effect, elsewhere)
    ]

    def of(one: QuasiFit) -> Refit:
        known = weighed(effect, one, zero, series)
        return best_form(known, zero, series, best_elsewhere, visited)

    return off_spikes(fit, of(found), lambda at, left: of(climb(at, free=left)), series)


def _with_usual_noise(fit: QuasiFit, found: QuasiFit, series: Series) -> list[Array]:
    """A further start (.,): all noise at its default, where with the effect as without it some is at a bound.

    It has gone there for want of the effect, beside other noise that has swallowed it, and may be held there by
    a maximum of its own: of a first reading that is met exactly, say.
    """
    stopped = set(fit.model.at_bounds(fit.theta, fit.free))
    stopped &= set(found.model.at_bounds(found.theta, fit.free))
    if not stopped:
        return []
    noise = [name for name, yes in zip(fit.free, noise_of(fit, series), strict=True) if yes]
    if not stopped & set(noise):
        return []
    defaults = found.model.theta().asdict()
    there = found.theta.asdict() | {name: defaults[name] for name in noise}
    return [np.asarray(found.model.theta(there))]


def way_of(fit: QuasiFit, series: Series) -> Visited:
    """The points of a fitted model's filter, from which those of its extensions are not far."""
    try:
        path = moment_path(fit.model, np.asarray(fit.theta), series)
    except EngineError:
        return Visited()
    return visited_on(path, fit.model.na)


def _along(way: Way, model: MixedModel, extended: MixedModel) -> Visited:
    """Of the way of ``model`` what holds for an extension: none where that has nonlinear states of its own."""
    if not model.na or extended.nonlinear != model.nonlinear:
        return Visited()
    return way().copy()


def taken_up(refit: Refit, series: Series) -> Refit:
    """A refit that was given up, followed to its maximum."""
    known = refit.fit
    null = known.log_likelihood - 0.5 * refit.gain
    found = quasi_ml(known.model, series, known.theta, known.free, tolerance=TOLERANCE)
    return best_form(weighed(refit.effect, found, null, series), null, series)


def _at_next_probes(
    effect: Effect, found: QuasiFit, climb: Callable[..., QuasiFit], target: float, n: int
) -> QuasiFit:
    """The fit moved from probe to probe where these differ in what is held, as long as the likelihood rises.

    Beside a large delay of another length all parameters are bent, and so was the choice of it. One that comes
    late as a whole is later by as much: a share of it that comes later still would lead back.
    """
    apart, values = probed_apart(effect)
    at = n + 1 + np.array(apart, dtype=int)
    if len(values) == 1 or tuple(np.asarray(found.theta)[at].tolist()) not in values:
        return found
    first = found
    for step in (1, -1):
        if found is not first:  # from where it came
            break
        while True:
            there = np.array(found.theta)
            k = values.index(tuple(there[at].tolist())) + step
            if not 0 <= k < len(values):
                break
            if effect.traits.whole:
                there[n] += values[k][0] - values[k - step][0]
            there[at] = values[k]
            try:
                moved = climb(there, target=max(target, found.log_likelihood), hope=HOPE)
            except (EngineError, np.linalg.LinAlgError):
                break
            if not moved.log_likelihood > found.log_likelihood:
                break
            found = moved
    return found


def _refit_tails(fit: QuasiFit, extended: MixedModel, effect: Effect, series: Series) -> Refit:
    """By a filter that knows outliers, over a grid."""
    found = with_tails(fit, extended, effect, series)
    gain = 2.0 * (found.log_likelihood - fit.log_likelihood)
    return Refit(effect, found, gain, gain - cost(effect, series))


def with_tails(fit: QuasiFit, extended: MixedModel, effect: Effect, series: Series) -> QuasiFit:
    """The fit with an effect of outliers, all of its parameters estimated by a filter that knows them."""
    gain, theta = fit_tails(fit, effect, series)
    information = tails_information(fit, effect, series, theta)
    own = [p.name for p in effect.parameters]
    known = extended.theta(np.clip(theta, extended.lower, extended.upper))
    value = fit.log_likelihood + 0.5 * gain
    return QuasiFit(extended, known, value, (*fit.free, *own), information, 1, True)
