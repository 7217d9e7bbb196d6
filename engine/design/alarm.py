"""Whether a diagnosis will see something, from the statistic of its screen.

The diagnosis calibrates p-values that are near its level by a few simulated records
(:mod:`engine.diagnose.search.calibration`): their logarithms are divided by a boldness, which on few readings
is above 1, and by its own scatter too, for it is not let below 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

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

CALIBRATIONS = 300  # that are drawn
MOST_TESTS = 40  # of a calibration that is drawn
QUANTILES = 99


@dataclass(frozen=True)
class Alarm:
    """When a screen raises an alarm.

    ``threshold`` is the statistic that one test needs before it is calibrated.
    """

    threshold: float

    def raised(self, statistic: Array, v: Array, p: float, seed: int) -> NDArray[np.bool_]:
        """Which of the statistics (K,) of a screen raise one.

        ``v`` (N,) is the effect's footprint on N readings, p the number of fitted parameters.
        """
        N = float(len(v))
        tests = max(LEVEL / float(chi2_sf(self.threshold, 1)), 1.0)
        mean = logs(round(N), round(p))
        few, many = _drawn(round(tests, 1), round(20.0 * mean) / 20.0)
        pick = np.random.default_rng([seed, 1]).integers(CALIBRATIONS, size=len(statistic))
        single = np.maximum(chi2_sf(statistic, 1) * _heavier(statistic, v), 1e-300)
        clear = tests * single ** (1.0 / BOLDEST) <= LEVEL
        first, last = (tests * single ** (1.0 / b[pick]) for b in (few, many))
        open_ = (first < CLEARLY * LEVEL) & (first > LEVEL / CLEARLY)
        said = np.where(open_, last, first) <= LEVEL
        return np.asarray((tests * single <= LEVEL) & (clear | said))


def _heavier(statistic: Array, v: Array) -> Array:
    """How much heavier than chi2 the tail of multiplier draws is that keep the size of every reading's score.

    Of scores v_t z_t, z_t = e_t + size v_t, random signs make sums with the variance sum v_t^2 z_t^2, and not
    sum v_t^2: more by (statistic - 1) sum v_t^4 / (sum v_t^2)^2, as a share. An effect that few readings show
    is seen with care (:mod:`engine.diagnose.screening.screen`).
    """
    power = float((v**2).sum())
    share = float((v**4).sum()) / power**2 if power > 0.0 else 0.0
    usual = float(chi2_isf(LEVEL, 1))
    edge = usual * (1.0 + np.maximum(statistic - 1.0, 0.0) * share)
    edge = np.minimum(edge, np.maximum(statistic, usual))  # where all signs agree
    heavier = LEVEL / np.maximum(chi2_sf(edge, 1), 1e-300)
    return np.where(heavier > CLEARLY_HEAVIER, heavier, 1.0)


@lru_cache(maxsize=256)
def logs(N: int, p: int) -> float:
    """Mean of -log p of a test on N readings, whose noise and p parameters are estimated from the same."""
    left = max(N - p - 1, 1)
    share = betaincinv(0.5, 0.5 * left, (np.arange(QUANTILES) + 0.5) / QUANTILES)
    exact = -np.log1p(-(np.arange(QUANTILES) + 0.5) / QUANTILES).mean()
    return float(np.mean(-np.log(chi2_sf(N * share, 1))) / exact)


@lru_cache(maxsize=256)
def _drawn(tests: float, mean: float) -> tuple[Array, Array]:
    """Boldness (CALIBRATIONS,) after the fewest and after all simulated records, -log p having this mean."""
    rng = np.random.default_rng(0)
    n = int(min(max(round(tests), 1), MOST_TESTS))
    few, many = np.empty(CALIBRATIONS), np.empty(CALIBRATIONS)
    expected = np.full(SERIES, rng.exponential(size=(499, n)).max(axis=1).mean())
    for k in range(CALIBRATIONS):
        x = mean * rng.exponential(size=(SERIES, n))
        few[k] = boldness(x[:FEWEST], expected[:FEWEST])[0]
        many[k] = boldness(x, expected)[0]
    return few, many
