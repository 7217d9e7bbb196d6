"""Tests of what comes with time, by footprints: one recursion for a whole family of times or frequencies."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from engine.data.joined import anew, apart, starts_of
from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.kinds.bend import bend
from engine.diagnose.effects.of_series import later_of
from engine.diagnose.effects.traits import Course
from engine.diagnose.screening.disturbances import best_frequencies, pulse_scores
from engine.diagnose.screening.episodes import Window, near, promising, strides
from engine.diagnose.screening.score_columns import Column, Projection, whitened
from engine.diagnose.screening.screen import Test, make_test
from engine.errors import ModelError
from engine.estimation.expectation import parameter_scale
from engine.failing import where_it_fails
from engine.filters.sigma_point import MomentPath
from engine.kernels.sensitivities import footprints
from engine.statespace.model import Array, MixedModel
from engine.statespace.points import Points

GRID = 400  # times tried at most
STEP_GRID = 1000  # for a step, as one sample off it leaves another footprint
CHUNK = 50  # columns held in memory at once; even, as a harmonic has two
FINER = 2.0  # frequencies per cycle over the whole record
MOST_IRREGULAR = 4000  # of them where steps are not equal
PEAKS = 20  # of them tested exactly
# what a unit of an effect adds to x_{t+1} and to y_t, see :func:`_driver`
Driver: TypeAlias = tuple[Array, Array]
Chunk: TypeAlias = list[tuple[tuple[float, ...], Column]]
EDGE = 0.04  # share of the record at each end in which no step can be told from the start


def family_test(
    effect: Effect,
    model: MixedModel,
    theta: Array,
    series: Series,
    path: MomentPath,
    projection: Projection,
) -> Test | None:
    """The test of a timed effect over its whole grid; None where it leaves no footprint."""
    root, _, _, z = whitened(path, series)
    degrees = 2 if effect.traits.course is Course.HARMONIC else 1

    def shown(driver: Driver, gate: Array) -> tuple[Array, Array]:
        """What the driver leaves in the whitened predictions, for factors (T, n) in time."""
        way = path.F, path.H, path.K, root, z
        found: tuple[Array, Array] = footprints(*way, *driver, np.ascontiguousarray(gate))
        return found

    def chunks(driver: Driver, at: Sequence[tuple[float, ...]], gate: Array) -> Iterator[Chunk]:
        for start in range(0, gate.shape[1], CHUNK):
            added, s = shown(driver, gate[:, start : start + CHUNK])
            v = added.reshape(len(added), -1)  # of means alone
            yield [(at[(start + k) // degrees], Column(s[k], v[k])) for k in range(len(v))]

    def information(driver: Driver, gate: Array) -> Array:
        return np.asarray((shown(driver, gate)[0] ** 2).sum(axis=(1, 2)))

    if effect.traits.course is Course.EPISODE:
        driver = _driver(effect, model, theta, series, path)

        def tested(at: Sequence[tuple[float, ...]], gate: Array) -> Test | None:
            return make_test(effect, chunks(driver, at, gate), projection, degrees)

        return _episode_test(
            series, pulse_scores(path, series, *driver), partial(information, driver), tested
        )
    every, tries = list[Iterator[Chunk]](), 1
    for probe in effect.probes if effect.traits.of_gain else effect.probes[:1]:
        one = replace(effect, probes=(probe,))
        driver = _driver(one, model, theta, series, path)
        at, gate, tries = _gates(one, model, series, path, *driver)
        every.append(chunks(driver, at, gate))
    test = make_test(effect, chain.from_iterable(every), projection, degrees)
    return test if test is None or tries == 1 else test.best_of(tries)


def _episode_test(
    series: Series,
    of_rows: tuple[Array, Array],
    information_of: Callable[[Array], Array],
    tested: Callable[[Sequence[tuple[float, ...]], Array], Test | None],
) -> Test | None:
    """The test of what begins and is over again: of windows that promise most, and of more near the best."""
    times, at_time = by_time(series)
    scores, information = (_summed(x, at_time) for x in of_rows)
    begins = np.searchsorted(times, later_of(apart(series))).tolist()
    n = len(times)

    def gates(windows: Sequence[Window]) -> Array:
        first, end = np.array(windows).T
        inside = (at_time[:, None] >= first) & (at_time[:, None] < end)
        return np.asarray(inside, dtype=float)

    def known(windows: Sequence[Window]) -> Array:
        return information_of(gates(windows))

    def test_of(windows: Sequence[Window]) -> Test | None:
        at = [(float(times[begin]), float(times[end])) for begin, end in windows]
        return tested(at, gates(windows)) if windows else None

    def best_of(windows: Sequence[Window], test: Test) -> Window:
        return windows[int(np.argmax(test.statistics(test.s.sum(axis=1))))]

    windows, tries = promising(scores, information, begins, known)
    test = test_of(windows)
    if test is None:
        return None
    best = best_of(windows, test)
    for stride in strides(best):
        windows = [w for w in near(best, n, stride) if not any(w[0] < b < w[1] for b in begins)]
        test = test_of(windows)
        if test is None:
            return None
        best = best_of(windows, test)
    return test.best_of(max(1, int(tries)))


def by_time(series: Series) -> tuple[Array, NDArray[np.intp]]:
    """The times of samples in order, each once, and which of them each row (T,) is at or last after.

    What comes at a time comes in all records whose clocks hold it.
    """
    times = np.unique(series.t[series.samples])
    return times, np.searchsorted(times, series.t, side="right") - 1


def _summed(each: Array, at_time: NDArray[np.intp]) -> Array:
    """What rows (T,) have, summed at each time."""
    return np.asarray(np.bincount(at_time, each), dtype=float)


def grid(effect: Effect, series: Series) -> Array:
    """The times in seconds, or frequencies in hertz, at which a timed effect is tried."""
    t = series.t[series.samples]
    T = len(t)
    if effect.traits.course is Course.HARMONIC:
        length, step = float(np.ptp(t)), float(np.median(np.diff(t)))
        first, last = 1.5 / length, 0.48 / step
        wanted = (last - first) * length * FINER
        if series.dt is None or series.begins:  # where long gaps make the record long, not fine
            wanted = min(wanted, FINER * T, MOST_IRREGULAR)
        return np.asarray(np.linspace(first, last, max(2, int(wanted))))
    first, last = int(EDGE * T) + 2, T - int(EDGE * T) - 3
    adds = effect.traits.course is Course.STEP and not effect.traits.alters
    most = STEP_GRID if adds else GRID
    n = max(2, min(most, last - first + 1))
    rows = np.unique(np.linspace(first, max(last, first + 1), n).astype(int))
    return np.unique(t[rows])


def reached(effect: Effect, model: MixedModel) -> slice:
    """The rows at which what comes at a time may: of a reading all of them.

    What acts on the state from the last row on shows nowhere, and from the first on looks like a first state.
    """
    return slice(None) if effect.channel in model.outputs else slice(1, -1)


def _gates(
    effect: Effect, model: MixedModel, series: Series, path: MomentPath, b: Array, e: Array
) -> tuple[list[tuple[float, ...]], Array, int]:
    """Values of the effect's other parameters, the factors (T, n) in time, places they were chosen from."""
    t = series.t[:, None]
    if effect.traits.course is Course.DRIFT:
        middle, per = effect.probes[0]
        return [(middle, per)], (anew(t, starts_of(apart(series))) - middle) / per, 1
    if effect.traits.course is Course.BEND:
        middle, per = effect.probes[0][1:]
        run = (anew(t, starts_of(apart(series))) - middle) / per
        return list(effect.probes), bend(run, np.array([k for k, *_ in effect.probes])), 1
    if effect.traits.course is Course.PULSE:
        times, at_time = by_time(series)
        scores, information = (
            _summed(x, at_time)  # a pulse lasts a sample
            for x in pulse_scores(path, series, b, e)
        )
        explained = np.divide(scores**2, information, where=information > 0.0, out=0.0 * scores)
        within = np.arange(len(explained))[reached(effect, model)]
        place = int(within[int(np.argmax(explained[within]))])
        gate = (at_time == place).astype(float)[:, None]
        return [(float(times[place]), *effect.probes[0][1:])], gate, series.n_measured
    points = grid(effect, series)
    if effect.traits.course is Course.HARMONIC:
        tries = len(points)
        points = points[best_frequencies(path, series, b, e, points, PEAKS)]
        origin = effect.probes[0][-1]
        angle = 2.0 * np.pi * points * (t - origin)
        both = np.stack([np.cos(angle), np.sin(angle)], axis=2).reshape(len(series), -1)
        return [(0.0, float(f), origin) for f in points], both, tries
    gate = (t >= points).astype(float)
    ends = any(p.name.endswith("_stays") for p in effect.parameters)
    zero = effect.probes[0][1 + ends :]
    if not ends:
        return [(float(tau), *zero) for tau in points], gate, 1
    record = np.searchsorted(series.begins, np.arange(len(series)), side="right")
    order = np.argsort(series.t, kind="stable")
    own = record[order[np.searchsorted(series.t[order], points)]]
    places: list[tuple[float, ...]] = [
        (float(tau), stays, *zero) for stays in (1.0, 0.0) for tau in points
    ]
    return places, np.hstack([gate, gate * (record[:, None] == own)]), 1


def _driver(
    effect: Effect, model: MixedModel, theta: Array, series: Series, path: MomentPath
) -> tuple[Array, Array]:
    """What a unit of the effect adds to x_{t+1} and to y_t, before its gate."""
    T = len(series)
    b, e = np.zeros((T - 1, model.nx)), np.zeros((T, model.ny))
    states = [*model.nonlinear, *model.linear]
    if effect.traits.of_parameter:
        return _sensitivity(model, theta, model.index(effect.channel), series, path)
    if effect.traits.of_gain:  # as if it had come before the record
        extended, before = effect.apply(model), [float(series.t.min()), *effect.probes[0][1:]]
        whole = np.array([*theta, 0.0, *before])
        return _sensitivity(extended, whole, extended.index(effect.size.name), series, path)
    if effect.channel in model.outputs:
        e[:, list(model.outputs).index(effect.channel)] = 1.0
    elif model.continuous:  # before the step
        b = path.F[:, :, states.index(effect.channel)] * series.steps[:, None]
    else:
        b[:, states.index(effect.channel)] = series.steps
    b[np.array(series.begins, np.intp) - 1] = 0.0
    return b, e


@np.errstate(all="ignore")  # beside theta
def _sensitivity(
    model: MixedModel, theta: Array, k: int, series: Series, path: MomentPath
) -> tuple[Array, Array]:
    """d x_{t+1} / d theta_k and d y_t / d theta_k along the filter's means.

    Zero for parameters of the noise, whose course in time is what ``variance:...->time`` tests.
    """
    step = 1e-4 * parameter_scale(model, theta, k)
    na = model.na
    predicted = Points(model, series, path.predicted[:, None, :na])
    filtered = Points(model, series, path.filtered[:, None, :na])

    def means(at: Array) -> tuple[Array, Array]:
        record = model.record(at)
        x_next = _mean(filtered.transition(record), path.filtered[:-1, na:])
        return x_next, _mean(predicted.observation(record), path.predicted[:, na:])

    ends, nowhere = [], np.full(1, np.nan)
    for sign in (-1.0, 1.0):
        moved = np.array(theta)
        moved[k] = np.clip(theta[k] + sign * step, model.lower[k], model.upper[k])
        found = where_it_fails((nowhere, nowhere))(means)(moved)
        if not all(np.isfinite(one).all() for one in found):
            moved, found = theta, means(theta)  # on this side the model cannot be had
        ends.append((*found, moved[k]))
    distance = ends[1][2] - ends[0][2]
    if not distance:
        raise ModelError(
            f"model '{model.name}' cannot be had on either side of theta", numeric=True
        )
    return (ends[1][0] - ends[0][0]) / distance, (ends[1][1] - ends[0][1]) / distance


def _mean(step: tuple[Array, Array, Array], z: Array) -> Array:
    """f + A z at one point of each time."""
    f, A, _ = step
    return np.asarray(
        f[:, 0] + np.einsum("tij,tj->ti", np.broadcast_to(A[:, 0], (len(z), *A.shape[2:])), z)
    )


def is_timed(effect: Effect) -> bool:
    """Whether the effect is tested by footprints over time."""
    return effect.traits.course is not None
