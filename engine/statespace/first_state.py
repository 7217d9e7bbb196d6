"""The moments of the first state x_1 = (a_1, z_1), where a record begins."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.kernels.gaussian import any_impossible
from engine.kernels.moments import sigma_points, transform
from engine.statespace.densities import GaussianMixture
from engine.statespace.model import Array, Gaussian, MixedModel


def moments_of_first(model: MixedModel, record: Any) -> tuple[Array, Array]:
    """Mean (nx,) and covariance (nx, nx) of x_1, z_{1|0}(a_1) by sigma points.

    Both are NaN where a covariance that was given is none.
    """
    start = model.start(record)
    na, nz = model.na, model.nz
    density = start.density
    if isinstance(density, Gaussian | GaussianMixture):
        mean, cov = density.mean, density.cov
    else:
        draws = density.sample(np.random.default_rng(0), 2000)
        mean, cov = draws.mean(axis=0), np.cov(draws.T).reshape(na, na)
    m = np.concatenate([mean, np.zeros(nz)])[None]
    P = np.zeros((1, na + nz, na + nz))
    P[0, :na, :na] = cov
    lost = any_impossible(P)
    a, z, V, offsets = sigma_points(m, P, na)
    z1, P1 = start.linear(a[0])
    f = np.concatenate([a[0], z1], axis=1)
    Q = np.zeros((len(f), na + nz, na + nz))
    Q[:, na:, na:] = P1
    mean, cov, _ = transform(f, np.zeros((1, na + nz, nz)), Q, z, V, offsets, na)
    if lost:
        mean[:], cov[:] = np.nan, np.nan
    return mean[0], cov[0]
