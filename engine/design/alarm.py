"""Whether a diagnosis will see something, from the statistic of its screen.

The diagnosis calibrates p-values that are near its level by a few simulated records
(:mod:`engine.diagnose.search.calibration`): their logarithms are divided by a boldness. It is above 1 on few
readings (:mod:`engine.design.residuals`), and by its own scatter, because it is never let below 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.diagnose.screening.screen import CLEARLY_HEAVIER
from engine.diagnose.search.calibration import (
    BOLDEST,
    CLEARLY,
    FEWEST,
    LEVEL,
    SERIES,
    boldness,
)
from engine.distributions import chi2_isf, chi2_sf
from engine.statespace.model import Array

AGAIN = 4  # drawings of a calibration, from its own simulated records and its neighbours'
MOST_TESTS = 40  # of a calibration that is drawn
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

    def raised(self, statistic: Array, v: Array, simulated: Array, seed: int) -> NDArray[np.bool_]:
        """Which of the statistics (K,) of a screen raise one.

        ``v`` (N,) is the effect's footprint on N readings. ``simulated`` (G, SERIES) are its statistics in
        simulated records without it, for G records like those given, from the lowest statistic to the highest.
        """
        rng = np.random.default_rng([seed, 1])
        few, many = self._boldness(simulated, rng)
        rank = np.argsort(np.argsort(statistic, kind="stable"))
        group = rank * len(few) // len(statistic)
        heavier = _heavier(statistic, v)
        known = heavier > CLEARLY_HEAVIER  # the screen then counts it, and calibrates the product
        single = np.maximum(chi2_sf(statistic, 1) * np.where(known, heavier, 1.0), 1e-300)
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


def _heavier(statistic: Array, v: Array) -> Array:
    """How much heavier than chi2 the tail of multiplier draws is that keep the size of every reading's score.

    Of scores w_t = u_t z_t, u = v / |v|, z = (I - u u') e + sqrt(statistic) u, random signs make sums with the
    variance V = sum w_t^2, and not 1, on average. Where few of them count their tail is shorter than a normal
    one's (Cornish, Fisher 1938), and ends where all of these agree. An effect that few readings show is seen
    with care (:mod:`engine.diagnose.screening.screen`).
    """
    size = float(np.linalg.norm(v))
    if not size > 0.0:
        return np.ones_like(statistic)
    statistic = np.minimum(statistic, CLEAREST)
    u2 = (v / size) ** 2
    four, six, eight = (float((u2**k).sum()) for k in (2, 3, 4))
    # of z, whose squares have the mean 1
    noise = np.maximum(1.0 - statistic / len(u2), LEAST_NOISE)
    V = np.maximum(noise * (1.0 - four) + statistic * four, 1e-12)
    fourth = 3.0 * noise**2 * (four - 2.0 * six + eight) + 6.0 * noise * statistic * (six - eight)
    alike = np.clip(fourth / V**2 + eight * (statistic / V) ** 2, 1e-9, 1.0)  # 1 / those that count
    q = float(np.sqrt(chi2_isf(LEVEL, 1)))
    edge = V * np.minimum((q - alike * (q**3 - 3.0 * q) / 12.0) ** 2, 1.0 / alike)
    return np.asarray(LEVEL / np.maximum(chi2_sf(edge, 1), 1e-300))
