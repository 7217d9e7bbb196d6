"""The Rao-Blackwellized forward filter backward simulator; report, Algorithm 3."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.errors import check_count
from engine.filters.rbpf import Filtered
from engine.kernels.backward import backward_simulation
from engine.kernels.resampling import stratified
from engine.randomness import Rng, generator
from engine.statespace.model import Array
from engine.statespace.points import Points
from engine.threads import single_threaded
from engine.views import Figures, Shown, View, figures, plots, sheet, tables


@dataclass(frozen=True, eq=False)
class Smoothed(Shown):
    """N backward trajectories, each of weight 1/N.

    ``cov`` and ``cross`` are moments of z given the trajectory, with an axis of length 1 in place of N where
    all trajectories share them. ``P`` (T, N, nz, nz) and ``M`` (T-1, N, nz, nz) are the full views.

    Attributes
    ----------
    filtered : Filtered
        The pass forward.
    a : array (T, N, na)
        Nonlinear states.
    z : array (T, N, nz)
        Means z_{t|T} of the linear states.
    cov : array (T, N or 1, nz, nz)
        Covariances P_{t|T} of z.
    cross : array (T-1, N or 1, nz, nz)
        Covariances M_{t|T} of z with the z of the next row.
    index : array (T, N)
        Number of the filter particle that each point is.
    trajectories : array (T, N, nx) or None
        Whole joint draws of x = (a, z).
    """

    filtered: Filtered
    a: Array
    z: Array
    cov: Array
    cross: Array
    index: NDArray[np.int64]
    trajectories: Array | None = None

    @property
    def P(self) -> Array:
        """P_{t|T}^j (T, N, nz, nz)."""
        T, N, nz = self.z.shape
        return np.broadcast_to(self.cov, (T, N, nz, nz))

    @property
    def M(self) -> Array:
        """M_{t|T}^j = Cov(z_t, z_{t+1}) given the trajectory (T-1, N, nz, nz)."""
        T, N, nz = self.z.shape
        return np.broadcast_to(self.cross, (T - 1, N, nz, nz))

    def mean(self) -> Array:
        """Smoothed mean of x = (a, z), (T, nx)."""
        return np.concatenate([self.a.mean(axis=1), self.z.mean(axis=1)], axis=1)

    def std(self) -> Array:
        """Smoothed standard deviation of x = (a, z), (T, nx)."""
        variance = self.z.var(axis=1) + np.diagonal(self.cov, axis1=2, axis2=3).mean(axis=1)
        return np.concatenate([self.a.std(axis=1), np.sqrt(np.maximum(variance, 0.0))], axis=1)

    def outputs(self) -> Array:
        """Smoothed mean (T, ny) of h(a) + C(a) z: what the outputs were but for e."""
        model, theta = self.filtered.model, self.filtered.theta
        points = Points(model, self.filtered.series, self.a)
        h, C, _ = points.observation(model.record(theta))
        return np.asarray((h + (C @ self.z[..., None])[..., 0]).mean(axis=1))

    def plot(self) -> Figures:
        """``states`` with 95 % bands, ``residuals``: measured against smoothed outputs.

        Needs the extra ``plot``.
        """
        model, series = self.filtered.model, self.filtered.series
        units, clock = {**model.nonlinear, **model.linear}, series.time_unit
        return figures(
            states=plots().states(series.t, units, self.mean(), self.std(), clock),
            residuals=plots().against_data(
                series.t, model.outputs, series.y, self.outputs(), "smoothed", clock=clock
            ),
        )

    def _view(self) -> View:
        model = self.filtered.model
        units = {**model.nonlinear, **model.linear}
        numbers = zip(
            *(
                f(x, axis=0).tolist()
                for x, f in ((self.mean(), np.min), (self.mean(), np.max), (self.std(), np.mean))
            ),
            strict=True,
        )
        rows = [
            (name, *row, unit) for (name, unit), row in zip(units.items(), numbers, strict=True)
        ]
        return sheet(
            f"{model.name}: {len(self.a)} samples smoothed by {self.a.shape[1]} trajectories",
            tables().line(f"Log-likelihood of the filter {self.filtered.log_likelihood:.2f}"),
            tables().line(self.filtered.note),
            tables().table(("state", "least", "most", "mean sd", "unit"), rows),
        )


@single_threaded
def rb_ffbsi(
    filtered: Filtered,
    n_trajectories: int,
    rng: Rng,
    joint: bool = False,
) -> Smoothed:
    """Draw backward trajectories; report, Algorithm 3.

    The moments ``z``, ``P`` and ``M`` are those of the report, eqs. (61), under its Approximations 1 and 2. The
    second leaves a bias in P and M that does not vanish as the number of particles grows. Use
    :func:`condition_on_trajectories`, which turns joint trajectories into exact moments of z.

    Parameters
    ----------
    filtered : Filtered
        A pass of :func:`rbpf`.
    n_trajectories : int
        Number of trajectories N that are drawn, each of weight 1/N.
    rng : numpy.random.Generator or int
        Source of all random numbers, or the seed of one.
    joint : bool
        Whether drawn z~ are chained into whole trajectories of (a, z) from the joint smoothing density, which
        converge to exact draws as the number of particles grows.

    Returns
    -------
    Smoothed
        ``a`` (T, N, na) with moments ``z`` (T, N, nz), ``P`` and ``M`` of z.

    Raises
    ------
    OptionError
        ``n_trajectories`` is no positive whole number.
    """
    rng = generator(rng)
    check_count("n_trajectories", n_trajectories)
    T, N, nz = len(filtered.a), n_trajectories, filtered.z.shape[2]
    index, z, P, M, draws = backward_simulation(
        filtered.a,
        filtered.z,
        filtered.root,
        filtered.log_weights,
        filtered.mu,
        filtered.L,
        filtered.V,
        filtered.root_plus,
        filtered.ancestors,
        stratified(filtered.weights[-1], rng.random(N)),
        rng.random((T - 1, N)),
        rng.standard_normal((T, N, nz)),
        joint,
    )
    a = np.take_along_axis(filtered.a, index[:, :, None], axis=1)
    trajectories = np.concatenate([a, draws], axis=2) if joint else None
    return Smoothed(filtered, a, z, P, M, index, trajectories)
