"""Where the search of a refit may begin: sizes, probes, a zero elsewhere, the row of an event."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.traits import Course
from engine.diagnose.screening.time_scan import grid, reached
from engine.estimation.quasi_ml import log_likelihoods
from engine.filters.neighbours import Visited
from engine.statespace.model import Array, MixedModel


def places(effect: Effect, start: Array, n: int) -> Array:
    """Starts (k, .): at every probe where these differ in what is held, as a delay's samples, else at one.

    No slope leads from one to the next, and a large effect bends the scores by which they were compared.
    A zero is no such place: elsewhere than at its start it is estimated.
    """
    if len(probed_apart(effect)[1]) == 1:
        return start[None]
    starts = np.repeat(start[None], len(effect.probes), axis=0)
    starts[:, n + 1 :] = effect.probes
    return starts


def probed_apart(effect: Effect) -> tuple[list[int], list[tuple[float, ...]]]:
    """Which parameters after the size are held at another value by each probe, and these values in turn."""
    names = {*effect.held} - {effect.zero}
    held = [i for i, p in enumerate(effect.parameters[1:]) if p.name in names]
    apart = [i for i in held if len({probe[i] for probe in effect.probes}) > 1]
    return apart, sorted({tuple(probe[i] for i in apart) for probe in effect.probes})


def also_at_rest(effect: Effect, starts: Array, n: int) -> Array:
    """The starts, and each with the effect's memory at rest where it may begin either way."""
    if effect.spread is None:
        return starts
    at_rest = starts.copy()
    at_rest[:, n + [p.name for p in effect.parameters].index(effect.spread)] = 0.0
    return np.vstack([starts, at_rest])


def from_elsewhere(effect: Effect, start: Array, further: Array | None, n: int) -> list[Array]:
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


def by_side(effect: Effect, starts: Sequence[Array]) -> list[list[Array]]:
    """Starts (.,) with the zero below the middle of the record, and those above it, as far as there are some.

    No slope leads from one side to the other.
    """
    middle = effect.probes[0][-1] if starts else 0.0
    sides = ([one for one in starts if (one[-1] > middle) == above] for above in (False, True))
    return [side for side in sides if side]


def best_start(
    extended: MixedModel,
    series: Series,
    places: Array,
    null: Array,
    n: int,
    further: Array | None,
    visited: Visited,
) -> tuple[Array, float]:
    """The best of a few sizes around the one-step estimate, which may overshoot; log-likelihood at null.

    And of a share, what it is as a rule: all of it. A sensor that clips shows next to nothing beyond its limit,
    where the filter has followed it, and so the one-step estimate is a small part.
    """
    sizes = np.array([1.0, 0.5, 0.25, 0.1, 2.0, 0.01])
    starts = np.repeat(places, len(sizes), axis=0)
    starts[:, n] *= np.tile(sizes, len(places))
    if extended.lower[n] == 0.0 and np.isfinite(extended.upper[n]):
        whole = places.copy()
        whole[:, n] = extended.upper[n]
        starts = np.vstack([starts, whole])
    if further is not None:
        starts = np.vstack([starts, further])
    starts = np.clip(starts, extended.lower, extended.upper)
    thetas = np.concatenate([null[None], starts])
    values = log_likelihoods(extended, [series], thetas, [visited])
    return np.asarray(starts[int(np.argmax(values[1:]))]), float(values[0])


def best_row(
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
