"""What is late is late as a whole.

A delay has a mean, its size, and a latest part, and between them the share that comes late. A half that comes
eight samples late is much the same as all of it four samples late where a record is smooth, and then that is
what is told. Where it is not the same, no delay is what the data show but an echo: a cycle that the model does
not know says today what it said a day ago, and one that is smoothed says a little of all that was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from engine.data.series import Series
from engine.diagnose.refits.refitted import TOLERANCE, Refit, cost
from engine.errors import EngineError
from engine.estimation.quasi_ml import log_likelihoods, quasi_ml
from engine.statespace.model import Theta

ERRORS = 2.0  # standard errors by which a mean may be away from that of a delay between two samples
ALIKE = ERRORS**2  # of 2 x log-likelihood that all of it may explain less, being one number less


def without_echoes(refits: Sequence[Refit], series: Series) -> list[Refit]:
    """The refits with delays told whole, and without those that would lead and cannot be."""
    out = list(refits)
    while True:
        named = [r for r in out if not r.effect.traits.unnamed]
        leading = max(named, key=lambda r: r.score, default=None)
        if leading is None or not _is_partial(leading):
            return out
        told = _whole(leading, series)
        out = [r for r in out if r is not leading] + ([] if told is None else [told])


def _is_partial(found: Refit) -> bool:
    """Whether a share comes late that is no delay's, be it one between two samples.

    Of the shortest one that is looked for it is a delay that is shorter still.
    """
    if not found.effect.traits.whole or found.fit.given_up or not found.score > 0.0:
        return False
    samples, error = _samples(found.fit.theta, found), found.standard_error
    if samples <= min(probe[0] for probe in found.effect.probes) or not np.isfinite(error):
        return False
    return found.size + ERRORS * error < (samples - 1.0) * _at(found)


def _whole(found: Refit, series: Series) -> Refit | None:
    """The refit with all of it late, by fewer samples, where it explains as much; else None."""
    known, name = found.fit, found.effect.parameters[1].name
    null = known.log_likelihood - 0.5 * found.gain
    fewer = [k for k, *_ in found.effect.probes if k < _samples(known.theta, found)]
    size, values = found.effect.size.name, known.theta.asdict()
    at = _at(found)
    starts = [known.model.theta(values | {size: at * k, name: k}) for k in fewer]

    def told(place: int) -> Refit | None:
        try:
            fit = quasi_ml(known.model, series, starts[place], known.free, tolerance=TOLERANCE)
        except (EngineError, np.linalg.LinAlgError):
            return None
        gain = 2.0 * (fit.log_likelihood - null)
        return replace(found, fit=fit, gain=gain, score=gain - cost(found.effect, series))

    try:
        likely = log_likelihoods(known.model, [series], np.asarray(starts, float))
    except (EngineError, np.linalg.LinAlgError):
        return None
    place = int(np.argmax(np.nan_to_num(likely, nan=-np.inf)))
    best = told(place)
    for step in (1, -1):  # all else was bent by the longer delay, and so was the likeliest
        while best is not None and 0 <= place + step < len(starts):
            other = told(place + step)
            if other is None or not other.gain > best.gain:
                break
            place, best = place + step, other
    alike = best is not None and best.gain >= found.gain - ALIKE
    return best if alike and best is not None and not _is_partial(best) else None


def _at(found: Refit) -> float:
    """Where between now and the latest part the mean of all of it is: there, or of a moving average midway."""
    return 0.5 if found.fit.theta.asdict().get(f"{found.effect.size.name}_evenly") else 1.0


def _samples(theta: Theta, found: Refit) -> float:
    return float(theta[found.effect.parameters[1].name])
