"""Parameters next to a bound up to which the likelihood rises by next to nothing: a variance near 0, say.

There it need not be curved, and differences of the score over no room say nothing of any parameter.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from engine.errors import EngineError
from engine.estimation.uncertainty.score import Score
from engine.statespace.model import Array
from engine.words import enumerated

PRESSED_NATS = 0.5  # that a parameter next to its bound gains at most on its way there ...
ON_ITS_SIDE = 0.1  # ... from so near, beside all the room there is
FURTHER = 1e9  # times the way to the bound: there the likelihood has to be another ...
ROUNDING = 1e-12  # ... by more than this share of it
NEXT_TO = (
    1e-3  # of the way from a bound, beside which the model can be had where it cannot be had there
)


def pressed_onto_bounds(
    score: Score, scores: Array, seeds: Sequence[np.random.SeedSequence]
) -> NDArray[np.bool_]:
    """Which parameters (n,) are as good as at a bound; ``scores`` (R, n) are those at the estimate.

    Likelihoods are compared at the bound. Of particles they are the moment filter's, and the score is asked,
    too, and again half-way: it drowns in its noise, which grows as a variance falls.
    """
    (lower, upper), x, n = score.bounds, score.x, len(scores)
    mean, noise = scores.mean(axis=0), scores.std(axis=0) / np.sqrt(n)
    pressed = np.zeros(len(x), dtype=np.bool_)
    for k in range(len(x)):
        bound, room = min(
            ((b, abs(x[k] - b)) for b in (lower[k], upper[k])), key=lambda one: one[1]
        )
        if not room < ON_ITS_SIDE * (upper[k] - lower[k]):
            continue
        drawn = mean[k] * np.sign(bound - x[k])
        with contextlib.suppress(EngineError):
            pressed[k] = _as_likely(score, k, bound)
            if not (pressed[k] or score.exact) and 2.0 * noise[k] < drawn < PRESSED_NATS / room:
                there = _moved(x, k, 0.5 * (x[k] + bound))
                further = [score.at(there, which)[0][k] for which in seeds]
                pressed[k] = np.mean(further) * np.sign(bound - x[k]) > 0.0
    return pressed


def _as_likely(score: Score, k: int, bound: float) -> bool:
    """Whether the bound of parameter k is as likely as its value, and what is beyond that is no likelier.

    Where the model cannot be had at its bound, what is next to it is asked.
    """
    x, width = score.x, score.bounds[1][k] - score.bounds[0][k]
    way = np.sign(x[k] - bound) * min(ON_ITS_SIDE * width, FURTHER * abs(x[k] - bound))
    here, least, far = (score.value(_moved(x, k, at)) for at in (x[k], bound, bound + way))
    if not np.isfinite(least):
        least = score.value(_moved(x, k, bound + NEXT_TO * (x[k] - bound)))
    rounding = ROUNDING * (1.0 + abs(here))
    # one that nothing depends on is at no bound
    return bool(-rounding < least - here < PRESSED_NATS and not far > here - rounding)


def _moved(x: Array, k: int, value: float) -> Array:
    out = x.copy()
    out[k] = value
    return out


def said_of_bounds(names: Sequence[str]) -> str:
    """A sentence about the parameters that are as good as at a bound, "" without any."""
    if not names:
        return ""
    return (
        f"The likelihood rises up to the bound of {enumerated(list(names))}, next to which the estimate is: "
        "the errors are those with it held."
    )
