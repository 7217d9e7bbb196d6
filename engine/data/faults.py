"""Faults of a record, of which no model knows: readings cut, stuck, given twice, or marks in their place.

Each is a sentence with units. Nothing is refused: what looks like a fault may be the plant.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from engine.arrays import Array
from engine.data.gaps import inputs_over_gaps
from engine.data.lattice import FEWEST_LEVELS, lattice_step
from engine.data.repeats import repeated
from engine.data.rounded_times import rounded_times
from engine.data.series import Series
from engine.data.stuck import stuck_at_times
from engine.words import enumerated, moment, number, percent, with_unit

OUTLIER_DEVIATIONS = 6.0  # robust standard deviations
FLICKERS = 0.1  # share of short stretches from which a signal ends at zero by a cut
ANSWER_SAMPLES = 5  # samples after a step of an input in which an answer to it may peak
COMMON = 20  # readings of two outputs; that fewer are the same may be chance
MAD = 1.4826  # standard deviation of a Gaussian over its median absolute deviation
MARKS = 0.3  # largest share of the readings that are marks: what is there more often is a state of the plant
FEWEST_VALUES = 20  # other values; a signal of few levels may well have one that is far away
OUT_OF_LINE = 5.0  # times as long as the next longest is a run of equal readings that is stuck
STUCK_OFTEN = 3  # such runs at most
FEWEST_MOVES = 20  # without which nobody knows how long a reading usually stays
MOST_TOLD = 3  # sentences about several records


def faults_of(
    outputs: Mapping[str, str], inputs: Mapping[str, str], series: Series
) -> tuple[str, ...]:
    """What comes before any cause in a model, in words; the units of the columns of y and u are by name."""
    notes = []
    for (name, unit), y in zip(outputs.items(), series.y.T, strict=True):
        notes += faults_of_readings(name, unit, y, series.u)
    for (name, unit), u in zip(inputs.items(), series.u.T, strict=True):
        notes += marks_among_inputs(name, unit, u)
    notes += inputs_over_gaps(inputs, series)
    return (*notes, *identical(outputs, series), *times_too_short(series))


def times_too_short(series: Series) -> list[str]:
    """A sentence where times are those of an even clock with too few digits."""
    if series.dt is not None or series.begins:
        return []
    told = rounded_times(series.t[series.samples], series.time_unit)
    return [f"The {told}"] if told else []


def about_faults(
    outputs: Mapping[str, str],
    inputs: Mapping[str, str],
    all_series: Sequence[Series],
    *,
    outliers: bool = False,
) -> str:
    """A few sentences on faults of the records that an estimate rests on; "" where there are none.

    With ``outliers`` for those whose noise is Gaussian, which a single reading far off may ruin.
    """
    told = []
    for k, one in enumerate(all_series):
        faults = [*faults_of(outputs, inputs, one)]
        if outliers:
            for (name, unit), y in zip(outputs.items(), one.y.T, strict=True):
                faults += single_outliers(name, unit, without_marks(y), one)
        told += [f"Record {k}: {said}" if len(all_series) > 1 else said for said in faults]
    if not told:
        return ""
    more = f" So it goes on, {len(told)} in all." if len(told) > MOST_TOLD else ""
    return f"Look at the record first. {' '.join(told[:MOST_TOLD])}{more}"


def faults_of_readings(name: str, unit: str, y: Array, u: Array) -> list[str]:
    """Faults of the readings y (T,) of one output, in words; u (T, nu) are the inputs."""
    seen = y[~np.isnan(y)]
    if len(seen) < 2:
        return []
    if seen.min() == seen.max():
        return [
            f"Output {name} reads {with_unit(float(seen[0]), unit)} throughout: the channel is dead."
        ]
    marked = [
        f"Output {name} {said}: a mark for 'no reading'? Then leave those out (NaN, or an empty cell)."
        for said in _marks(unit, y)
    ]
    values = without_marks(y)
    if told := repeated(name, values):
        return [*marked, *told]
    held = _held(name, unit, values, u)
    stuck = [] if any("stuck" in said for said in held) else stuck_at_times(name, values)
    return [*marked, *held, *stuck]


def marks_among_inputs(name: str, unit: str, u: Array) -> list[str]:
    """Marks in the place of one input u (T,), in words."""
    return [
        f"Input {name} {said}: a mark for 'not known'? The model takes it for the input: say what that was."
        for said in _marks(unit, u)
    ]


def _marks(unit: str, values: Array) -> list[str]:
    return [
        f"is exactly {with_unit(mark, unit, 6)} in {often} samples, far from all others ({number(low)} to "
        f"{with_unit(high, unit)})"
        for mark, often, low, high in marks_in(values)
    ]


def without_marks(y: Array) -> Array:
    """The readings (T,) with NaN in place of marks."""
    return np.where(np.isin(y, [mark for mark, *_ in marks_in(y)]), np.nan, y)


def marks_in(y: Array) -> Iterator[tuple[float, int, float, float]]:
    """Values that stand for a reading that is none: each, how often, and the least and largest of the others.

    One such as -999 is repeated to the last digit, farther from the others than these are among themselves,
    and the signal jumps there and back. Zero is none: it may be dark, empty, or switched off.
    """
    values = y.copy()
    for _ in range(2):
        seen = values[~np.isnan(values)]
        if not seen.size:
            return
        for mark in (seen.min(), seen.max()):
            others, often = seen[seen != mark], int((seen == mark).sum())
            starts, lengths = _stretches(seen == mark)
            if (
                mark != 0.0
                and 2 <= often <= MARKS * len(seen)
                and len(np.unique(others)) >= FEWEST_VALUES
                and np.abs(others - mark).min() > np.ptp(others)
                and ((starts > 0) & (starts + lengths < len(seen))).any()
            ):
                yield float(mark), often, float(others.min()), float(others.max())
                values[values == mark] = np.nan
                break
        else:
            return


def identical(outputs: Mapping[str, str], series: Series) -> list[str]:
    """Outputs whose readings are the same wherever both are there: one channel, given twice."""
    notes = []
    for (i, one), (j, other) in combinations(enumerate(outputs), 2):
        both = series.y[series.observed[:, [i, j]].all(axis=1)][:, [i, j]]
        if len(both) >= COMMON and np.ptp(both) > 0.0 and np.array_equal(both[:, 0], both[:, 1]):
            notes.append(
                f"Outputs {one} and {other} read exactly the same: one channel given twice? Then their noise "
                "is not that of two sensors, and no parameter can be trusted."
            )
    return notes


def _held(name: str, unit: str, y: Array, u: Array) -> list[str]:
    """Readings that stay the same: cut at an extreme while they moved, or stuck.

    Readings that rest while all inputs rest are neither, nor are those of a signal that moves slowly beside the
    step in which they come.
    """
    cut = [text for sign in (1.0, -1.0) for text in _cut(sign, unit, y)]
    clipped = [f"Output {name} looks clipped: {enumerated(cut)}."] if cut else []
    same = np.concatenate([[False], np.diff(y) == 0.0])
    start, length = longest_stretch(same)
    if length + 1 < max(20, 0.05 * len(y)) or (cut and y[start] in (np.nanmin(y), np.nanmax(y))):
        return clipped
    if u.shape[1] and not np.ptp(u[start - 1 : start + int(0.9 * length)], axis=0).any():
        return clipped
    seen = y[~np.isnan(y)]
    rounded = len(np.unique(seen)) < FEWEST_LEVELS or lattice_step(seen) is not None
    if rounded and not _out_of_line(y, (np.nanmin(y), np.nanmax(y)) if cut else ()):
        return clipped
    resting = y[start] == 0.0 and y[start] in (np.nanmin(y), np.nanmax(y))
    what = "nothing to measure there, or a stuck reading?" if resting else "a stuck reading?"
    return [
        *clipped,
        f"Output {name} stays at exactly {with_unit(float(y[start]), unit)} for {length + 1} samples from "
        f"row {start - 1}: {what}",
    ]


def _out_of_line(y: Array, cut: Sequence[float]) -> bool:
    """Whether one or a few runs of equal readings are far longer than all others, of which there are many.

    Not those at levels where the signal is ``cut``. Rounded readings of what moves slowly repeat themselves
    everywhere, and most where it turns: at the top of a wave nearly five times as long as on the steps beside.
    """
    starts = np.flatnonzero(np.append(True, np.diff(y) != 0.0))
    lengths = np.diff(np.append(starts, len(y)))
    longest = np.sort(lengths[~np.isin(y[starts], cut)])[::-1]
    few = longest[: STUCK_OFTEN + 1]
    return len(longest) >= FEWEST_MOVES and bool((few[:-1] > OUT_OF_LINE * few[1:]).any())


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


def single_outliers(name: str, unit: str, y: Array, series: Series) -> list[str]:
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
    when = moment(float(series.t[seen[worst]]), series.usual_step, series.time_unit)
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


def longest_stretch(mask: NDArray[np.bool_]) -> tuple[int, int]:
    """First row and length of the longest stretch of True."""
    starts, lengths = _stretches(mask)
    if not starts.size:
        return 0, 0
    best = int(np.argmax(lengths))
    return int(starts[best]), int(lengths[best])
