"""How uncertain what was fitted to a free run is: its errors are hardly ever white."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from engine.distributions import normal_quantile, student_quantile
from engine.simulation.memory import SHARE, memory_of, response, shocks
from engine.statespace.model import Array
from engine.ties import FLAT, tied

WEAK = (
    1e-3  # a direction this much weaker than the strongest is held against its differences' noise,
)
CLEAR = 5.0  # which it exceeds by this factor where it is known
ENOUGH, LOST = 300, 0.01  # rows that are left at least; what derivatives may lose in any direction
FEWEST = 1.0  # degrees of freedom that a variance has at least
TWO = float(normal_quantile(0.975))  # standard errors to either side that hold 95 %
LONGEST = 0.97  # correlation of one row with the next, at most, that decides how many are weighed
TINY = np.finfo(float).tiny

Times: TypeAlias = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Determined:
    """Covariance (n_p, n_p) of p, and the directions (n_p, m) that the data do not determine.

    ``degrees`` (n_p,) of freedom are those of the variances. The covariance is wider for it: 1.96 standard
    errors are the 95 % of Student's distribution.
    """

    covariance: Array
    directions: Array
    degrees: Array

    @property
    def tied(self) -> NDArray[np.bool_]:
        """Which components (n_p,) the data only determine together."""
        return tied(self.directions)


def run_covariance(
    e: Array,
    J: Array,
    record: NDArray[np.intp],
    row: NDArray[np.intp],
    channel: NDArray[np.intp],
    wider: Callable[[], Array] | None = None,
) -> Determined:
    """Covariance of least squares, residuals e (n,), derivatives J (n, n_p), of channels in rows of records.

    ``wider`` takes the derivatives by differences over other distances; what they differ by is noise.

    Estimates are off by (J'J)^-1 J'e. The residuals are what is left of shocks that are remembered
    (:mod:`.memory`), so that this is a sum of q_t = k_t v_t, what the shocks v of a row do in all rows that
    follow, summed over channels. Its covariance is the sum over lags of w_k sum_t q_t q_{t+k}': prewhitened as
    of Andrews and Monahan (1992), but by the residuals' memory, as that of J tells nothing of theirs; weights
    and their number as of Newey and West (1987) and Andrews (1991).
    """
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
    known = Vt[~weak].T / s[~weak]
    # rows without a reading, as steps between samples are, would hide that errors are correlated
    place = np.zeros(len(row), dtype=np.intp)
    for k in np.unique(record):
        place[record == k] = np.unique(row[record == k], return_inverse=True)[1]
    of = _Shocks(_Rows(e, scaled, record, place, channel).as_few(known), known)
    degrees = of.degrees()
    wide = [student_quantile(0.975, max(float(d), FEWEST)) / TWO for d in degrees]
    return Determined(
        of.covariance() * np.outer(wide, wide) / np.outer(lengths, lengths), Vt[weak].T, degrees
    )


@dataclass(frozen=True, eq=False)
class _Rows:
    """Residuals e (n,) and derivatives J (n, n_p) of channels in rows of records, as numbered."""

    e: Array
    J: Array
    record: NDArray[np.intp]
    row: NDArray[np.intp]
    channel: NDArray[np.intp]

    def together(self, m: int) -> _Rows:
        """Sums over m rows each, of the same size where all that is summed is independent."""
        keys = np.column_stack((self.record, self.channel, self.row // m))
        groups, place, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
        sums = np.zeros((len(groups), 1 + self.J.shape[1]))
        np.add.at(sums, place.ravel(), np.column_stack((self.e, self.J)))
        sums /= np.sqrt(count)[:, None]
        return _Rows(sums[:, 0], sums[:, 1:], groups[:, 0], groups[:, 2], groups[:, 1])

    def as_few(self, known: Array) -> _Rows:
        """As few rows as say the same: beside fast noise no autoregression sees far enough in many.

        ``known`` (n_p, m) makes the derivatives orthonormal.
        """
        best, m = self, 2
        while len(np.unique(self.row)) >= m * ENOUGH:
            found = self.together(m)
            U = found.J @ known
            if np.linalg.eigvalsh(U.T @ U).min(initial=1.0) < 1.0 - LOST:
                break
            best, m = found, 2 * m
        return best


class _Shocks:
    """What residuals are made of; ``known`` (n_p, m) makes their derivatives orthonormal."""

    def __init__(self, rows: _Rows, known: Array) -> None:
        e, record, channel = rows.e, rows.record, rows.channel
        keys = np.column_stack((record, rows.row))
        every, place = np.unique(keys, axis=0, return_inverse=True)
        self.record, self.place = every[:, 0], place.ravel()
        self.e, self.moved = e, rows.J @ known @ known.T  # what an error moves estimates by
        self.share = len(e) / max(len(e) - known.shape[1], 1)
        self.runs = [
            [
                np.flatnonzero((channel == c) & (record == k))
                for k in np.unique(record[channel == c])
            ]
            for c in np.unique(channel)
        ]
        self.memories = [memory_of([(e[i], rows.J[i]) for i in runs]) for runs in self.runs]
        self.phis = [memory.phi for memory in self.memories]

    def covariance(self) -> Array:
        """Of the estimates (n_p, n_p)."""
        return self._sum(self.phis, lambda one, other: one.T @ other)

    def degrees(self) -> Array:
        """Of freedom (n_p,) of the variances.

        Satterthwaite's: 2 / var(log variance), which is that of few shocks that matter much, and that of what
        is known of the memory.
        """
        n_p = self.moved.shape[1]
        squares, fourth = np.zeros(n_p), np.zeros(n_p)
        for runs, phi in zip(self.runs, self.phis, strict=True):
            size = np.mean(np.concatenate([shocks(self.e[i], phi) for i in runs]) ** 2)
            for i in runs:
                weights = size * response(self.moved[i], phi) ** 2
                squares += weights.sum(axis=0)
                fourth += (weights**2).sum(axis=0)
        spread = 2.0 * fourth / np.maximum(squares**2, TINY)
        for c, memory in enumerate(self.memories):
            h = SHARE * max(float(np.abs(memory.phi).max(initial=0.0)), 1.0)
            steps = h * np.eye(len(memory.phi))
            slopes = [(self._logs(c, one) - self._logs(c, -one)) / (2.0 * h) for one in steps]
            slope = np.array(slopes).reshape(-1, n_p)
            spread += np.einsum("ip,ij,jp->p", slope, memory.covariance, slope)
        return np.asarray(2.0 / np.maximum(spread, TINY))

    def _logs(self, c: int, step: Array) -> Array:
        """Logarithms of the variances (n_p,) where channel c remembers otherwise by a step."""
        phis = [*self.phis[:c], self.phis[c] + step, *self.phis[c + 1 :]]
        variances = self._sum(phis, lambda one, other: (one * other).sum(axis=0))
        return np.asarray(np.log(np.maximum(variances, TINY)))

    def _sum(self, phis: Sequence[Array], times: Times) -> Array:
        """Of the products of what shocks move estimates by, over lags, where channels remember like phis."""
        q = np.zeros((len(self.record), self.moved.shape[1]))
        for runs, phi in zip(self.runs, phis, strict=True):
            v = np.concatenate([shocks(self.e[i], phi) for i in runs])
            k = np.concatenate([response(self.moved[i], phi) for i in runs])
            np.add.at(q, self.place[np.concatenate(runs)], k * v[:, None])
        parts = [_long_run(q[self.record == k], times) for k in np.unique(self.record)]
        return np.asarray(np.sum(parts, axis=0) * self.share)


def _long_run(scores: Array, times: Times) -> Array:
    """Sum of products of scores (T, n_p) over lags, Bartlett's weights."""
    T = len(scores)
    power = (scores**2).sum(axis=0)
    lagged = (scores[1:] * scores[:-1]).sum(axis=0)
    r = np.divide(lagged, power, out=np.zeros_like(power), where=power > 0.0)
    longest = float(np.clip(r.max(initial=0.0), 0.0, LONGEST))
    alpha = 4.0 * longest**2 / ((1.0 - longest) ** 2 * (1.0 + longest) ** 2)
    lags = min(int(1.1447 * (alpha * T) ** (1.0 / 3.0)), T // 3)
    out = times(scores, scores)
    for k in range(1, lags + 1):
        product = times(scores[k:], scores[:-k])
        out = out + (1.0 - k / (lags + 1.0)) * (product + product.T)
    return np.asarray(out)
