"""Bootstrap particle filter on the full state x = (a, z), without Rao-Blackwellization.

The baseline of the report, section 6, and of PS-EM, paper, section V. A mixed model all of whose
states count as nonlinear is again a mixed model, so the filter is Algorithm 2 of the report with
nothing left to marginalize.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.data.series import Series
from engine.filters.proposals import Proposal
from engine.filters.rbpf import Filtered, rbpf
from engine.randomness import Rng, generator
from engine.statespace.model import Array, MixedModel, Theta, ThetaLike
from engine.statespace.promotion import as_nonlinear
from engine.threads import single_threaded
from engine.views import Shown


@dataclass(frozen=True, eq=False)
class ParticleFiltered(Shown):
    """The result of a particle filter.

    ``x`` (T, M, nx) are the particles of x = (a, z), ``weights`` (T, M) theirs before resampling;
    ``log_likelihood`` and ``ess`` (T,) as of :class:`engine.Filtered`.

    Attributes
    ----------
    model : MixedModel or NonlinearModel
        The model that was filtered with.
    filtered : Filtered
        The pass of Algorithm 2 on the same model with empty z.
    """

    model: MixedModel
    filtered: Filtered

    @property
    def theta(self) -> Theta:
        """Parameters of the pass."""
        return self.filtered.theta

    @property
    def series(self) -> Series:
        """The data."""
        return self.filtered.series

    @property
    def x(self) -> Array:
        """Particles (T, M, nx)."""
        return self.filtered.a

    @property
    def a(self) -> Array:
        """Nonlinear states (T, M, na)."""
        return self.x[:, :, : self.model.na]

    @property
    def z(self) -> Array:
        """Linear states (T, M, nz)."""
        return self.x[:, :, self.model.na :]

    @property
    def weights(self) -> Array:
        """Normalised weights (T, M)."""
        return self.filtered.weights

    @property
    def log_likelihood(self) -> float:
        """Estimate of log p(y_{1:T})."""
        return self.filtered.log_likelihood

    @property
    def ess(self) -> Array:
        """Effective sample size (T,)."""
        return self.filtered.ess

    @property
    def collapsed(self) -> NDArray[np.intp]:
        """Rows at which the weights collapsed onto one particle."""
        return self.filtered.collapsed

    def mean(self) -> Array:
        """Filtered mean of x (T, nx)."""
        return self.filtered.mean()


@single_threaded
def particle_filter(
    model: MixedModel,
    theta: ThetaLike,
    series: Series,
    n_particles: int,
    rng: Rng,
    proposal: str | Proposal = "bootstrap",
    resampling: str = "multinomial",
    ess_threshold: float = 1.0,
) -> ParticleFiltered:
    """Filter x = (a, z) by the bootstrap particle filter (Gordon, Salmond, Smith 1993).

    The defaults are the report's, section 6: the transition density as proposal, and resampling at every
    time step.

    Parameters
    ----------
    model : MixedModel
        The model, paper, eq. (1).
    theta : Theta, mapping, array or None
        Parameters: all as (n_theta,), some by name, or None for the model's defaults.
    series : Series
        The data: y (T, ny) with NaN where missing, u (T, nu), times.
    n_particles : int
        Number of particles M.
    rng : numpy.random.Generator or int
        Source of all random numbers, or the seed of one.
    proposal : str or callable
        Density that new particles are drawn from, as for :func:`rbpf`; the report's is ``bootstrap``.
    resampling : str
        ``multinomial``, ``stratified``, ``systematic``, ``residual`` or ``sorted``, as for :func:`rbpf`.
    ess_threshold : float
        Resample where the effective sample size is at most this share of M (1: at every step, 0: never).

    Returns
    -------
    ParticleFiltered
        Particles ``x`` (T, M, nx) with their weights, and the log-likelihood.

    Raises
    ------
    OptionError
        An option is not known or out of its range; ``field`` names it.
    SeriesError
        Channels or units are not the model's, or nothing was measured; names the channel.
    ModelError
        A function of the model fails, or returns a wrong shape or covariance; names the function and the time.
    """
    rng = generator(rng)
    full = as_nonlinear(model)
    filtered = rbpf(full, theta, series, n_particles, rng, proposal, resampling, ess_threshold)
    return ParticleFiltered(model, filtered)
