"""What can be said of a series before any model is fitted: clipped, quantised, dead, short, spiked.

Everything here is a note in words. Nothing is refused: what a note means for the verdict is for the
reader and for the tests themselves, which know of missing values and of information that is not there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.data.faults import (
    faults_of_readings,
    identical,
    longest_stretch,
    marks_among_inputs,
    single_outliers,
    times_too_short,
    without_marks,
)
from engine.data.gaps import inputs_over_gaps
from engine.data.lattice import VISIBLE, lattice_step, sample_noise
from engine.data.series import Series
from engine.statespace.clock import about_clock
from engine.statespace.model import Array, MixedModel
from engine.words import moment, number, percent, with_unit

SHORT_SAMPLES = 100  # samples; and ten per parameter


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
        notes += faults_of_readings(name, unit, y, series.u)
        values = without_marks(y)
        notes += _lattice(name, unit, values[~np.isnan(values)])
        notes += single_outliers(name, unit, values, series)
    notes += identical(model.outputs, series)
    for column, (name, unit) in enumerate(model.inputs.items()):
        u = series.u[:, column]
        notes += marks_among_inputs(name, unit, u)
        if u.min() == u.max():
            notes.append(
                f"Input {name} is {with_unit(float(u[0]), unit)} throughout: what it drives is not excited."
            )
    notes += inputs_over_gaps(model.inputs, series)
    return tuple(notes)


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
    steps, middle = series.steps, series.usual_step
    longest = int(np.argmax(steps))
    shortest, most = float(steps.min()), float(steps.max())
    text = (
        f"Sampling is irregular: steps of {number(shortest)} to {number(most)} {series.time_unit}"
    )
    if steps[longest] > 5.0 * middle:
        text += f", the longest after t = {moment(float(series.t[longest]), shortest, series.time_unit)}"
    return [f"{text}; spectra are not shown.", *times_too_short(series)]


def _gaps(name: str, seen: NDArray[np.bool_], series: Series) -> list[str]:
    missing = 1.0 - seen.mean()
    if missing == 0.0:
        return []
    start, length = longest_stretch(~seen)
    span, clock = number(length * series.usual_step), series.time_unit
    begin = moment(float(series.t[start]), series.usual_step, clock)
    return [
        f"Output {name}: {percent(missing)} of the readings are missing, the longest gap is {length} "
        f"sample{'s' if length > 1 else ''} ({span} {clock}) from t = {begin}."
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
