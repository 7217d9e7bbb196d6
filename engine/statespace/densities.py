"""Noise densities that are not Gaussian; independent components, each with its own scale.

Together with :class:`engine.Gaussian` they serve wherever a :class:`engine.statespace.model.Density` is asked
for: v_t and e_t of poster, eq. (1), and the density of the first state.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaln, logsumexp

from engine.errors import ModelError
from engine.statespace.model import Array

TINY = np.finfo(float).tiny
GAUSSIAN = 1e8  # degrees of freedom from which a Student-t density is one to rounding


@dataclass(frozen=True)
class StudentT:
    """Independent Student-t components of mean 0.

    Parameters
    ----------
    scale : array (n,) or float
        Scales; the variance is scale^2 nu / (nu - 2) for nu > 2.
    nu : float
        Degrees of freedom, positive.

    Raises
    ------
    ModelError
        If a scale or the degrees of freedom are not positive, finite numbers.
    """

    scale: Array
    nu: float

    def __init__(self, scale: ArrayLike, nu: float) -> None:
        object.__setattr__(self, "scale", np.atleast_1d(np.asarray(scale, dtype=float)))
        object.__setattr__(self, "nu", float(nu))
        if self.scale.ndim != 1:
            raise ModelError(
                f"a StudentT needs a list of scales; it has the shape {self.scale.shape}"
            )
        _check("StudentT", "scale", self.scale)
        _check("StudentT", "nu", np.atleast_1d(self.nu))

    def sample(self, rng: np.random.Generator, n: int) -> Array:
        """Draw n independent points, (n, len(scale))."""
        return np.asarray(rng.standard_t(self.nu, (n, self.scale.size)) * self.scale)

    def log_density(self, e: Array) -> Array:
        """Logarithm of the density (K,) at points e (K, n)."""
        nu = self.nu
        c = -0.5 * np.log(2.0 * np.pi)  # of a Gaussian; its terms cancel below
        if nu < GAUSSIAN:
            c = gammaln(0.5 * (nu + 1.0)) - gammaln(0.5 * nu) - 0.5 * np.log(nu * np.pi)
        each = c - np.log(self.scale) - 0.5 * (nu + 1.0) * np.log1p((e / self.scale) ** 2 / nu)
        return np.asarray(each.sum(axis=1))


@dataclass(frozen=True)
class GaussianMixture:
    """Independent components, each the same mixture of k normal densities.

    Parameters
    ----------
    shares : array (k,)
        Probabilities of the normal densities; scaled to the sum 1.
    means : array (k,)
        Expected value of each normal density.
    sds : array (k,)
        Standard deviation of each normal density, positive.
    n : int
        Number of independent components.

    Raises
    ------
    ModelError
        If the lists are not equally long, a share is negative or none is positive, a standard deviation is not
        positive, or a number is not finite.
    """

    shares: Array
    means: Array
    sds: Array
    n: int = 1

    def __init__(self, shares: ArrayLike, means: ArrayLike, sds: ArrayLike, n: int = 1) -> None:
        weights, centres, widths = (np.asarray(x, dtype=float) for x in (shares, means, sds))
        if weights.ndim != 1 or not weights.shape == centres.shape == widths.shape:
            raise ModelError(
                "a GaussianMixture needs shares, means and sds that are lists of the same length; "
                f"they have {weights.shape}, {centres.shape} and {widths.shape}"
            )
        _check("GaussianMixture", "means", centres, least=-np.inf)
        _check("GaussianMixture", "sds", widths)
        _check("GaussianMixture", "shares", weights, least=-TINY)
        _check("GaussianMixture", "sum of the shares", np.atleast_1d(weights.sum()))
        object.__setattr__(self, "shares", weights / weights.sum())
        object.__setattr__(self, "means", centres)
        object.__setattr__(self, "sds", widths)
        object.__setattr__(self, "n", n)

    def sample(self, rng: np.random.Generator, n: int) -> Array:
        """Draw n independent points, (n, self.n)."""
        which = np.searchsorted(np.cumsum(self.shares)[:-1], rng.random((n, self.n)), side="right")
        return np.asarray(self.means[which] + self.sds[which] * rng.standard_normal((n, self.n)))

    @property
    def mean(self) -> Array:
        """Expected value (n,)."""
        return np.full(self.n, float(self.shares @ self.means))

    @property
    def cov(self) -> Array:
        """Covariance (n, n)."""
        around = self.means - self.shares @ self.means
        return float(self.shares @ (self.sds**2 + around**2)) * np.eye(self.n)

    def log_density(self, e: Array) -> Array:
        """Logarithm of the density (K,) at points e (K, n)."""
        r = (e[:, :, None] - self.means) / self.sds
        each = -0.5 * r**2 - np.log(self.sds * np.sqrt(2.0 * np.pi))
        return np.asarray(logsumexp(each, axis=2, b=self.shares).sum(axis=1))


def _check(density: str, name: str, values: Array, least: float = 0.0) -> None:
    """Raise ModelError unless all values are finite and above the least."""
    if np.isfinite(values).all() and (values > least).all():
        return
    needed = {-np.inf: "finite", 0.0: "finite and positive"}.get(least, "finite and not negative")
    raise ModelError(
        f"a {density} was given {name} = {values.tolist()}; every one must be {needed}. "
        "If it comes from a parameter, bound this one",
        numeric=True,
    )
