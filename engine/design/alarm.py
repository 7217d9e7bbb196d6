"""Whether a diagnosis will see something, from the statistic of its screen.

The diagnosis calibrates p-values that are near its level by a few simulated records
(:mod:`engine.diagnose.refits.calibration`): their logarithms are divided by a boldness. It is above 1 on few
readings (:mod:`engine.design.residuals`), and by its own scatter, because it is never let below 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.design.spectrum import records_of
from engine.diagnose.refits.calibration import BOLDEST, CLEARLY, FEWEST, LEVEL, SERIES, boldness
from engine.diagnose.screening.screen import CLEARLY_HEAVIER, SAME, beyond
from engine.distributions import chi2_isf, chi2_sf
from engine.statespace.model import Array

AGAIN = 4  # drawings of a calibration, from its own simulated records and its neighbours'
MOST_TESTS = 40  # of a calibration that is drawn
FURTHER = 0.01  # of multiplier draws, with LEVEL of them, tell how their tail falls
CLEAREST = 1e9  # statistic, above which all is clear
LEAST_NOISE = 0.1  # of what is left of a record, beside an effect that is nearly all of it


@dataclass(frozen=True)
class Alarm:
    """When a screen raises an alarm.

    ``threshold`` is the statistic that one test needs before it is calibrated.
    """

    threshold: float

    @property
    def tests(self) -> float:
        """Number of independent tests that have this threshold together."""
        return max(LEVEL / float(chi2_sf(self.threshold, 1)), 1.0)

    def raised(
        self, statistic: Array, v: Array, shared: Array, simulated: Array, seed: int
    ) -> NDArray[np.bool_]:
        """Which of the statistics (K,) of a screen raise one.

        ``v`` (N,) is the effect's footprint on N readings, of whose information noise parameters have a part
        ``shared`` (K,). ``simulated`` (G, SERIES) are its statistics in simulated records without it, for G
        records like those given, from the lowest statistic to the highest.
        """
        rng = np.random.default_rng([seed, 1])
        few, many = self._boldness(simulated, rng)
        rank = np.argsort(np.argsort(statistic, kind="stable"))
        group = rank * len(few) // len(statistic)
        edge, further, least = _edges(statistic, v, shared, rng)
        heavier = LEVEL / np.maximum(chi2_sf(edge, 1), 1e-300)
        known = (
            heavier > CLEARLY_HEAVIER
        )  # the screen then goes by the draws, and calibrates the rest
        excess = np.maximum(further - edge, SAME * edge) / np.log(LEVEL / FURTHER)
        heavy = np.maximum(beyond(statistic, edge, np.where(known, excess, 1.0)), least)
        single = np.maximum(np.where(known, heavy, chi2_sf(statistic, 1)), 1e-300)
        tests = self.tests * np.where(known, 1.0, heavier)
        clear = tests * single ** (1.0 / BOLDEST) <= LEVEL
        first, last = (tests * single ** (1.0 / b[group]) for b in (few, many))
        open_ = (first < CLEARLY * LEVEL) & (first > LEVEL / CLEARLY)
        said = np.where(open_, last, first) <= LEVEL
        return np.asarray((tests * single <= LEVEL) & (clear | said))

    def _boldness(self, simulated: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Boldness after the fewest and after all simulated records, (AGAIN G,) each, record by record."""
        logs = -np.log(np.maximum(chi2_sf(simulated, 1), 1e-300))
        n = int(min(max(round(self.tests), 1), MOST_TESTS))
        largest = float((1.0 / np.arange(1, n + 1)).sum())  # of n exponentials, on average
        expected = np.full(SERIES, largest)
        out = []
        for k in range(len(logs)):
            near = logs[max(k - 1, 0) : k + 2].ravel()
            for _ in range(AGAIN):
                others = near.mean() * rng.exponential(size=(SERIES, n - 1))
                x = np.column_stack([rng.choice(near, size=SERIES), others])
                few = boldness(x[:FEWEST], expected[:FEWEST])[0]
                out.append((few, boldness(x, expected)[0]))
        return tuple(np.array(out).T)


def _edges(
    statistic: Array, v: Array, shared: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """The points (K,) that LEVEL and FURTHER of multiplier draws exceed; the share in which readings agree.

    The draws keep the size of each score. Of scores w_t, whose sum squared is the statistic T,

        w_t = u_t z_t,    z = (I - u u') e + sqrt(T) u,    u = sqrt(1 - q) v / |v| - sqrt(q) d,

    e white and q the part of the effect's information that noise parameters have ``shared`` with it by chance,
    along a d of past noise that is projected out, random signs make sums with the variance V = sum w_t^2. Where
    few of them count their tail is shorter than a normal one's (Cornish, Fisher 1938), and ends where all of
    these agree. An effect that few readings show is seen with care (:mod:`engine.diagnose.screening.screen`).
    """
    N, size = len(v), float(np.linalg.norm(v))
    if not size > 0.0:
        points = (chi2_isf(level, 1) for level in (LEVEL, FURTHER))
        edge, further = (np.full_like(statistic, point) for point in points)
        return edge, further, np.zeros_like(statistic)
    K = records_of(N)
    e, d = rng.standard_normal((2, K, N))
    d -= np.outer(d @ v, v / size**2)
    d /= np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-300)
    T = np.minimum(statistic, CLEAREST)
    noise = np.sqrt(np.maximum(1.0 - T / N, LEAST_NOISE))  # of z, whose squares have the mean 1
    V, alike = np.empty_like(T), np.empty_like(T)
    for start in range(0, len(T), K):
        k = slice(start, start + K)
        n, q = len(T[k]), shared[k, None]
        u = np.sqrt(1.0 - q) * v / size - np.sqrt(q) * d[:n]
        along = np.sqrt(T[k]) - noise[k] * (e[:n] * u).sum(axis=1)
        squares = (u * (noise[k, None] * e[:n] + along[:, None] * u)) ** 2
        V[k] = squares.sum(axis=1)
        alike[k] = (squares**2).sum(axis=1) / np.maximum(V[k], 1e-300) ** 2  # 1 / those that count
    alike = np.clip(alike, 1e-9, 1.0)

    def point(level: float) -> Array:
        normal = float(np.sqrt(chi2_isf(level, 1)))
        shorter = np.maximum(normal - alike * (normal**3 - 3.0 * normal) / 12.0, 0.0)
        return np.asarray(V * np.minimum(shorter**2, 1.0 / alike))

    return point(LEVEL), point(FURTHER), 2.0 ** (1.0 - 1.0 / alike)
