"""Maxima of noise that is next to nothing, which a model has without an effect as with it.

A known first state that may be anything meets the first reading exactly, and the less its noise the likelier
that reading: a spike of the likelihood. A refit that has found it gains there what the model would have gained
without any effect: of series drawn from a river's level one in seven gained 37 for a wave.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from engine.data.series import Series
from engine.diagnose.refits.refitted import Refit, weighed
from engine.diagnose.screening.noise_parameters import noise_of
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.statespace.model import Array

VANISHED = 1e-3  # of its value before: noise that is less with an effect is next to nothing


def off_spikes(
    fit: QuasiFit,
    done: Refit,
    again: Callable[[Array, Sequence[str]], Refit],
    series: Series,
) -> Refit:
    """A refit that is ``done``, weighed beside the model without its effect in the same place.

    Where noise has all but vanished, and the model without the effect is likelier there, too, it is what gains
    more: the refit beside that, or one from this noise held as it is in ``fit``, made ``again`` from a theta
    with names that are free. Where the effect has taken the place of noise the model without it is less likely
    without noise, and nothing changes.
    """
    found = done.fit
    noise = [name for name, yes in zip(fit.free, noise_of(fit, series), strict=True) if yes]

    def vanished(one: QuasiFit) -> list[str]:
        return [name for name in noise if 0.0 <= one.theta[name] < VANISHED * fit.theta[name]]

    gone = vanished(found)
    if not gone or found.given_up:
        return done
    there = np.asarray(found.theta)[: len(fit.theta)]
    usual = found.theta.asdict() | {name: fit.theta[name] for name in gone}
    try:
        beside = quasi_ml(fit.model, series, there, fit.free).log_likelihood
        if not beside > fit.log_likelihood:
            return done
        left = [name for name in found.free if name not in gone]
        other = again(np.asarray(found.model.theta(usual)), left)
        freed = again(np.asarray(other.fit.theta), found.free)
        if not vanished(freed.fit):
            other = freed
    except (EngineError, np.linalg.LinAlgError):
        return done
    own = weighed(done.effect, found, beside, series)
    return other if other.gain >= own.gain else own
