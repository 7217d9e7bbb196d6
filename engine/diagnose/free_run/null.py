"""What free runs would show if nothing were missing: the fitted noise, simulated.

Where a model is wrong, process noise is fitted to what it misses from one sample to the next, and a free run
may be further off than this noise makes it, or in a way that an effect explains and noise does not. It may be
far *nearer*, too: noise that adds up from sample to sample walks away from any record, whereas the error
that it stands for comes back with the physics. So an error too small for the noise says as much as one too
large. It must be so for the noise of the likelihood's own fit and for the noise beside the parameters of the
free run. These bend it towards the record and make this noise larger, so it must be ``NEARER`` times so; or
series are simulated and refitted, which asks how near a run can be bent (:mod:`.refitted`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.diagnose.free_run.refitted import as_near, can_refit
from engine.diagnose.free_run_fits.fitted import Fitted
from engine.diagnose.free_run_fits.folds import Folds
from engine.diagnose.free_run_fits.linear import Linear
from engine.simulation.simulate import propagate
from engine.statespace.model import Array, ThetaLike
from engine.words import probability

SERIES = 299  # simulated at least; the smallest p-value of n is 3 / (n + 1)
LOOKED_AT = 0.05  # p-value from which on the likelihood's own noise is asked, too
AWAY = 1e100  # standard deviations of a reading: from there a run has run away, and its squares are no numbers
NEARER = 10.0  # times smaller than what noise makes, from which on an error is too small for it


@dataclass(frozen=True)
class Alarm:
    """Whether noise alone explains what the free run gets wrong.

    ``p_gain`` of the held-out gain of the best effects, ``p_size`` of so large an error beside what parameters
    and first states take up, ``p_near`` of so small a one; ``rms`` is that error, ``rms_noise`` what noise
    makes of it (median), in the weighed unit of the residuals; ``gain`` the held-out gain, log(mean squared
    error without / with). They are of so many ``series``, ``p_near`` of so many ``refits`` where
    there were any.
    """

    p_gain: float
    p_size: float
    p_near: float
    rms: float
    rms_noise: float
    gain: float
    series: int = SERIES
    refits: int = 0

    @property
    def p_value(self) -> float:
        """Of all three together (Bonferroni)."""
        return min(1.0, 3.0 * min(self.p_gain, self.p_size, self.p_near))

    @property
    def at_floor(self) -> bool:
        """Whether ``p_value`` is the least that so many series can give: none of them reached the record."""
        least, n = min(self.p_gain, self.p_size, self.p_near), self.series
        return least == _p_value(0, (self.refits or n) if least == self.p_near else n)

    @property
    def probability(self) -> str:
        """``p_value`` in words."""
        return probability(self.p_value, self.at_floor)


def alarm(
    linear: Linear,
    theta: Array,
    folds: Folds,
    seed: int,
    ahead: ThetaLike = None,
    level: float = 1.0,
) -> Alarm:
    """Compare the residuals with those of series simulated at theta, whose noise is that of the data.

    So many are simulated that the p-value can be as small as ``level``.

    ``theta`` (n_theta,) differs from the fit's own in the parameters that do not change a noise-free run.
    ``ahead`` is the likelihood's own fit of the same model; without it an error too small is not asked for.
    """
    fit, n = linear.fit, max(SERIES, int(np.ceil(3.0 / level)) - 1)
    E = noise_runs(fit, theta, n, seed)
    E = _staying(E)
    away = n - E.shape[1]  # noise makes these run away: no error is beyond them
    gain = float(linear.held_out_gains(fit.e, folds)[0])
    rms = float(np.sqrt(np.mean(linear.e**2)))
    if not E.shape[1]:
        return Alarm(1.0, 1.0, 1.0, rms, float("inf"), gain, n)
    sizes = np.sqrt(np.mean(linear.beside(E) ** 2, axis=0))
    p_gain = _p_value(int((linear.held_out_gains(E, folds) >= gain).sum()) + away, n)
    p_size = _p_value(int((sizes >= rms).sum()) + away, n)
    p_near, refits = 1.0, 0
    if ahead is not None and 3.0 * _p_value(int((sizes <= rms).sum()), n) <= LOOKED_AT:
        E = noise_runs(fit, _with_noise_of(fit, ahead), n, seed)
        E = _staying(E)  # what runs away is not small
        own = np.sqrt(np.mean(linear.beside(E) ** 2, axis=0))
        p_own = _p_value(int((own <= rms).sum()), n)
        p_near = max(p_own, _p_value(int((sizes <= NEARER * rms).sum()), n))
        fewest = int(np.ceil(3.0 / level)) - 1
        if 3.0 * min(p_gain, p_size, p_near) > level >= 3.0 * p_own and can_refit(fit, fewest):
            refits = fewest
            p_near = max(p_own, _p_value(as_near(fit, ahead, refits, level / 3.0, seed), refits))
    return Alarm(p_gain, p_size, p_near, rms, float(np.median(sizes)), gain, n, refits)


def _with_noise_of(fit: Fitted, ahead: ThetaLike) -> Array:
    """The fit's theta with the noise of another fit of its model."""
    theta, other = np.asarray(fit.theta).copy(), fit.model.theta(ahead)
    for name in fit.noise:
        theta[fit.model.parameter_names.index(name)] = other[name]
    return theta


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


def _staying(E: Array) -> Array:
    """Those of the columns of E (values, n) that do not run away."""
    return E[:, (np.abs(E) < AWAY).all(axis=0)]


def _p_value(reached: int, series: int) -> float:
    return (1 + reached) / (1 + series)
