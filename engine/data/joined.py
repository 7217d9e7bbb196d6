"""Records one after the other: each from a first state of its own, or a test that goes on where one ended."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from engine.arrays import Array
from engine.data.series import Series
from engine.errors import SeriesError

ROUNDING = 1e-9  # of a channel's largest number: what moves by no more is constant


def past_of(test: Series, records: Sequence[Series]) -> Series | None:
    """The record that ``test`` goes on with, by their times; None where it begins anew."""
    return next((one for one in records if test.follows(one)), None)


def together(records: Sequence[Series]) -> Series:
    """Records of the same channels as one series, each from a first state of its own and on its own clock."""
    first = records[0]
    ends = np.cumsum([len(one) for one in records])
    columns = {
        name: np.concatenate([getattr(one, name) for one in records])
        for name in ("y", "u", "t", "extra")
    }
    return first.replace(**columns, begins=tuple(ends[:-1].tolist()))


def apart(series: Series) -> list[Series]:
    """The records of a series that :func:`together` made, or that one alone."""
    if not series.begins:
        return [series]
    between = series.substeps - 1  # rows after a record's last sample
    ends = [*(row - between for row in series.begins), len(series)]
    return [series.part(start, end) for start, end in zip((0, *series.begins), ends, strict=True)]


def starts_of(records: Sequence[Series]) -> tuple[float, ...]:
    """The times at which a record begins anew, in order.

    Not one that goes on where another ended. Of those whose clocks overlap the first counts: which of them a
    time is in, no time tells.
    """
    starts, end = list[float](), -np.inf
    for one in sorted(records, key=lambda one: float(one.t[0])):
        if one.t[0] > end:
            starts.append(float(one.t[0]))
        longest = float(np.diff(one.t[one.samples]).max(initial=0.0))
        end = max(end, float(one.t[-1]) + 1.5 * longest)
    return tuple(starts)


def overlapping(records: Sequence[Series]) -> bool:
    """Whether a time is in more than one of the records, as where each clock begins at 0."""
    spans = sorted((float(one.t[0]), float(one.t[-1])) for one in records)
    return any(start <= end for (_, end), (start, _) in pairwise(spans))


def by_length(records: Sequence[Series]) -> list[int]:
    """The records' places, the longest first, of those as long the most usual, then the one that moves most.

    So it is in whatever order they are given, whatever the units, zeros and signs of their channels, and
    whatever inputs are there that nothing depends on. Where a far larger one leaves others alike, readings and
    inputs decide, one by one.
    """
    far = distances(records).sum(axis=1).round(6)
    moves = [float((x.std(axis=0)).sum().round(6)) for x in standardized([r.y for r in records])]
    plain = [(one.y.tobytes(), one.u.tobytes()) for one in records]
    return sorted(
        range(len(records)), key=lambda k: (-len(records[k]), far[k], -moves[k], plain[k])
    )


def distances(records: Sequence[Series]) -> Array:
    """Between every two records (n, n): of the means and the standard deviations of what was read."""
    told = list[Array]()
    for one in records:
        seen = ~np.isnan(one.y)
        n = np.where(seen.any(axis=0), seen.sum(axis=0), np.nan)
        mean = np.nansum(one.y, axis=0) / n
        square = np.nansum((one.y - mean) ** 2, axis=0) / n
        told.append(np.append(mean, np.sqrt(square))[None])
    points = np.concatenate(standardized(told))
    return np.asarray(np.abs(points[:, None] - points).sum(axis=2))


def standardized(parts: Sequence[Array]) -> list[Array]:
    """Each (T, n) in standard deviations from the mean of all; 0 where there is none, or nothing moves."""
    whole = np.concatenate(parts)
    seen = ~np.isnan(whole)
    n = np.maximum(seen.sum(axis=0), 1)
    mean = np.nansum(whole, axis=0) / n
    spread = np.sqrt(np.nansum((whole - mean) ** 2, axis=0) / n)
    moves = spread > ROUNDING * np.abs(np.where(seen, whole, 0.0)).max(axis=0, initial=0.0)
    return [np.nan_to_num((x - mean)[:, moves] / spread[moves]) for x in parts]


def longest_of(records: Sequence[Series]) -> int:
    """Which of the records is the longest, of several the most usual."""
    return by_length(records)[0]


def in_turn(records: Sequence[Series]) -> list[Series]:
    """The same records on one clock, on which no two of them overlap: as :func:`engine.diagnose` takes them.

    They follow one another in the order of the list, each a round number after the one before: 1, 2 or 5 times
    a power of ten. The longest keeps its times, and those before it in the list come before it.

    Parameters
    ----------
    records : sequence of Series
        Records whose times need not tell them apart.

    Returns
    -------
    list of Series
        The records in the order given, with other times.

    Raises
    ------
    SeriesError
        There is no record.
    """
    if not records:
        raise SeriesError("no series was given; at least one is needed")
    first = longest_of(records)
    usual = max(float(one.steps.max(initial=0.0)) for one in records) or 1.0
    lasting = max(float(one.t[-1] - one.t[0]) for one in records) + 2.0 * usual
    power = 10.0 ** np.floor(np.log10(lasting))
    apart = float(next(power * n for n in (1.0, 2.0, 5.0, 10.0) if power * n > lasting))
    begin, out = float(records[first].t[0]), list(records)
    for k, one in enumerate(records):
        if k != first:
            out[k] = one.replace(t=one.t - one.t[0] + (begin + (k - first) * apart))
    return out


def anew(t: Any, starts: Sequence[float], early: float = 0.0) -> Any:
    """Times (a number or any shape) as if every record began with the first, those of one record as they are.

    What is no more than ``early`` before a start has begun.
    """
    if len(starts) < 2:
        return t
    after = np.append(0.0, np.asarray(starts) - starts[0])  # a table that is found on a tape, too
    return t - after[np.searchsorted(starts, t + early, side="right")]


def joined(one: Series, other: Series) -> Series:
    """Two series one after the other; times that do not follow go on with the usual step.

    Where both are refined, so is the step from the last sample of the one to the first of the other.
    """
    t, k = np.asarray(other.t), one.substeps
    at_sample = (len(one) - 1) % k == 0  # else the rows up to the next sample are there
    step = one.usual_step * (k if at_sample else 1)
    if t[0] <= one.t[-1]:
        t = t - t[0] + one.t[-1] + step
    names = ("y", "u", "t", "extra")
    parts = [{n: getattr(one, n) for n in names}, {n: getattr(other, n) for n in names} | {"t": t}]
    if k > 1 and at_sample:
        ends = {n: np.concatenate([parts[0][n][-1:], parts[1][n][:1]]) for n in names}
        pair = one.replace(**ends, substeps=1).refined(k)
        parts.insert(1, {n: getattr(pair, n)[1:k] for n in names})
    return one.replace(**{n: np.concatenate([part[n] for part in parts]) for n in names})
