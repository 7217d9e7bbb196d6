"""A state without memory that only scales noise: what a filter of moments must be told to see it.

Given such a state the noise is Gaussian, so a few of its values stand for all of them: its distribution is cut
into strata, each with the value in its middle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri


@dataclass(frozen=True, eq=False)
class RandomScale:
    """The nonlinear ``state`` g ~ N(mean, 1), drawn anew at every time and independent of all others.

    ``propose(step)`` draws it and the other nonlinear states, see :mod:`engine.filters.proposals`.
    ``mean(values)`` and ``edges(values)`` (J + 1,) of strata of Phi(g - mean) from 0 to 1, for the values of
    the ``parameters`` with these names.
    """

    state: str
    parameters: tuple[str, ...]
    mean: Callable[[Any], Any]
    edges: Callable[[Any], NDArray[np.float64]]
    propose: Callable[[Any], tuple[NDArray[np.float64], NDArray[np.float64]]]

    def strata(self, values: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """g in the middle of each stratum (J,), and how probable that is (J,)."""
        edges = np.asarray(self.edges(values))
        middle = ndtri(0.5 * (edges[1:] + edges[:-1]))
        return np.asarray(float(self.mean(values)) + middle), np.diff(edges)
