"""What free runs would show if nothing were missing: the fitted noise, simulated.

Where a model is wrong, process noise is fitted to what it misses from one sample to the next, and a free run
may be further off than this noise makes it, or in a way that an effect explains and noise does not. It may be
far *nearer*, too: noise that adds up from sample to sample walks away from any record, whereas the error
that it stands for comes back with the physics. So an error far too small for the noise says as much as one too
large. It must be ``NEARER`` times smaller: parameters that are fitted to a free run bend it towards the record,
and the noise beside them is larger than that of a fit by likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.diagnose.free_run_fits.fitted import Fitted
from engine.diagnose.free_run_fits.folds import Folds
from engine.diagnose.free_run_fits.linear import Linear
from engine.simulation.simulate import propagate
from engine.statespace.model import Array

SERIES = 299  # simulated; the smallest p-value is 3 / (SERIES + 1)
NEARER = 10.0  # times smaller than what noise makes, from which on an error is too small for it


@dataclass(frozen=True)
class Alarm:
    """Whether noise alone explains what the free run gets wrong.

    ``p_gain`` of the held-out gain of the best effects, ``p_size`` of so large an error beside what parameters
    and first states take up, ``p_near`` of one so small that noise makes it ``NEARER`` times as large;
    ``rms`` is that error, ``rms_noise`` what noise makes of it (median), in the weighed unit of the residuals;
    ``gain`` the held-out gain, log(mean squared error without / with).
    """

    p_gain: float
    p_size: float
    p_near: float
    rms: float
    rms_noise: float
    gain: float

    @property
    def p_value(self) -> float:
        """Of all three together (Bonferroni)."""
        return min(1.0, 3.0 * min(self.p_gain, self.p_size, self.p_near))


def alarm(linear: Linear, theta: Array, folds: Folds, seed: int) -> Alarm:
    """Compare the residuals with those of series simulated at theta, whose noise is that of the data.

    ``theta`` (n_theta,) differs from the fit's own in the parameters that do not change a noise-free run.
    """
    fit = linear.fit
    E = noise_runs(fit, theta, SERIES, seed)
    E = E[:, np.isfinite(E).all(axis=0)]
    away = SERIES - E.shape[1]  # noise makes these run away: no error is beyond them
    gain = float(linear.held_out_gains(fit.e, folds)[0])
    rms = float(np.sqrt(np.mean(linear.e**2)))
    if not E.shape[1]:
        return Alarm(1.0, 1.0, 1.0, rms, float("inf"), gain)
    sizes = np.sqrt(np.mean(linear.beside(E) ** 2, axis=0))
    p_gain = _p_value(int((linear.held_out_gains(E, folds) >= gain).sum()) + away)
    p_size, p_near = (
        _p_value(int((sizes >= rms).sum()) + away),
        _p_value(int((sizes <= NEARER * rms).sum())),
    )
    return Alarm(p_gain, p_size, p_near, rms, float(np.median(sizes)), gain)


def noise_runs(fit: Fitted, theta: Array, n: int, seed: int) -> Array:
    """What noise alone adds to the free runs (values, n), weighed as the fit's residuals."""
    model, rng = fit.model, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(77,)))
    record, na, parts = model.record(theta), model.na, []
    for one, x1 in zip(fit.records, fit.x1, strict=True):
        x = np.tile(x1, (n, 1))
        y, _, _ = propagate(model, record, one, x[:, :na], x[:, na:], rng)
        quiet, _, _ = propagate(model, record, one, x[:1, :na], x[:1, na:])
        parts.append(((y - quiet) / fit.problem.scale).transpose(0, 2, 1)[one.observed])
    return np.concatenate(parts)


def _p_value(reached: int) -> float:
    return (1 + reached) / (1 + SERIES)
