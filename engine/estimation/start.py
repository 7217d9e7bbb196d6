"""Where EM should start: the maximum of the moment filter's likelihood, found in a second or so.

EM contracts slowly and stays in the basin it starts in. The moment filter's likelihood is smooth and
cheap, so it is searched first: by scoring from the start values, and from the best of many points
around them. It is an approximation, so what it finds is only ever a start.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.errors import ModelError
from engine.estimation.expectation import parameter_scale
from engine.estimation.quasi_ml import log_likelihoods, quasi_ml
from engine.filters.sigma_point import free_thetas
from engine.statespace.model import Array, MixedModel, Theta

SEARCHED_ROWS = 2000  # of each series, at most, are searched
CANDIDATES = 96  # points around the start values ...
REACH_SIZES = 2.0  # ... this many sizes of each parameter away at most, within its bounds
FAR_NATS = 20.0  # EM leaves from theta0 unless it is less likely than the maximum by this much
IMPROVED_CANDIDATES = 4  # of the candidates are improved, besides the start values themselves,
SHORT_ITERATIONS = 6  # iterations each; the best of them is then followed to its maximum


class WarmStart:
    """:func:`moment_maximum` for a theta; ``note`` says why where it found nothing."""

    def __init__(
        self, model: MixedModel, all_series: Sequence[Series], indices: NDArray[np.intp]
    ) -> None:
        self.model, self.all_series, self.indices = model, all_series, indices
        self.note = ""

    def __call__(self, theta: Theta) -> Theta | None:
        """The most likely parameters found, or None with a ``note``."""
        try:
            return moment_maximum(self.model, self.all_series, self.indices, theta)
        except (ModelError, np.linalg.LinAlgError) as error:
            self.note = (
                f"EM left from the start values; no better start could be looked for: {error}"
            )
            return None


def moment_maximum(
    model: MixedModel, all_series: Sequence[Series], indices: NDArray[np.intp], theta: Theta
) -> Theta:
    """The most likely parameters found. Raises ModelError where the moment filter cannot follow the model.

    Deterministic: the candidates are always the same for the same start.
    """
    all_series = [
        one if len(one) <= SEARCHED_ROWS else one.part(0, SEARCHED_ROWS) for one in all_series
    ]
    names = [model.parameter_names[k] for k in indices]
    candidates = free_thetas(theta, indices, _around(model, theta, indices))
    values = log_likelihoods(model, all_series, candidates)
    order = np.argsort(values)[::-1]
    found = []
    lost: Exception | None = None
    for start in (np.asarray(theta), *candidates[order[:IMPROVED_CANDIDATES]]):
        try:
            found.append(quasi_ml(model, all_series, start, names, SHORT_ITERATIONS))
        except (ModelError, np.linalg.LinAlgError) as error:
            lost = lost or error
    if not found and lost is not None:
        raise lost
    best = max(found, key=lambda fit: fit.log_likelihood)
    return best.theta if best.converged else quasi_ml(model, all_series, best.theta, names).theta


def _around(model: MixedModel, theta: Theta, indices: NDArray[np.intp]) -> Array:
    """Points (CANDIDATES, n) spread evenly over a box around theta."""
    x = np.asarray(theta)[indices]
    reach = REACH_SIZES * np.array([parameter_scale(model, theta, k) for k in indices])
    low: Array = np.maximum(x - reach, model.lower[indices])
    high: Array = np.minimum(x + reach, model.upper[indices])
    share: Array = np.random.default_rng(0).random((CANDIDATES, len(indices)))
    return low + share * (high - low)
