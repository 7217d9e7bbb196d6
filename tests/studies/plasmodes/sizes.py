"""How large: by the projected likelihood ratio, or by the share of the free run's error.

    LR = 2 (max_theta log p(y without the effect) - max_theta log p(y with it))

of the base, which is what the effect costs it after all its parameters, those of its noise among them, have
taken what they can; for small effects it is d' M d with d what the effect adds to standardised innovations,
Gamma their derivatives by the parameters and M = I - Gamma Gamma^+. Where the free run decides, e are its
errors, Gamma has the first states too, and

    share = d' M d / (d' M d + e' e).

Of scatter, which moves no innovation in the mean, LR is that of a mixture of two normals, or of a variance that
grows with time, against one normal, the scale of the noise being free in all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from engine.data.series import Series
from engine.diagnose.free_run_fits.candidates import fit_of
from engine.diagnose.free_run_fits.fitted import Fitted
from engine.diagnose.free_run_fits.linear import orthonormal
from engine.diagnose.records import Records
from engine.diagnose.symptoms.runs import noise_free
from engine.errors import EngineError
from engine.estimation.differences import neighbours
from engine.estimation.jumps import sides
from engine.estimation.quasi_ml import quasi_ml, whitening
from engine.filters.neighbours import filter_neighbours
from engine.filters.sigma_point import moment_filter
from engine.statespace.model import Array
from tests.studies.plasmodes.planted import OUTLIERS, OUTLYING, Place, Put, put_in
from tests.studies.plasmodes.windows import Base

RATIOS = (40.0, 100.0)  # of the likelihood, fixed beforehand
SHARES = (0.5, 0.8)  # of the free run's squared error, likewise
IMITATED = 0.02  # of d' d: with less of it left beside Gamma, parameters imitate the effect
NARROWER = np.geomspace(0.2, 1.0, 30)  # of the standard deviation, that of most innovations ...
WIDER = np.geomspace(2.0, 50.0, 20)  # ... and of these that of those hit
GROWTHS = np.linspace(-20.0, 20.0, 201)  # of a log variance over the record
CLOSE = 0.1  # of the logarithm of what is wanted
TRIALS = 30
MOST_STEP = 4.0  # by which a size changes in a trial


@dataclass(frozen=True)
class Strength:
    """``value`` is LR or the share; ``own`` the part of d' d that parameters cannot imitate."""

    value: float
    own: float


Measure = Callable[[Series], Strength]


def measure_of(base: Base, scatter: str = "") -> Measure:
    """How strong what was put into the base's series is."""
    if scatter:
        return _by_likelihood(base, _mixture if scatter == OUTLIERS else _growing)
    return _by_free_run(base) if base.window.by_free_run else _by_innovations(base)


def _by_innovations(base: Base) -> Measure:
    model, theta, series = base.model, np.asarray(base.theta), base.series
    free = model.free_indices(base.free)
    thetas = neighbours(model, theta, free)
    distances = sides(thetas, free)[2]
    f = filter_neighbours(model, thetas, series)
    root = whitening(f.S[:, 0], series.observed)
    slopes = np.nan_to_num(f.innovations[:, 2::2] - f.innovations[:, 1::2]) / distances[:, None]
    Gamma = np.einsum("tij,tkj->tik", root, slopes).reshape(-1, len(distances))
    basis, before = orthonormal(Gamma), np.nan_to_num(f.innovations[:, 0])

    def measure(changed: Series) -> Strength:
        after = moment_filter(model, theta[None], changed).innovations[:, 0]
        seen = series.observed & changed.observed
        d = np.where(seen, np.nan_to_num(after) - before, 0.0)
        d = np.einsum("tij,tj->ti", root, d).ravel()
        own = d - basis @ (basis.T @ d)
        known = series.replace(y=np.where(seen, series.y, np.nan))
        there = moment_filter(model, theta[None], known).log_likelihood[0]
        left = quasi_ml(model, changed, theta, base.free).log_likelihood
        return Strength(2.0 * float(there - left), _part(own, d))

    return measure


def _by_free_run(base: Base) -> Measure:
    start = quasi_ml(base.model, base.series, base.theta, base.free)
    fit = fit_of(start, [base.series])
    basis = orthonormal(fit.J)
    error = float(fit.e @ fit.e)

    scale, seen = fit.problem.scale, base.series.observed
    before = _errors(fit, base.series)

    def measure(changed: Series) -> Strength:
        d = np.nan_to_num((_errors(fit, changed) - before) / scale)[seen]
        own = d - basis @ (basis.T @ d)
        power = float(own @ own)
        return Strength(power / (power + error), _part(own, d))

    return measure


def _errors(fit: Fitted, series: Series) -> Array:
    """Measured minus simulated (T, ny), from the fit's first state."""
    y, _ = noise_free(fit.model, np.asarray(fit.theta), series, fit.x1[0])
    return np.asarray(series.y - y)


def _by_likelihood(base: Base, most: Callable[[Array, Array], float]) -> Measure:
    """Of scatter: what another density of standardised innovations gains over one normal."""

    def of(series: Series) -> float:
        f = moment_filter(base.model, np.asarray(base.theta)[None], series)
        root = whitening(f.S[:, 0], series.observed)
        z = np.einsum("tij,tj->ti", root, np.nan_to_num(f.innovations[:, 0]))
        rows = np.nonzero(series.observed)[0]
        seen = z[series.observed]
        one = float(np.log(_normal(seen, np.sqrt(np.mean(seen**2)))).sum())
        return 2.0 * (most(seen, rows / len(series)) - one)

    before = of(base.series)

    def measure(changed: Series) -> Strength:
        return Strength(of(changed) - before, 1.0)

    return measure


def _mixture(z: Array, when: Array) -> float:
    """The largest log-likelihood of outliers among normal values."""
    scales = np.sqrt(np.mean(z**2)) * NARROWER[:, None, None]
    mixture = (1.0 - OUTLYING) * _normal(z, scales)
    mixture = mixture + OUTLYING * _normal(z, scales * WIDER[:, None])
    return float(np.log(mixture).sum(axis=-1).max())


def _growing(z: Array, when: Array) -> float:
    """The largest log-likelihood of normal values whose log variance is linear in time."""
    shape = np.exp(0.5 * GROWTHS[:, None] * (when - when.mean()))
    scale = np.sqrt(np.mean((z / shape) ** 2, axis=1))
    return float(np.log(_normal(z, shape * scale[:, None])).sum(axis=1).max())


def _normal(z: Array, sd: Any) -> Array:
    return np.asarray(np.exp(-0.5 * (z / sd) ** 2) / (sd * np.sqrt(2.0 * np.pi)))


def _part(own: Array, d: Array) -> float:
    power = float(d @ d)
    return float(own @ own) / power if power > 0.0 else 1.0


def searched(series: Series) -> Series:
    """The record without what a diagnosis holds out of it."""
    return Records(series).train


def size_for(base: Base, put: Put, place: Place, wanted: float) -> tuple[float, Strength]:
    """The size at which an effect is as strong as wanted, and what it is there.

    As strong in the part of the record that a diagnosis searches; the rest is held out. The largest size that
    makes sense where that is not reached.
    """
    measure = measure_of(replace(base, series=searched(base.series)), put.scatter)

    def strength(size: float) -> Strength:
        try:
            found = measure(searched(put_in(put, base.series, size, place)))
        except (EngineError, ArithmeticError, ValueError, np.linalg.LinAlgError):
            return Strength(np.inf, 1.0)
        return found if np.isfinite(found.value) else Strength(np.inf, 1.0)

    size, low, high = put.first, 0.0, put.most
    there = strength(size)
    for _ in range(TRIALS):
        if abs(np.log(max(there.value, 1e-300) / wanted)) < CLOSE or size == put.most == low:
            break
        low, high = (size, high) if there.value < wanted else (low, size)
        guess = size * float(
            np.clip(np.sqrt(wanted / max(there.value, 1e-300)), 1.0 / MOST_STEP, MOST_STEP)
        )
        size = guess if low < guess < high else 0.5 * (low + high)
        if low >= 0.99 * put.most:
            size = low = put.most
        there = strength(size)
    return size, there
