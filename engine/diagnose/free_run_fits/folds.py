"""Rows left out of a fit in turn, another range of the signals among them, and losses compared on them.

A record is one continuous run; the rows of a fold are only left out of the fit. What is compared are the
logarithms of the mean squared error of blocks: one extreme block would carry the mean of the errors
themselves, and hide every difference in the others.
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


def p_better(better: Array, worse: Array) -> float:
    """One-sided p-value of the first losses being no smaller than the second, paired by blocks."""
    d = (worse - better)[np.isfinite(worse - better)]
    if len(d) < 2 or not np.ptp(d) > 0.0:
        return 0.5 if not len(d) or d[0] == 0.0 else float(d[0] < 0.0)
    error = d.std(ddof=1) / np.sqrt(len(d))
    return float(student_sf(d.mean() / error, len(d) - 1))
