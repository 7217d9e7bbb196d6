"""Whether records begin where the model's first state says, at an estimate.

Where one does not, as a part of a longer one, noise and parameters make up for it in the likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.distributions import chi2_sf
from engine.errors import EngineError
from engine.filters.sigma_point import MomentPath, moment_path
from engine.statespace.model import Array, MixedModel
from engine.words import enumerated

ELSEWHERE = 1e-5  # p-value of first readings, over all records, from which on it is told
SHOWN = 5  # records that are told by their numbers


def about_beginnings(model: MixedModel, theta: Array, all_series: Sequence[Series]) -> str:
    """A sentence on records whose first readings are not what the model's first state lets expect, else ""."""
    level = ELSEWHERE / len(all_series)
    away = [
        k
        for k, one in enumerate(all_series)
        if first_readings(model, np.asarray(theta), one) < level
    ]
    if not away:
        return ""
    which = "The record begins"
    if len(all_series) > 1:
        numbers = _some([str(k) for k in away])
        which = f"Of the records, counted from 0, {numbers} begin{'s' if len(away) == 1 else ''}"
    if len(away) == len(all_series) > SHOWN:
        which = f"All {len(away)} records begin"
    cuts = about_cuts(all_series, away)
    return (
        f"{which} where the model's first state says that none does, and noise and parameters make up for "
        f"that: widen the covariances of initial, or have it depend on parameters.{cuts}"
    )


def about_cuts(
    all_series: Sequence[Series], those: Sequence[int], numbers: Sequence[int] | None = None
) -> str:
    """After a space, a sentence on ``those`` records whose times go on where another one ends, else "".

    They are told by their places in the list, or by ``numbers``.
    """
    numbers = range(len(all_series)) if numbers is None else numbers
    ends = np.array([one.t[-1] for one in all_series])
    late = ends + [2.0 * np.diff(one.t[one.samples]).max() for one in all_series]
    told = list[str]()
    for k in those:
        begin = all_series[k].t[0]
        near = np.flatnonzero((ends < begin) & (begin <= late)).tolist()
        ended = [j for j in near if all_series[k].follows(all_series[j])]
        if ended:  # of several the one before it in the list
            j = max(ended, key=lambda j: (j < k, j))
            told.append(f"{numbers[k]} begins where {numbers[j]} ends")
    if not told:
        return ""
    return f" In time, record {_some(told)}: give what is one record as one."


def _some(told: list[str]) -> str:
    """All of them where they are few, else the first and how many there are beside them."""
    if len(told) <= SHOWN + 1:
        return enumerated(told)
    return enumerated([*told[:SHOWN], f"{len(told) - SHOWN} more"])


def first_rows(model: MixedModel, one: Series) -> NDArray[np.intp]:
    """The rows that tell where a record begins: as many that hold a reading as there are states."""
    return np.flatnonzero(one.observed.any(axis=1))[: model.nx]


def first_readings(model: MixedModel, theta: Array, one: Series) -> float:
    """The p-value of a record's first readings; NaN where there are none, or one has no density."""
    rows = first_rows(model, one)
    if not rows.size:
        return np.nan
    try:
        path = moment_path(model, theta, one.part(0, max(int(rows[-1]) + 1, 2)))
        return float(chi2_sf(*squared(path, one, rows)))
    except (EngineError, np.linalg.LinAlgError):  # also where a reading can only be one value
        return np.nan


def squared(path: MomentPath, one: Series, rows: NDArray[np.intp]) -> tuple[float, int]:
    """The sum of squares of what those rows are off their predictions, whitened, and of how many readings."""
    square = 0.0
    for t in rows:
        there = one.observed[t]
        nu, S = path.innovations[t][there], path.S[t][np.ix_(there, there)]
        square += float(nu @ np.linalg.solve(S, nu))
    return square, int(one.observed[rows].sum())
