"""How large a wave is: its amplitude, from those of its cosine and its sine."""

from __future__ import annotations

import numpy as np

from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.traits import Course
from engine.estimation.quasi_ml import QuasiFit


def amplitude_of(effect: Effect, fit: QuasiFit) -> tuple[float | None, float | None]:
    """The amplitude of an effect in a fit that holds it, and its standard error; None where it is no wave.

    The error is that of the delta method, inf where the data tie one of the two parts to other parameters.
    """
    if effect.traits.course is not Course.HARMONIC:
        return None, None
    names = [p.name for p in effect.amplitudes]
    parts = np.array([float(fit.theta[name]) for name in names])
    amplitude = float(np.hypot(*parts))
    at = [fit.free.index(name) for name in names if name in fit.free]
    if not at or amplitude == 0.0:
        return amplitude, float("nan")
    errors = fit.standard_errors[at]
    if not np.isfinite(errors).all():
        return amplitude, float("inf")
    slope = parts[[name in fit.free for name in names]] / amplitude
    variance = float(slope @ fit.covariance[np.ix_(at, at)] @ slope)
    return amplitude, float(np.sqrt(max(variance, 0.0)))
