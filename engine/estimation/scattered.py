"""Iterates that show no trend because the filters behind them lose the series now and then.

Of a state with two likely values few particles may be left at the wrong one for many rows. The scores of such a
filter lead elsewhere, in turn up and down, and their mean is no maximum. The moment filter, which takes such a
state for Gaussian, does not see it; the log-likelihoods of the filters themselves do.
"""

from __future__ import annotations

from engine.estimation.em_result import EmResult
from engine.estimation.outcome import Outcome
from engine.estimation.wandering import undecided
from engine.filters.lost import nats_apart

FALLEN_SHARE = 0.1  # of the last filters; one alone moves their mean by little
FELL = (
    " The filters of {} of the last {} iterations ended more than {:.0f} nats below the likeliest of them, "
    "next to the same parameters: {} particles lose the series now and then, and the steps after that lead "
    "away. Take more particles, until the log-likelihoods of the last iterations agree."
)


def filters_that_fell(found: EmResult, last: int, rows: int, n_particles: int) -> EmResult:
    """The settled result, said to be undecided where filters of its ``last`` iterations lost the series.

    Log-likelihoods of filters that follow all ``rows`` differ by less than
    :func:`engine.filters.lost.nats_apart`.
    """
    if found.outcome is not Outcome.CONVERGED or not last or not found.free:
        return found
    values, apart = found.log_likelihood[-last:], nats_apart(rows, float(found.ess[-last:].mean()))
    fell = int((values < values.max() - apart).sum())
    if not fell > max(1.0, FALLEN_SHARE * last):  # values that are not finite are none that fell
        return found
    return undecided(found, FELL.format(fell, last, apart, n_particles))
