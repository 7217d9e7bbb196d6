"""What rounding says of the noise of readings: it is not below that of the rounding.

Readings in steps are often exactly alike. A usual noise of next to nothing beside a share of large ones then
makes each such pair as likely as one pleases, and outliers explain anything. So that noise is kept at what
rounding adds, a twelfth of the squared step; where the model as fitted has less, at that.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from engine.data.lattice import lattice_step
from engine.data.series import Series
from engine.statespace.model import Array, MixedModel, ThetaLike, stacked


def below_rounding(
    model: MixedModel, theta: ThetaLike, series: Series, at: Array
) -> Callable[[Array], Array] | None:
    """Nats to be taken from the log-likelihoods of thetas (K, n_theta), or None where no readings are in steps.

    A spike gains half a nat per reading and e-fold of the variance, and so never as much as it loses. ``at``
    is a state (na,) of the model, at the first reading.
    """
    steps = [lattice_step(y[np.isfinite(y)]) for y in series.y.T]
    rounding = np.array([0.0 if step is None else step * step / 12.0 for step in steps])
    first = int(np.argmax(series.observed.any(axis=1)))
    u, t = series.u[first], float(series.t[first])

    def noise(one: Array) -> Array:
        R = model.observation(at[None], u, t, model.record(one))[2]
        return np.asarray(np.diagonal(stacked(R)[0]), float)

    floor = np.minimum(rounding, noise(np.asarray(theta, float)))
    if not (floor > 0.0).any():
        return None
    many = series.observed.sum(axis=0)

    def lost(thetas: Array) -> Array:
        found, which = np.unique(thetas, axis=0, return_inverse=True)
        ratios = [floor / np.maximum(noise(one), 1e-300) for one in found]
        each = [float(many @ np.log(np.maximum(ratio, 1.0))) for ratio in ratios]
        return np.array(each)[np.ravel(which)]

    return lost
