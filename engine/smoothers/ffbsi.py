"""FFBSi on the full state x = (a, z), without Rao-Blackwellization (Godsill, Doucet, West 2004).

It is Algorithm 3 of the report with empty z: the same kernels, one call for the whole backward pass.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.filters.particle import ParticleFiltered
from engine.randomness import Rng, generator
from engine.smoothers.moments import Moments
from engine.smoothers.rb_ffbsi import rb_ffbsi
from engine.statespace.model import Array
from engine.views import Shown


@dataclass(frozen=True, eq=False)
class ParticleSmoothed(Shown):
    """N equally weighted draws of x_{1:T} given y_{1:T}; ``a`` (T, N, na) and ``z`` (T, N, nz) are their parts.

    Attributes
    ----------
    filtered : ParticleFiltered
        The pass forward.
    trajectories : array (T, N, nx)
        Whole draws of the states x = (a, z).
    index : array (T, N)
        Number of the filter particle that each point is.
    """

    filtered: ParticleFiltered
    trajectories: Array
    index: NDArray[np.int64]

    @property
    def a(self) -> Array:
        """Nonlinear states (T, N, na)."""
        return self.trajectories[:, :, : self.filtered.model.na]

    @property
    def z(self) -> Array:
        """Linear states (T, N, nz)."""
        return self.trajectories[:, :, self.filtered.model.na :]

    @property
    def moments(self) -> Moments:
        """The draws as the moments an E step takes: P = 0 and M = 0."""
        T, nz = len(self.trajectories), self.filtered.model.nz
        zero = np.zeros((T, 1, nz, nz))
        return Moments(self.a, self.z, zero, zero[1:])

    def mean(self) -> Array:
        """Smoothed mean of x (T, nx)."""
        return np.asarray(self.trajectories.mean(axis=1))

    def std(self) -> Array:
        """Smoothed standard deviation of x (T, nx)."""
        return np.asarray(self.trajectories.std(axis=1))


def ffbsi(filtered: ParticleFiltered, n_trajectories: int, rng: Rng) -> ParticleSmoothed:
    """Draw trajectories of x by backward simulation (Godsill, Doucet, West 2004).

    Parameters
    ----------
    filtered : ParticleFiltered
        A pass of :func:`particle_filter`.
    n_trajectories : int
        Number of trajectories N that are drawn, each of weight 1/N.
    rng : numpy.random.Generator or int
        Source of all random numbers, or the seed of one.

    Returns
    -------
    ParticleSmoothed
        ``trajectories`` (T, N, nx) of x_{1:T} given y_{1:T}.

    Raises
    ------
    OptionError
        ``n_trajectories`` is no positive whole number.
    """
    rng = generator(rng)
    draws = rb_ffbsi(filtered.filtered, n_trajectories, rng)
    return ParticleSmoothed(filtered, draws.a, draws.index)
