"""What a search has found, and whether it had found more had it begun with another effect.

Of two faults the first that is named may be neither: a pulse of the force takes what a drag and a knock of
the sensor leave together, and beside it a path from the input takes the rest. Exchanging one of such two for
another makes it worse. Noise takes what several faults leave together, and nothing of it is seen any more. So
where several effects were found, or noise alone, the rivals of the first round are tried as the first.

A drift is weighed there as a straight line, and its bend is looked for once it is found. What settles, as a
drive that warms up, then loses to an effect with a memory, whose first state fades as well. So drifts that were
behind are tried as the first beside any other name, where they may come out ahead with their bend alone: what
was named would show beside them once more, and promises nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.kinds.bend import DRIFTS
from engine.diagnose.judging.verdict import counted
from engine.diagnose.refits.found import Search, size_cost
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import MARGIN, Round

OTHERS = 3  # rivals that are tried as the first


def may_begin_otherwise(found: Search, begun: Round) -> bool:
    """Whether it is several effects that may hold each other, or noise, which holds all; none is outliers.

    Or one, where a drift is behind it.
    """
    outliers = any(one.effect.traits.outliers for one in found.named)
    return bool(_rivals(found, begun)) and not outliers and not found.of_the_steps


def _rivals(found: Search, begun: Round) -> list[Refit]:
    """What may be the first instead: where one effect was found that is no noise, a drift only."""
    rivals = [one for one in begun.refits if one.effect.name not in _names(found)]
    if _may_hold(found):
        return rivals
    drifts = [one for one in rivals if one.effect.kind in DRIFTS]
    return [] if any(one.effect.kind in DRIFTS for one in found.named) else drifts


def _may_hold(found: Search) -> bool:
    """Whether several effects were found, or noise."""
    return len(found.named) > 1 or _is_noise(found)


def _names(found: Search) -> set[str]:
    return {one.effect.name for one in found.named}


def _is_noise(found: Search) -> bool:
    """Whether one effect was found, and it is noise."""
    return [one.effect.family for one in found.named] == ["noise"]


def best_beginning(
    found: Search,
    begun: Round,
    series: Series,
    beside: Callable[[Refit, bool], float],
    other: Callable[[Round, bool], Search],
) -> Search:
    """The search, or a better one that begins with another of the refits of its first round, ``begun``.

    ``beside`` is the largest gain beside a refit: of all that has a name, as foreseen, or of its bend alone.
    The one that promises most is gone on with, by ``other``, if it may come out ahead: at first without
    simulations, which only ever find less. One that comes out even is told, unless the two share an effect.
    """
    names = _names(found)
    promised: list[tuple[float, Refit]] = []
    for rival in _rivals(found, begun):
        if (
            rival.effect.traits.outliers
            or (_is_noise(found) and rival.effect.family == "noise")
            or rival.score <= 0.0
            or len(promised) == OTHERS
        ):
            continue
        further = beside(rival, not _may_hold(found)) - size_cost(series)
        promised.append((rival.score - size_cost(series) + max(further, 0.0), rival))
    most, first = max(promised, key=lambda one: one[0], default=(0.0, None))
    score = found.score(series)
    if first is None or most < score:
        return found
    led = _led_by(begun, first)
    if other(led, False).score(series) < score - MARGIN:
        return found
    again = other(led, True)
    lead = again.score(series) - score
    theirs = _names(again)
    if not found.alarm_left:
        if names <= theirs:
            return found  # beside these it has looked for more, and there was too little of it
        ours, others = (counted(r.effect for r in one.named) for one in (found, again))
        lead -= max(len(others) - len(ours), 0) * _choice_cost(begun)
    if lead > MARGIN:
        return again
    if lead >= -MARGIN and not theirs & names:
        return replace(found, as_well=tuple(sorted(theirs)))
    return found


def _choice_cost(begun: Round) -> float:
    """What an effect must gain as the best of all that were screened, where nothing more was asked for.

    The largest of n values of chi-squared with one degree of freedom is near 2 log n (Chen, Chen 2008).
    """
    return 2.0 * float(np.log(max(len(begun.screen.scores), 1)))


def _led_by(found: Round, first: Refit) -> Round:
    """A round in which another refit was chosen."""
    others = tuple(one for one in found.refits if one is not first)
    return replace(found, refits=(first, *others), equivalent=(first,))
