"""How near free runs come to series that nothing but noise leads astray, once they are fitted to them.

The parameters of a free run bend towards a record that process noise led away, further than a first-order
projection tells where this noise is large. So where a run is nearer to its record than the projection allows,
series are simulated with the noise of the likelihood's fit, and free runs fitted to them as to the record
(a parametric bootstrap).
"""

from __future__ import annotations

import numpy as np

from engine.data.series import Series
from engine.diagnose.free_run_fits.columns import CANNOT
from engine.diagnose.free_run_fits.fitted import Fitted, fit_runs
from engine.simulation.simulate import propagate
from engine.statespace.model import Array, ThetaLike

MOST = 99  # series that are refitted; a level that asks for more is not reached so
VALUES = 5000  # of the residuals: to longer records so many fits take too long


def can_refit(fit: Fitted, n: int) -> bool:
    """Whether n series like the fit's records can be refitted in reasonable time."""
    return n <= MOST and fit.e.size <= VALUES


def as_near(fit: Fitted, ahead: ThetaLike, n: int, level: float, seed: int) -> int:
    """How many of n series have refits as near as ``fit`` is, asked for until their share is above ``level``.

    ``ahead`` is the likelihood's own fit, from which they are simulated, from the first states of ``fit`` on. A
    series that cannot be refitted counts: nobody knows how near that would have come.
    """
    reached = 0
    for k in range(n):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(78, k)))
        drawn = [
            _drawn(fit, ahead, one, x1, rng) for one, x1 in zip(fit.records, fit.x1, strict=True)
        ]
        if not all(np.isfinite(one.y[one.observed]).all() for one in drawn):
            continue  # what runs away is not near
        try:
            near = fit_runs(fit.model, drawn, fit.model.theta(ahead), fit.free, fit.x1)
            reached += not _rms(near, fit) > fit.rms
        except CANNOT:
            reached += 1
        if (1 + reached) > level * (1 + n):
            break
    return reached


def _drawn(
    fit: Fitted, ahead: ThetaLike, one: Series, x1: Array, rng: np.random.Generator
) -> Series:
    """A series with the inputs, times and gaps of ``one``, from x1 (nx,) on."""
    model, x = fit.model, x1[None]
    record = model.record(model.theta(ahead))
    y, _, _ = propagate(model, record, one, x[:, : model.na], x[:, model.na :], rng)
    return one.replace(y=np.where(one.observed, y[:, 0], np.nan))


def _rms(near: Fitted, like: Fitted) -> float:
    """Root mean square of what a refit leaves, outputs weighed as in another fit."""
    channels = np.concatenate([np.nonzero(one.observed)[1] for one in near.records])
    return float(
        np.sqrt(np.mean((near.e * (near.problem.scale / like.problem.scale)[channels]) ** 2))
    )
