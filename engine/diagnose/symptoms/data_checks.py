"""What can be said of a series before any model is fitted: clipped, quantised, dead, short, spiked.

Everything here is a note in words. Nothing is refused: what a note means for the verdict is for the
reader and for the tests themselves, which know of missing values and of information that is not there.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.diagnose.effects.quantization import VISIBLE, lattice_step, sample_noise
from engine.statespace.clock import about_clock
from engine.statespace.model import Array, MixedModel
from engine.words import enumerated, number, percent, with_unit

SHORT_SAMPLES = 100  # samples; and ten per parameter
OUTLIER_DEVIATIONS = 6.0  # robust standard deviations
FLICKERS = 0.1  # share of short stretches from which a signal ends at zero by a cut
ANSWER_SAMPLES = 5  # samples after a step of an input in which an answer to it may peak
COMMON = 20  # readings of two outputs; that fewer are the same may be chance
MAD = 1.4826  # standard deviation of a Gaussian over its median absolute deviation


def check_data(model: MixedModel, series: Series, beside: int = 0) -> tuple[str, ...]:
    """Notes on a series as data for a model, in words with units; empty where nothing is odd.

    ``beside`` is the number of samples of other records that are looked at with it.
    """
    notes = [*_length(model, len(series) + beside), *_times(series)]
    if told := about_clock(model, [series]):
        notes.append(told)
    for column, (name, unit) in enumerate(model.outputs.items()):
        y = series.y[:, column]
        seen = ~np.isnan(y)
        if seen.sum() < 2:
            notes.append(
                f"Output {name} has {int(seen.sum())} readings: it carries no information."
            )
            continue
        notes += _gaps(name, seen, series)
        values = y[seen]
        if values.min() == values.max():
            notes.append(
                f"Output {name} reads {with_unit(float(values[0]), unit)} throughout: the channel is dead."
            )
            continue
        notes += [
            *_held(name, unit, y, series.u),
            *_lattice(name, unit, values),
            *_outliers(name, unit, y, series),
        ]
    notes += _identical(model, series)
    for column, (name, unit) in enumerate(model.inputs.items()):
        u = series.u[:, column]
        if u.min() == u.max():
            notes.append(
                f"Input {name} is {with_unit(float(u[0]), unit)} throughout: what it drives is not excited."
            )
    return tuple(notes)


def faults_of(model: MixedModel, series: Series) -> tuple[str, ...]:
    """Those notes that come before any cause in the model: of readings that are cut, stuck or given twice."""
    notes = []
    for column, (name, unit) in enumerate(model.outputs.items()):
        y = series.y[:, column]
        seen = y[~np.isnan(y)]
        if len(seen) > 1 and seen.min() < seen.max():
            notes += _held(name, unit, y, series.u)
    return (*notes, *_identical(model, series))


def _identical(model: MixedModel, series: Series) -> list[str]:
    """Outputs whose readings are the same wherever both are there: one channel, given twice."""
    notes = []
    for (i, one), (j, other) in combinations(enumerate(model.outputs), 2):
        both = series.y[series.observed[:, [i, j]].all(axis=1)][:, [i, j]]
        if len(both) >= COMMON and np.ptp(both) > 0.0 and np.array_equal(both[:, 0], both[:, 1]):
            notes.append(
                f"Outputs {one} and {other} read exactly the same: one channel given twice? Then their noise "
                "is not that of two sensors, and no parameter can be trusted."
            )
    return notes


def _length(model: MixedModel, T: int) -> list[str]:
    n = len(model.parameters)
    if max(SHORT_SAMPLES, 10 * n) <= T:
        return []
    return [
        f"Only {T} samples for {n} parameters: small effects cannot be seen, and p-values that hold "
        "for long series are approximate."
    ]


def _times(series: Series) -> list[str]:
    if series.dt is not None:
        return []
    steps, middle = series.steps, float(np.median(series.steps))
    longest = int(np.argmax(steps))
    shortest, most = number(float(steps.min())), number(float(steps.max()))
    text = f"Sampling is irregular: steps of {shortest} to {most} {series.time_unit}"
    if steps[longest] > 5.0 * middle:
        text += f", the longest after t = {number(float(series.t[longest]), 6)} {series.time_unit}"
    return [f"{text}; spectra are not shown."]


def _gaps(name: str, seen: NDArray[np.bool_], series: Series) -> list[str]:
    missing = 1.0 - seen.mean()
    if missing == 0.0:
        return []
    start, length = _longest(~seen)
    span, clock = number(length * float(np.median(series.steps))), series.time_unit
    return [
        f"Output {name}: {percent(missing)} of the readings are missing, the longest gap is {length} "
        f"samples ({span} {clock}) from t = {number(float(series.t[start]), 6)} {clock}."
    ]


def _held(name: str, unit: str, y: Array, u: Array) -> list[str]:
    """Readings that stay the same: cut at an extreme while they moved, or stuck.

    Readings that rest while all inputs rest are neither.
    """
    cut = [text for sign in (1.0, -1.0) for text in _cut(sign, unit, y)]
    clipped = [f"Output {name} looks clipped: {enumerated(cut)}."] if cut else []
    same = np.concatenate([[False], np.diff(y) == 0.0])
    start, length = _longest(same)
    if length + 1 < max(20, 0.05 * len(y)) or (cut and y[start] in (np.nanmin(y), np.nanmax(y))):
        return clipped
    if u.shape[1] and not np.ptp(u[start - 1 : start + int(0.9 * length)], axis=0).any():
        return clipped
    resting = y[start] == 0.0 and y[start] in (np.nanmin(y), np.nanmax(y))
    what = "nothing to measure there, or a stuck reading?" if resting else "a stuck reading?"
    return [
        *clipped,
        f"Output {name} stays at exactly {with_unit(float(y[start]), unit)} for {length + 1} samples from "
        f"row {start - 1}: {what}",
    ]


def _cut(sign: float, unit: str, y: Array) -> list[str]:
    """The largest level (sign 1) or the smallest (-1), but for single outliers, if it cuts a moving signal.

    It is then far more frequent than the next level, is held, and the signal was on the move when it came
    there and when it left. One that steps there, or settles there, rests by itself; so does one that ends at
    exactly zero (dark, empty, switched off), unless it also flickers there as a noisy one does.
    """
    seen = y[np.isfinite(y)]
    levels, counts = np.unique(sign * seen, return_counts=True)
    beyond = 0
    for k in range(len(levels) - 1, 1, -1):
        often = int(counts[k])
        if often >= max(5, 0.01 * len(seen)) and often >= 3 * counts[k - 1]:
            break
        beyond += often
        if beyond > 0.01 * len(seen):
            return []
    else:
        return []
    level = float(levels[k])
    starts, lengths = _stretches(sign * y == level)
    if lengths.max() < 3:
        return []
    arrives: list[bool] = []
    leaves: list[bool] = []
    step, changes = lattice_step(seen), np.abs(np.diff(seen))
    usual = float(np.median(changes[changes > 0.0]))
    for start, length in zip(starts, lengths, strict=True):
        before, after = sign * y[max(start - 3, 0) : start][::-1], sign * y[start + length :][:3]
        for edge, moving in ((before, arrives), (after, leaves)):
            if length >= 3 and len(edge) == 3 and np.isfinite(edge).all():
                moving.append(_on_the_move(level - edge, usual, step))
    if not (arrives and leaves) or min(np.mean(arrives), np.mean(leaves)) < 0.5:
        return []
    if level == 0.0 and np.mean(lengths < 3) < FLICKERS:
        return []
    return [
        f"{'largest' if sign > 0 else 'smallest'} value {with_unit(sign * level, unit)} in {often} samples "
        f"({percent(often / len(seen))}), up to {int(lengths.max())} in a row"
    ]


def _on_the_move(below: Array, usual: float, step: float | None) -> bool:
    """Whether a signal is cut: ``below`` (3,) is how far it is from the level one, two, three samples away.

    It is at rest in none of them but at the level itself, comes from as near as its last or its ``usual``
    changes let expect, and from more than two steps of its lattice, if it lies on one.
    """
    moves = np.abs(np.diff(below))
    far = step is None or float(below.max()) > 2.5 * step
    moving = ((moves > 0.0) | (below[1:] == 0.0)).all()
    return bool(far and moving and below[0] <= 3.0 * max(float(moves.max()), usual))


def _lattice(name: str, unit: str, values: Array) -> list[str]:
    """Readings on a lattice whose step is not small beside the noise."""
    step, noise = lattice_step(values), sample_noise(values)
    if step is None or step < VISIBLE * noise:
        return []
    levels = np.unique(values)
    rounding = step / np.sqrt(12.0)
    return [
        f"Readings of {name} come in steps of {with_unit(step, unit)} ({len(levels)} levels): rounding adds "
        f"noise of {with_unit(rounding, unit)}, {percent(rounding / noise)} of what varies from sample to "
        "sample. A measurement noise below that makes no sense."
    ]


def _outliers(name: str, unit: str, y: Array, series: Series) -> list[str]:
    """Single readings beyond both neighbours on either side, which return to where they were.

    What follows a step of an input within ``ANSWER_SAMPLES`` samples may be the answer to it, and is none.
    """
    seen = np.flatnonzero(~np.isnan(y))
    if len(seen) < 15:
        return []
    near = np.lib.stride_tricks.sliding_window_view(y[seen], 5)
    answers = _after_steps(series)[seen[2:-2]]
    others, seen = near[:, [0, 1, 3, 4]], seen[2:-2]
    distance = near[:, 2] - np.median(others, axis=1)
    beyond = np.maximum(near[:, 2] - others.max(axis=1), others.min(axis=1) - near[:, 2])
    usual = MAD * float(np.median(np.abs(distance)))
    if usual == 0.0:
        return []
    scale = np.maximum(usual, MAD * _running_median(np.abs(distance)))
    moved = np.abs(others[:, :2].mean(axis=1) - others[:, 2:].mean(axis=1))
    far = np.flatnonzero((beyond > np.maximum(OUTLIER_DEVIATIONS * scale, moved)) & ~answers)
    if not far.size or far.size > 0.1 * len(seen):
        return []
    worst = far[int(np.argmax(np.abs(distance[far])))]
    when = with_unit(float(series.t[seen[worst]]), series.time_unit, 6)
    return [
        f"Output {name}: {far.size} single reading{'s' if far.size > 1 else ''} "
        f"({percent(far.size / len(seen))}) more than {OUTLIER_DEVIATIONS:g} robust standard deviations "
        "off all of the neighbours, the worst by "
        f"{with_unit(float(distance[worst]), unit)} at t = {when}."
    ]


def _after_steps(series: Series) -> NDArray[np.bool_]:
    """Rows (T,) at or shortly after a change of an input that is large beside those around it."""
    near = np.zeros(len(series), dtype=bool)
    for u in series.u.T:
        change = np.abs(np.diff(u, prepend=u[0]))
        for row in np.flatnonzero(change > OUTLIER_DEVIATIONS * MAD * _running_median(change)):
            near[max(row - 1, 0) : row + ANSWER_SAMPLES] = True
    return near


def _running_median(values: Array, reach: int = 10) -> Array:
    """Medians (n,) of the values within ``reach`` rows on either side, fewer at the ends."""
    padded = np.pad(values, reach, constant_values=np.nan)
    return np.asarray(
        np.nanmedian(np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1), axis=1)
    )


def _stretches(mask: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First rows and lengths of the stretches of True."""
    edges = np.diff(np.concatenate([[0], mask.astype(int), [0]]))
    starts = np.flatnonzero(edges == 1)
    return starts, np.flatnonzero(edges == -1) - starts


def _longest(mask: NDArray[np.bool_]) -> tuple[int, int]:
    """First row and length of the longest stretch of True."""
    starts, lengths = _stretches(mask)
    if not starts.size:
        return 0, 0
    best = int(np.argmax(lengths))
    return int(starts[best]), int(lengths[best])
