"""Effects estimated together with the model's parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.traits import Course
from engine.diagnose.screening.noise_parameters import noise_of
from engine.diagnose.screening.screen import Score
from engine.diagnose.screening.tails import fit_tails, tails_information
from engine.diagnose.screening.time_scan import grid, reached
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, log_likelihoods, quasi_ml
from engine.filters.neighbours import Visited, visited_on
from engine.filters.sigma_point import moment_path
from engine.statespace.model import Array, MixedModel

TOLERANCE = 0.02  # of a log-likelihood: refits are compared, the best one is then finished
HOPE = 10.0  # a large effect is far away, where a search gains many times what it expects
Way = Callable[[], Visited]  # called where it is needed

UNLIKELIER = 4.0  # of the score, that an odd effect is behind beforehand: one to seven
LEAST_ERRORS = 2.0  # standard errors that a size must be away from zero
HOPELESS = 10.0  # of the score behind the best refit, from which another one is left for later


@dataclass(frozen=True, eq=False)
class Refit:
    """An effect estimated together with the model's parameters.

    ``gain`` is 2 (log-likelihood gained), ``score`` that less its costs.
    """

    effect: Effect
    fit: QuasiFit
    gain: float
    score: float

    @property
    def size(self) -> float:
        """The estimated size."""
        return float(self.fit.theta[self.effect.size.name])

    @property
    def standard_error(self) -> float:
        """Its standard error."""
        return float(self.fit.standard_errors[self.fit.free.index(self.effect.size.name)])

    @property
    def is_sure(self) -> bool:
        """Whether the size may not as well be zero."""
        return abs(self.size) >= LEAST_ERRORS * self.standard_error


def cost(effect: Effect, series: Series) -> float:
    """What an effect's further parameters must gain before they count: log T each (Schwarz 1978).

    One that is odd at its channel must be likelier by as much as it was less likely before the data.
    """
    odds = UNLIKELIER if effect.traits.odd else 0.0
    return further_parameters(effect) * float(np.log(series.n_measured)) + odds


def further_parameters(effect: Effect) -> int:
    """How many parameters are estimated beside the size."""
    return len(effect.parameters) - 1 - len(effect.held)


def free_parameters(effect: Effect) -> list[str]:
    """The effect's own parameters that are estimated by slopes."""
    fixed = {*effect.sought, *effect.held}
    return [p.name for p in effect.parameters if p.name not in fixed]


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
    elsewhere = _from_elsewhere(effect, start, further, n)
    if elsewhere:
        start[-1] = effect.probes[0][-1]
        further = None if elsewhere[-1] is further else further
    null = start.copy()
    null[n : n + len(effect.amplitudes)] = 0.0
    sought = effect.sought
    free = [*fit.free, *free_parameters(effect)]
    places = _also_at_rest(effect, _places(effect, start, n), n)
    starts = np.clip(places, extended.lower, extended.upper)
    # without a size the filter of the extended model goes this way, and not far from it with one
    visited = _along(way, fit.model, extended)
    start, zero = _best_start(extended, series, starts, null, n, further, visited)
    for name in sought:
        start = _best_row(extended, series, start, name, effect, visited)
    target = zero + 0.5 * (best - HOPELESS + cost(effect, series))
    climb = partial(
        quasi_ml, extended, series, free=free, tolerance=TOLERANCE, visited=[visited.copy()]
    )
    found = climb(start, target=target, hope=HOPE)
    if sought and found.log_likelihood > target:
        moved = np.asarray(found.theta)
        for name in sought:
            moved = _best_row(extended, series, moved, name, effect, visited)
        if not np.array_equal(moved, found.theta):
            found = max(found, climb(moved), key=lambda one: one.log_likelihood)
    others = [np.concatenate([rival, np.asarray(found.theta)[n:]]) for rival in fit.rivals]
    for other in [*others, *_with_usual_noise(fit, found, series)]:
        at_least = max(target, found.log_likelihood)
        again = climb(other, target=at_least, hope=HOPE)
        found = max(found, again, key=lambda one: one.log_likelihood)
    found = _at_next_probes(effect, found, climb, target, n)
    best_elsewhere = [
        _best_start(extended, series, np.array(places), null, n, None, visited)[0]
        for places in _by_side(effect, elsewhere)
    ]
    weighed = _weighed(effect, found, zero, series)
    return _complete(weighed, zero, series, best_elsewhere, visited)


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
    return _complete(_weighed(refit.effect, found, null, series), null, series)


def _weighed(effect: Effect, fit: QuasiFit, null: float, series: Series) -> Refit:
    """A refit with its gain over the log-likelihood ``null`` without the effect."""
    gain = 2.0 * (fit.log_likelihood - null)
    return Refit(effect, fit, gain, gain - cost(effect, series))


def _complete(
    refit: Refit,
    null: float,
    series: Series,
    elsewhere: Sequence[Array] = (),
    visited: Visited | None = None,
) -> Refit:
    """The refit with what else is known, or may be estimated, of its effect."""
    begun = _with_other_beginning(refit, null, series)
    zero = _with_zero(begun, null, series, elsewhere, Visited() if visited is None else visited)
    return _with_shown_size(_on_one_side(zero, null, series), null, series)


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
    return _weighed(effect, found, null, series)


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
                moved = _best_row(known.model, series, moved, name, effect, visited)
            if not np.array_equal(moved, found.theta):
                again = climb(moved, visited=[visited.copy()])
                found = max(found, again, key=lambda one: one.log_likelihood)
        except (EngineError, np.linalg.LinAlgError):
            continue
        weighed = _weighed(freed, found, null, series)
        refit = weighed if weighed.score > refit.score else refit
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
        weighed = _weighed(effect, found, null, series)
        if weighed.score >= least and not found.given_up:
            refit, least = weighed, weighed.score
    return refit


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


def _at_next_probes(
    effect: Effect, found: QuasiFit, climb: Callable[..., QuasiFit], target: float, n: int
) -> QuasiFit:
    """The fit moved from probe to probe where these differ in what is held, as long as the likelihood rises.

    Beside a large delay of another length all parameters are bent, and so was the choice of it. One that comes
    late as a whole is later by as much: a share of it that comes later still would lead back.
    """
    apart, values = _probed_apart(effect)
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


def _probed_apart(effect: Effect) -> tuple[list[int], list[tuple[float, ...]]]:
    """Which parameters after the size are held at another value by each probe, and these values in turn."""
    names = {*effect.held} - {effect.zero}
    held = [i for i, p in enumerate(effect.parameters[1:]) if p.name in names]
    apart = [i for i in held if len({probe[i] for probe in effect.probes}) > 1]
    return apart, sorted({tuple(probe[i] for i in apart) for probe in effect.probes})


def _places(effect: Effect, start: Array, n: int) -> Array:
    """Starts (k, .): at every probe where these differ in what is held, as a delay's samples, else at one.

    No slope leads from one to the next, and a large effect bends the scores by which they were compared.
    A zero is no such place: elsewhere than at its start it is estimated.
    """
    if len(_probed_apart(effect)[1]) == 1:
        return start[None]
    starts = np.repeat(start[None], len(effect.probes), axis=0)
    starts[:, n + 1 :] = effect.probes
    return starts


def _also_at_rest(effect: Effect, starts: Array, n: int) -> Array:
    """The starts, and each with the effect's memory at rest where it may begin either way."""
    if effect.spread is None:
        return starts
    at_rest = starts.copy()
    at_rest[:, n + [p.name for p in effect.parameters].index(effect.spread)] = 0.0
    return np.vstack([starts, at_rest])


def _from_elsewhere(effect: Effect, start: Array, further: Array | None, n: int) -> list[Array]:
    """Starts (.,) with the zero where it is not held; none where the screen saw the effect best from there.

    From one side of the record to the other a zero goes through infinity only, so both are tried, with the push
    that the screen saw in the middle of the record.
    """
    out = []
    if effect.from_elsewhere(start[n + 1 :]):
        middle, seen = effect.probes[0][-1], start[-1]
        for probe in effect.probes[1:]:
            if probe[-1] == middle:  # of an effect that has other things to probe, too
                continue
            one = start.copy()
            one[n], one[-1] = start[n] * (middle - seen) / (middle - probe[-1]), probe[-1]
            out.append(one)
    if further is not None and effect.from_elsewhere(further[n + 1 :]):
        out.append(further)
    return out


def _by_side(effect: Effect, starts: Sequence[Array]) -> list[list[Array]]:
    """Starts (.,) with the zero below the middle of the record, and those above it, as far as there are some.

    No slope leads from one side to the other.
    """
    middle = effect.probes[0][-1] if starts else 0.0
    sides = ([one for one in starts if (one[-1] > middle) == above] for above in (False, True))
    return [side for side in sides if side]


def _best_start(
    extended: MixedModel,
    series: Series,
    places: Array,
    null: Array,
    n: int,
    further: Array | None,
    visited: Visited,
) -> tuple[Array, float]:
    """The best of a few sizes around the one-step estimate, which may overshoot; log-likelihood at null."""
    sizes = np.array([1.0, 0.5, 0.25, 0.1, 2.0, 0.01])
    starts = np.repeat(places, len(sizes), axis=0)
    starts[:, n] *= np.tile(sizes, len(places))
    if further is not None:
        starts = np.vstack([starts, further])
    starts = np.clip(starts, extended.lower, extended.upper)
    thetas = np.concatenate([null[None], starts])
    values = log_likelihoods(extended, [series], thetas, [visited])
    return np.asarray(starts[int(np.argmax(values[1:]))]), float(values[0])


def _best_row(
    extended: MixedModel,
    series: Series,
    theta: Array,
    name: str,
    effect: Effect,
    visited: Visited,
) -> Array:
    """Theta with the effect's time moved to the row near it where the likelihood is largest."""
    k = extended.index(name)
    here = int(np.argmin(np.abs(series.t - theta[k])))
    reach = 2
    if effect.traits.course is Course.STEP:  # its grid leaves rows out
        reach = int(np.ceil(len(series) / max(len(grid(effect, series)), 1)))
    rows = np.arange(len(series))[reached(effect, extended)]
    rows = rows[np.abs(rows - here) <= reach]
    thetas = np.repeat(theta[None], len(rows) + 1, axis=0)
    thetas[1:, k] = series.t[rows]
    values = log_likelihoods(extended, [series], thetas, [visited])
    return np.asarray(thetas[int(np.argmax(values))])


def finished(
    fit: QuasiFit, series: Series, told: Callable[[int], object] | None = None
) -> QuasiFit:
    """A refit to the usual tolerance; as it is where its likelihood is on an edge."""
    try:
        return quasi_ml(fit.model, series, fit.theta, fit.free, callback=told)
    except EngineError:
        return fit


def held_out_terms(fit: QuasiFit, series: Series) -> Array:
    """One-step predictive log-densities (T,) of a series under a fitted model."""
    return fit.log_terms(series)
