"""Whether a diagnosis will see something, from the statistic of its screen.

The diagnosis calibrates p-values that are near its level by a few simulated records
(:mod:`engine.diagnose.search.calibration`): their logarithms are divided by a boldness, which on few readings
is above 1, and by its own scatter too, for it is not let below 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

from engine.data.series import Series
from engine.design.candidates import Candidate
from engine.diagnose.effects.setting import setting_for
from engine.diagnose.search.calibration import (
    BOLDEST,
    CLEARLY,
    FEWEST,
    LEVEL,
    PRIOR,
    SERIES,
    Question,
    boldness,
    simulated_logs,
)
from engine.distributions import chi2_sf
from engine.errors import EngineError
from engine.estimation.quasi_ml import quasi_ml
from engine.simulation.simulate import simulate
from engine.statespace.model import Array

CALIBRATIONS = 300  # that are drawn
MOST_TESTS = 40  # of a calibration that is drawn
QUANTILES = 99
RECORDS = 12  # that are simulated


@dataclass(frozen=True)
class Alarm:
    """When a screen raises an alarm.

    ``threshold`` is the statistic that one test needs before it is calibrated. The mean of -log p where there
    is nothing to see is 1 + ``excess`` / N in N readings, from simulated records, or more by :func:`logs`.
    """

    threshold: float
    excess: float = 0.0

    def raised(self, statistic: Array, N: float, p: float, seed: int) -> NDArray[np.bool_]:
        """Which of the statistics (K,) of a screen of N readings and p fitted parameters raise one."""
        tests = max(LEVEL / float(chi2_sf(self.threshold, 1)), 1.0)
        mean = max(logs(round(N), round(p)), 1.0 + self.excess / max(N, 1.0))
        few, many = _drawn(round(tests, 1), round(20.0 * mean) / 20.0)
        pick = np.random.default_rng([seed, 1]).integers(CALIBRATIONS, size=len(statistic))
        single = np.maximum(chi2_sf(statistic, 1), 1e-300)
        clear = tests * single ** (1.0 / BOLDEST) <= LEVEL
        first, last = (tests * single ** (1.0 / b[pick]) for b in (few, many))
        open_ = (first < CLEARLY * LEVEL) & (first > LEVEL / CLEARLY)
        said = np.where(open_, last, first) <= LEVEL
        return np.asarray((tests * single <= LEVEL) & (clear | said))


def excess(candidates: Sequence[Candidate], base: Candidate, blank: Series, seed: int) -> float:
    """The ``excess`` of an :class:`Alarm`: each cause's record of an input, and one of the base fitted to it.

    ``blank`` has the input, and 0 where there will be readings, NaN where not.
    """
    names = [name for c in candidates for name in c.name.split(" + ")]
    logs_: list[Array] = []
    for k in range(RECORDS):
        true = candidates[k % len(candidates)]
        rng = np.random.default_rng([seed, k])
        try:
            drawn = simulate(
                true.model, true.theta, len(blank), rng, blank.u, t=blank.t, hold=blank.hold
            ).y
            record = blank.replace(y=np.where(blank.observed, drawn, np.nan))
            fit = quasi_ml(base.model, record, base.theta, base.free)
            asked = Question(fit, record, setting_for(base.model, record, fit.theta), names)
        except (EngineError, np.linalg.LinAlgError):
            continue
        row = simulated_logs(asked, names, [seed, k])
        if row is not None and not np.isnan(row[:-1]).all():
            logs_.append(row[:-1][~np.isnan(row[:-1])])
    n = len(logs_)
    if not n:
        return 0.0
    mean = (PRIOR + float(sum(row.mean() for row in logs_))) / (PRIOR + n)
    return max(mean - 1.0, 0.0) * float(blank.observed.sum())


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
