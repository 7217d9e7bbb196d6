"""Exact moments of z given whole trajectories of a: the smoother without Approximations 1 and 2.

The a of :func:`engine.rb_ffbsi` with ``joint=True`` are draws of p(a_{1:T} | y_{1:T}). Given such a
trajectory, z is linear Gaussian, so a Kalman smoother gives E(z_t), P_{t|T} and M_{t|T} exactly
(Lindsten, Bunch, Sarkka, Schon, Godsill 2016). RBPS-EM uses these moments by default: they cost
no more than Algorithm 3 and have no bias that stays as M grows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from engine.kernels.conditional import smooth_along
from engine.smoothers.rb_ffbsi import Smoothed
from engine.statespace.model import Array
from engine.statespace.points import Points
from engine.statespace.refutation import repeated_if_refuted


@repeated_if_refuted
def condition_on_trajectories(smoothed: Smoothed, points: Points | None = None) -> Smoothed:
    """Replace the moments of Algorithm 3 by those of z given each whole trajectory.

    Parameters
    ----------
    smoothed : Smoothed
        Trajectories of a, drawn with ``joint=True`` to be exact.
    points : Points, optional
        The trajectories as evaluation points of the model, where they were made before; made here by default.

    Returns
    -------
    Smoothed
        The same trajectories with exact ``z`` (T, N, nz), ``P`` and ``M``.

    Raises
    ------
    ModelError
        A function of the model fails on the trajectories; names the function and the time.
    """
    filtered = smoothed.filtered
    model, series = filtered.model, filtered.series
    if points is None:
        points = Points(model, series, smoothed.a)
    record = model.record(filtered.theta)
    T = points.T
    f, A, Q = points.transition(record)
    h, C, R = points.observation(record)
    z1, P1 = model.start(record).linear(points.a[0])
    z, P, M = smooth_along(
        points.a,
        f,
        _every(A, T - 1),
        _every(Q, T - 1),
        h,
        _every(C, T),
        _every(R, T),
        z1,
        P1 if P1.ndim == 3 else P1[None],
        np.array(series.y),
    )
    return replace(smoothed, z=z, cov=P, cross=M)


def _every(matrix: Array, T: int) -> Array:
    """A leading time axis of full length; repeated in memory, as kernels want one layout."""
    return np.array(np.broadcast_to(matrix, (T, *matrix.shape[1:])), order="C")
