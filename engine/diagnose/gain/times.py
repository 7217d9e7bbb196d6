"""Times that a search chose with all rows in view, as the rows that were not left out leave them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.estimation.quasi_ml import QuasiFit, log_likelihoods
from engine.filters.sigma_point import moment_filter
from engine.statespace.model import Array, MixedModel

SOUGHT_TIMES = 200  # rows at most that a time is sought at, coarsely and once more near the best
TIED = 1e-6  # by which the likelihoods of two times that tie may differ
NEGLIGIBLE = 10.0  # nats below the best, from which on a time is none that it may have been


@dataclass(frozen=True, eq=False)
class Times:
    """Values (K, n) that n parameters of ``places`` (n,) may have, and how likely each is (K,), in all 1.

    Of a step among rows left out the others do not tell at which of these: any one would be a guess, which the
    rows between the guess and the step pay for.
    """

    places: NDArray[np.intp]
    values: Array
    likely: Array

    def best(self, theta: Array) -> Array:
        """The parameters (n_theta,) with the most likely times; of those that tie, the one in the middle."""
        tied = self.values[self.likely >= (1.0 - TIED) * self.likely.max()]
        theta = theta.copy()
        theta[self.places] = np.sort(tied, axis=0)[len(tied) // 2]
        return theta

    def log_terms(self, fit: QuasiFit, series: Series, rows: NDArray[np.bool_]) -> Array:
        """Log-densities (T,) averaged over the times, as likely as earlier readings of ``rows`` leave them."""
        thetas = np.repeat(np.asarray(fit.theta)[None], len(self.likely), axis=0)
        thetas[:, self.places] = self.values
        terms = moment_filter(fit.model, thetas, series).log_terms
        terms = np.where(np.isnan(terms), -np.inf, terms)  # a filter that is lost predicts nothing
        so_far = np.cumsum(np.where(rows[:, None], terms, 0.0), axis=0) + np.log(self.likely)
        with np.errstate(invalid="ignore"):  # where all are lost
            return np.diff(np.logaddexp.reduce(so_far, axis=1), prepend=0.0)


def times_again(extended: QuasiFit, masked: Sequence[Series], names: Sequence[str]) -> Times:
    """Times that the search chose with all rows in view, sought again without those left out."""
    model, theta = extended.model, np.asarray(extended.theta)
    places = np.array([model.index(name) for name in names], dtype=np.intp)
    when = Times(places[:0], np.zeros((1, 0)), np.ones(1))
    for k in places:
        tried, likely = _sought(model, masked, when.best(theta), k)
        pairs = np.repeat(when.values, len(tried), axis=0), np.tile(tried, len(when.values))
        each = np.outer(when.likely, likely).ravel()
        top = np.argsort(-each, kind="stable")[:SOUGHT_TIMES]
        few = np.column_stack(pairs)[top], each[top] / each[top].sum()
        when = Times(places[: when.places.size + 1], *few)
    return when


def _sought(
    model: MixedModel, masked: Sequence[Series], theta: Array, k: int
) -> tuple[Array, Array]:
    """Times (n,) that parameter k may have, and how likely each is (n,): on few samples, then near the best."""
    near = every = np.unique(np.concatenate([one.t[one.samples] for one in masked]))
    for _ in range(2):
        some = np.linspace(0, len(near) - 1, min(SOUGHT_TIMES, len(near))).astype(int)
        tried = np.unique(np.clip([*near[some], theta[k]], model.lower[k], model.upper[k]))
        thetas = np.repeat(theta[None], len(tried), axis=0)
        thetas[:, k] = tried
        values = log_likelihoods(model, masked, thetas)
        values = np.nan_to_num(values, nan=-np.inf, posinf=-np.inf)  # where a filter is lost
        values = np.maximum(values, np.finfo(float).min)
        found = np.flatnonzero(values >= values.max() - NEGLIGIBLE)
        if len(some) == len(near):
            break
        first, last = tried[max(found[0] - 1, 0)], tried[min(found[-1] + 1, len(tried) - 1)]
        near = every[(every >= first) & (every <= last)]
    likely = np.exp(values[found] - values.max())
    return tried[found], likely / likely.sum()
