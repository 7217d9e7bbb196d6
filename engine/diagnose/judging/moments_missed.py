"""Whether the moment filter, by which a search compares models, is far from the likelihood of a model.

It takes what is known of a state for Gaussian, which it is not where two values are likely, or none is to begin
with. The parameters that it finds are then not the likeliest, and an effect may do no more than mend it. A
particle filter tells: its estimate of a likelihood has the right mean, so by Markov's inequality it is n nats
too high with probability exp(-n) at most. Far below the moment filter it may be lost itself, and tells nothing.
"""

from __future__ import annotations

import numpy as np

from engine.data.series import Series
from engine.diagnose.judging.contradictions import PARTICLES
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit
from engine.filters.lost import FAR_NATS, nats_short
from engine.filters.rbpf import rbpf
from engine.filters.sigma_point import moment_filter

# Nats of a row from which predictions are wrong: by Pinsker's inequality the probability of any event is off by
# a tenth at most below it
OF_A_ROW = 0.02


def nats_missed(before: QuasiFit, after: QuasiFit, series: Series, seed: int) -> float:
    """Nats by which the moment filter is below the likelihood at a fit, as far as particles tell; else 0.

    At the one ``after`` extending, or, where particles are lost there, at the one ``before``.
    """
    rows = int(series.observed.any(axis=1).sum())
    for fit in (after, before):
        if all(name in fit.model.scale_states for name in fit.model.nonlinear):
            return 0.0  # it goes through the values of those one by one
        try:
            particles = rbpf(
                fit.model, fit.theta, series, PARTICLES[0], np.random.default_rng([seed, 7])
            )
            missed = particles.log_likelihood - log_likelihood_of(fit, series)
        except (EngineError, ArithmeticError, ValueError, np.linalg.LinAlgError):
            continue
        if missed > max(FAR_NATS, OF_A_ROW * rows):
            return missed
        if missed >= -nats_short(rows, float(particles.ess.mean())):  # NaN is not
            return 0.0
    return 0.0


def log_likelihood_of(fit: QuasiFit, series: Series) -> float:
    """That of a fit by the moment filter."""
    return float(moment_filter(fit.model, np.asarray(fit.theta)[None], series).log_likelihood[0])


def missed_in_words(missed: float, gained: float, extended: bool) -> str:
    """What is to be said where so many nats are missed beside those that an extension gained."""
    said = (
        "The search compares models by the moment filter, which takes what is known of a state for Gaussian. "
        f"Here that is wrong: a particle filter finds the record {missed:.0f} nats likelier, with the same "
        "parameters. Estimate them by rbps_em, as those shown may be far off, with errors that are too small."
    )
    if not extended:
        return f"{said} An effect may be there that the search does not see."
    if missed > gained:
        less = f"What was found gains less by that filter, {gained:.0f}, and may only mend it"
        return f"{said} {less}: no cause is named."
    return f"{said} What was found gains more by that filter, {gained:.0f}."
