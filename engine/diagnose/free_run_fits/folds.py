"""Rows left out of a fit in turn, another range of the signals among them, and losses compared on them.

A record is one continuous run; the rows of a fold are only left out of the fit. What is compared are the
logarithms of the mean squared error of blocks: one extreme block would carry the mean of the errors
themselves, and hide every difference in the others. So may one of these logarithms, which is left out with the
one at the other end; a whole fold of extreme blocks is not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.diagnose.free_run_fits.fitted import Fitted, on_rows
from engine.distributions import student_sf
from engine.statespace.model import Array

BLOCKS, FOLDS = 16, 4
EVALUATIONS = 12  # of a fit without a fold: it begins where the fit to all rows ended


@dataclass(frozen=True, eq=False)
class Folds:
    """``block`` (n,) of each measured value and ``fold`` (blocks,) of each block; fold 0 is the extreme one."""

    block: NDArray[np.intp]
    fold: NDArray[np.intp]

    @property
    def blocks(self) -> int:
        """How many blocks there are."""
        return len(self.fold)

    def out(self, fold: int) -> NDArray[np.bool_]:
        """Which values (n,) a fold leaves out."""
        return np.asarray(self.fold[self.block] == fold)


def folds_of(records: Sequence[Series]) -> Folds:
    """Blocks of about as many rows each; the most extreme in amplitude and speed are a fold of their own."""
    rows = [len(one) for one in records]
    parts = [max(round(BLOCKS * n / sum(rows)), 1) for n in rows]
    block, extreme, first = [], [], 0
    signals = [_standardised(records, k) for k in range(len(records))]
    for one, x, n, m in zip(records, signals, rows, parts, strict=True):
        place = np.minimum(np.arange(n) * m // n, m - 1)
        for k in range(m):
            own = x[place == k]
            steps = np.diff(own, axis=0)
            extreme.append(
                np.abs(own).max(initial=0.0) + np.sqrt((steps**2).sum() / max(len(steps), 1))
            )
        block.append((first + np.repeat(place[:, None], one.y.shape[1], axis=1))[one.observed])
        first += m
    owner = np.repeat(np.arange(len(parts)), parts)
    chosen: list[int] = []
    for k in np.argsort(-np.array(extreme), kind="stable").tolist():
        left = parts[owner[k]] - sum(owner[i] == owner[k] for i in chosen)
        if len(chosen) < max(first // FOLDS, 1) and (2 * left > parts[owner[k]] or len(parts) == 1):
            chosen.append(k)  # a record left out as a whole would leave its first state open
    fold = np.zeros(first, dtype=np.intp)
    rest = np.setdiff1d(np.arange(first), chosen)
    fold[rest] = 1 + np.arange(len(rest)) % (FOLDS - 1)
    return Folds(np.concatenate(block), fold)


def _standardised(records: Sequence[Series], k: int) -> Array:
    """Outputs and inputs (T, n) in their standard deviations over all records; none that was never measured."""
    whole = [np.concatenate((one.y, one.u), axis=1) for one in records]
    stacked = np.concatenate(whole)
    seen = ~np.isnan(stacked).all(axis=0)
    mean, spread = np.nanmean(stacked[:, seen], axis=0), np.nanstd(stacked[:, seen], axis=0)
    own = (whole[k][:, seen] - mean) / np.where(spread > 0.0, spread, 1.0)
    return np.asarray(np.nan_to_num(own))


def losses(fit: Fitted, folds: Folds) -> Array:
    """log(mean squared error) of each block (blocks,) by fits that have not seen its fold."""
    out = np.full(folds.blocks, np.nan)
    for k in np.unique(folds.fold):
        e = on_rows(fit, ~folds.out(int(k)), EVALUATIONS)
        for b in np.flatnonzero(folds.fold == k):
            own = e[folds.block == b]
            if own.size:
                with np.errstate(over="ignore"):  # a run that runs away on rows left out
                    out[b] = np.log(np.mean(own**2) + np.finfo(float).tiny)
    return out


def held_out_error(losses: Array) -> float:
    """The root of the geometric mean of blocks' squared errors, weighed as residuals are."""
    return float(np.exp(0.5 * np.nanmean(losses)))


def times(losses: Array, others: Array) -> float:
    """How many times as large errors are as others, by their losses in the same blocks; 1 without any."""
    d = _apart(losses, others)
    return float(np.exp(0.5 * d[_cut(d)].mean())) if len(d) else 1.0


def p_better(better: Array, worse: Array) -> float:
    """One-sided p-value of the first losses being no smaller than the second, paired by blocks.

    Student's t of means without the ends (Yuen 1974).
    """
    d = _apart(worse, better)
    if len(d) < 2 or not np.ptp(d) > 0.0:
        return 0.5 if not len(d) or d[0] == 0.0 else float(d[0] < 0.0)
    kept = d[_cut(d)]
    n = len(kept)
    spread = np.clip(d, kept[0], kept[-1]).std(ddof=1)
    if not spread > 0.0:
        return 0.5 if kept[0] == 0.0 else float(kept[0] < 0.0)
    error = spread * np.sqrt((len(d) - 1) / (n * (n - 1)))
    return float(student_sf(kept.mean() / error, n - 1))


def _apart(losses: Array, others: Array) -> Array:
    """Differences of losses, sorted, where both are known."""
    d = losses - others
    return np.sort(d[np.isfinite(d)])


def _cut(d: Array) -> slice:
    """Without the least and the largest of every BLOCKS: one block may be as far off as it likes.

    As one does that alone tells a parameter: left out, the run there says what it likes.
    """
    ends = len(d) // BLOCKS
    return slice(ends, len(d) - ends)
