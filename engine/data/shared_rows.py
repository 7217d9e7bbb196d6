"""Rows that one record has from another: a test with such rows is judged on what the model was fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series

STRETCH = 16  # rows one after the other that are no coincidence ...
CHANGES = 8  # ... if so many have other readings than the row before
SHARE = (
    0.2  # of the shorter record: with fewer rows in common both still tell something of their own
)
FACTOR = np.uint64(
    0x9E3779B97F4A7C15
)  # odd, of no pattern: numbers of rows become one of a stretch


def about_shared_rows(records: Sequence[Series], tests: Sequence[Series] = ()) -> str:
    """A sentence on the first of records and ``tests`` that has much of another one, else ""."""
    every, n = [*records, *tests], len(records)
    shared = shared_rows(every)
    if shared is None:
        return ""
    k, j, rows = shared.earlier, shared.later, f"ows {shared.first} to {shared.last}"
    if k < n <= j:
        return (
            f"R{rows} of the test, counted from 0, are those of a record that the model is fitted to: errors "
            "there are not those of data that it has not seen. Give other data, or none."
        )
    what, begin = ("record", 0) if j < n else ("test", n)
    return (
        f"R{rows} of {what} {j - begin}, counted from 0, are those of {what} {k - begin}, and count twice: "
        "give each once."
    )


@dataclass(frozen=True)
class Shared:
    """Of record ``later`` the rows ``first`` to ``last`` are those of record ``earlier``."""

    earlier: int
    later: int
    first: int
    last: int


def shared_rows(records: Sequence[Series]) -> Shared | None:
    """The first record that has much of an earlier one, wherever that stands in either; None where none has."""
    every = [np.column_stack([one.y, one.u])[one.samples] for one in records]
    lengths = np.array([len(rows) for rows in every])
    if lengths.sum() < 2 * STRETCH or len({rows.shape[1] for rows in every}) > 1:
        return None
    rows = np.concatenate(every)
    rows = np.where(np.isnan(rows), np.nan, rows) + 0.0  # one NaN, one 0
    _, number = np.unique(rows.view(np.uint64), axis=0, return_inverse=True)
    owner = np.repeat(np.arange(len(records)), lengths)
    start = np.arange(len(rows) - STRETCH + 1)
    y = rows[:, : records[0].y.shape[1]]
    changed = np.append(
        False, (np.diff(y, axis=0) != 0.0).any(axis=1) & np.isfinite(y[1:]).any(axis=1)
    )
    stretches, there = _stretches(number.ravel().astype(np.uint64)), _sums(changed) >= CHANGES
    there &= owner[start] == owner[start + STRETCH - 1]
    start = start[there]
    _, first, which = np.unique(stretches[there], return_index=True, return_inverse=True)
    begun = owner[start[first[which.ravel()]]]  # who has it first
    begins = np.concatenate([[0], lengths.cumsum()[:-1]])
    for later in range(1, len(records)):
        own = owner[start] == later
        for earlier in np.unique(begun[own & (begun < later)]).tolist():
            places = start[own & (begun == earlier)] - begins[later]
            covered = np.zeros(lengths[later] + 1, dtype=np.int64)
            np.add.at(covered, places, 1)
            np.add.at(covered, places + STRETCH, -1)
            taken = np.flatnonzero(covered.cumsum() > 0)
            if len(taken) > SHARE * min(lengths[later], lengths[earlier]):
                return Shared(earlier, later, int(taken[0]), int(taken[-1]))
    return None


def _stretches(number: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """A number for each stretch of rows, by theirs."""
    out = np.zeros(len(number) - STRETCH + 1, dtype=np.uint64)
    with np.errstate(over="ignore"):
        for k in range(STRETCH):
            out = out * FACTOR + number[k : k + len(out)] + np.uint64(1)
    return out


def _sums(of: NDArray[np.bool_]) -> NDArray[np.int64]:
    """How many there are in each stretch, but for its first row."""
    total = np.append(0, of.cumsum())
    return np.asarray(total[STRETCH:] - total[1 : len(of) - STRETCH + 2])
