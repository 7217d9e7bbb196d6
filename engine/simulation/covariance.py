"""How uncertain what was fitted to a free run is: its errors are hardly ever white."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.statespace.model import Array
from engine.ties import FLAT, tied

WEAK = (
    1e-3  # a direction this much weaker than the strongest is held against its differences' noise,
)
CLEAR = 5.0  # which it exceeds by this factor where it is known
LONGEST = 0.97  # correlation of one row with the next, at most, that decides how many are weighed


@dataclass(frozen=True)
class Determined:
    """Covariance (n_p, n_p) of p, and the directions (n_p, m) that the data do not determine."""

    covariance: Array
    directions: Array

    @property
    def tied(self) -> NDArray[np.bool_]:
        """Which components (n_p,) the data only determine together."""
        return tied(self.directions)


def run_covariance(
    e: Array,
    J: Array,
    record: NDArray[np.intp],
    row: NDArray[np.intp],
    wider: Callable[[], Array] | None = None,
) -> Determined:
    """Covariance of least squares with residuals e (n,), derivatives J (n, n_p), of rows of records.

    ``wider`` takes the derivatives by differences over other distances; what they differ by is noise.

    (J'J)^-1 S (J'J)^-1 with S = sum over lags of w_k sum_t s_t s_{t+k}', s_t = J_t' e_t the score of a row:
    weights and their number as of Newey and West (1987) and Andrews (1991).
    """
    n, n_p = J.shape
    lengths = np.linalg.norm(J, axis=0)
    lengths[lengths == 0.0] = 1.0
    scaled = J / lengths
    _, s, Vt = np.linalg.svd(scaled, full_matrices=False)
    strongest = s.max(initial=0.0)
    weak = s < FLAT * strongest
    doubtful = ~weak & (s < WEAK * strongest)
    if wider is not None and doubtful.any():
        noise = np.linalg.norm((scaled - wider() / lengths) @ Vt.T, axis=0)
        weak |= doubtful & (s < CLEAR * noise)
    half = Vt[~weak].T / s[~weak]
    bread = half @ half.T
    each = [
        _scores(scaled[record == k] * e[record == k, None], row[record == k])
        for k in np.unique(record)
    ]
    middle = np.asarray(sum((_long_run(scores) for scores in each), np.zeros((n_p, n_p))))
    covariance = bread @ middle @ bread * (n / max(n - n_p, 1))
    return Determined(covariance / np.outer(lengths, lengths), Vt[weak].T)


def _scores(values: Array, row: NDArray[np.intp]) -> Array:
    """Sums (T, n_p) of the values (n, n_p) of each row that has any.

    Rows without a reading, as steps between samples are, would hide that errors are correlated.
    """
    rows, place = np.unique(row, return_inverse=True)
    out = np.zeros((len(rows), values.shape[1]))
    np.add.at(out, place, values)
    return out


def _long_run(scores: Array) -> Array:
    """Sum of covariances (n_p, n_p) of scores (T, n_p) over lags, Bartlett's weights."""
    T = len(scores)
    power = (scores**2).sum(axis=0)
    lagged = (scores[1:] * scores[:-1]).sum(axis=0)
    r = np.divide(lagged, power, out=np.zeros_like(power), where=power > 0.0)
    longest = float(np.clip(r.max(initial=0.0), 0.0, LONGEST))
    alpha = 4.0 * longest**2 / ((1.0 - longest) ** 2 * (1.0 + longest) ** 2)
    lags = min(int(1.1447 * (alpha * T) ** (1.0 / 3.0)), T // 3)
    out = scores.T @ scores
    for k in range(1, lags + 1):
        product = scores[k:].T @ scores[:-k]
        out += (1.0 - k / (lags + 1.0)) * (product + product.T)
    return np.asarray(out)
