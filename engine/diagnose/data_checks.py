"""What can be said of a series before any model is fitted: clipped, quantised, dead, short, spiked.

Everything here is a note in words. Nothing is refused: what a note means for the verdict is for the
reader and for the tests themselves, which know of missing values and of information that is not there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.diagnose.lattice import VISIBLE, lattice_step, sample_noise
from engine.model import Array, MixedModel
from engine.series import Series
from engine.words import listed, number, percent, with_unit

SHORT = 100  # samples; and ten per parameter
OUTLIER = 6.0  # robust standard deviations off the neighbours' median
MAD = 1.4826  # standard deviation of a Gaussian over its median absolute deviation


def check_data(model: MixedModel, series: Series) -> tuple[str, ...]:
    """Notes on a series as data for a model, in words with units; empty where nothing is odd."""
    notes = [*_length(model, series), *_times(series)]
    for column, (name, unit) in enumerate(model.outputs.items()):
        y = series.y[:, column]
        seen = ~np.isnan(y)
        if seen.sum() < 2:
            notes.append(f"Output {name} has {int(seen.sum())} readings: it tells nothing.")
            continue
        notes += _gaps(name, seen, series)
        values = y[seen]
        if values.min() == values.max():
            notes.append(
                f"Output {name} reads {with_unit(float(values[0]), unit)} throughout: the channel is dead."
            )
            continue
        notes += [
            *_clipped(f"Output {name}", unit, values),
            *_stuck(name, unit, y),
            *_lattice(name, unit, values),
            *_outliers(name, unit, y, series),
        ]
    for column, (name, unit) in enumerate(model.inputs.items()):
        u = series.u[:, column]
        if u.min() == u.max():
            notes.append(
                f"Input {name} is {with_unit(float(u[0]), unit)} throughout: what it drives is not excited."
            )
        elif len(np.unique(u)) > 10:  # a switched input rests at its extremes as a rule
            notes += _clipped(f"Input {name}", unit, u)
    return tuple(notes)


def _length(model: MixedModel, series: Series) -> list[str]:
    T, n = len(series), len(model.parameters)
    if max(SHORT, 10 * n) <= T:
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
    text = f"Sampling is irregular: steps of {number(float(steps.min()))} to {number(float(steps.max()))} s"
    if steps[longest] > 5.0 * middle:
        text += f", the longest after t = {number(float(series.t[longest]), 6)} s"
    return [f"{text}; spectra are not shown."]


def _gaps(name: str, seen: NDArray[np.bool_], series: Series) -> list[str]:
    missing = 1.0 - seen.mean()
    if missing == 0.0:
        return []
    start, length = _longest(~seen)
    span = number(length * float(np.median(series.steps)))
    return [
        f"Output {name}: {percent(missing)} of the readings are missing, the longest gap is {length} "
        f"samples ({span} s) from t = {number(float(series.t[start]), 6)} s."
    ]


def _clipped(what: str, unit: str, values: Array) -> list[str]:
    """An extreme, but for single outliers, that is held and far more frequent than the next level."""
    found = []
    levels, counts = np.unique(values, return_counts=True)
    if len(levels) < 4:
        return []
    for step, word in ((-1, "largest"), (1, "smallest")):
        end = -1 if step < 0 else 0
        beyond = 0
        while beyond <= 0.01 * len(values) and abs(end) < len(levels) - 1:
            often = int(counts[end])
            if often >= max(5, 0.01 * len(values)) and often >= 3 * counts[end + step]:
                _, held = _longest(values == levels[end])
                if held >= 3:
                    found.append(
                        f"{word} value {with_unit(float(levels[end]), unit)} in {often} samples "
                        f"({percent(often / len(values))}), up to {held} in a row"
                    )
                break
            beyond += often
            end += step
    return [f"{what} looks clipped: {listed(found)}."] if found else []


def _stuck(name: str, unit: str, y: Array) -> list[str]:
    same = np.concatenate([[False], np.diff(y) == 0.0])
    start, length = _longest(same)
    if length + 1 < max(20, 0.05 * len(y)):
        return []
    value = y[start]
    if value in (np.nanmin(y), np.nanmax(y)):
        return []  # said as clipping
    return [
        f"Output {name} stays at exactly {with_unit(float(value), unit)} for {length + 1} samples from "
        f"row {start - 1}: a stuck reading?"
    ]


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
    seen = np.flatnonzero(~np.isnan(y))
    if len(seen) < 15:
        return []
    near = np.lib.stride_tricks.sliding_window_view(y[seen], 5)
    seen = seen[2:-2]
    distance = near[:, 2] - np.median(near[:, [0, 1, 3, 4]], axis=1)
    scale = MAD * float(np.median(np.abs(distance)))
    if scale == 0.0:
        return []
    size = np.pad(np.abs(distance), 2)
    largest = np.lib.stride_tricks.sliding_window_view(size, 5).max(
        axis=1
    )  # a spike moves its neighbours
    far = np.flatnonzero((np.abs(distance) > OUTLIER * scale) & (np.abs(distance) >= largest))
    if not far.size or far.size > 0.1 * len(seen):
        return []
    worst = far[int(np.argmax(np.abs(distance[far])))]
    return [
        f"Output {name}: {far.size} reading{'s' if far.size > 1 else ''} "
        f"({percent(far.size / len(seen))}) more than {OUTLIER:g} robust standard deviations "
        "off the neighbours, the worst by "
        f"{with_unit(float(distance[worst]), unit)} at t = {number(float(series.t[seen[worst]]), 6)} s."
    ]


def _longest(mask: NDArray[np.bool_]) -> tuple[int, int]:
    """First row and length of the longest run of True."""
    padded = np.concatenate([[0], mask.astype(int), [0]])
    edges = np.diff(padded)
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if not starts.size:
        return 0, 0
    best = int(np.argmax(ends - starts))
    return int(starts[best]), int(ends[best] - starts[best])
