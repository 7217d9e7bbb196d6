"""The family-wise p-value by parametric bootstrap: simulate the fitted model, refit, screen again.

The multiplier draws of :mod:`engine.diagnose.screening.screen` hold the fitted parameters' directions fixed and
rely on limits for long series. The bootstrap relies on neither: it repeats everything that led from
the data to the smallest p-value, on data of which it knows that nothing is hidden in them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from engine.diagnose.refits.calibration import Question, screen_of_simulated, silent
from engine.diagnose.refits.checkpoint import NOTHING, Kept
from engine.diagnose.refits.found import Search
from engine.diagnose.screening.screen import Screen
from engine.diagnose.screening.screening import Progress

STAGE = "bootstrap"


@dataclass(frozen=True)
class Bootstrapped:
    """A p-value by simulated series; ``at_floor`` where none was as extreme: the least that they can give."""

    p_value: float
    at_floor: bool


def bootstrap_p(
    question: Question,
    screen: Screen,
    n: int,
    seed: int,
    *,
    swallowed: bool = False,
    progress: Progress = silent,
    kept: Kept = NOTHING,
) -> Bootstrapped:
    """The share of n simulated series whose screen is as extreme as that of the data.

    ``screen`` is what :func:`engine.diagnose.screening.screening.screen_effects` found for the ``question``;
    the same effects are asked of every simulated series.
    With ``swallowed`` the screen includes :func:`engine.diagnose.refits.refitting.refit_swallowed`, which
    is then repeated too. Each series has the inputs, times and missing values of the data. Runs that are
    lost (no simulation or no filter) are left out; p = (1 + as extreme) / (1 + runs not lost).
    """
    observed = screen.p_value if swallowed else screen.smallest
    extreme = used = 0
    for k in range(n):
        progress(STAGE, k / n)
        one = partial(_one, question, swallowed, [seed, k])
        drawn = kept.numbers(f"bootstrap {k + 1}", one)
        if drawn is not None:
            used += 1
            extreme += drawn <= observed
    return Bootstrapped((1.0 + extreme) / (1.0 + used), extreme == 0)


def first_round_p(
    question: Question, search: Search, n: int, seed: int, progress: Progress, kept: Kept
) -> Bootstrapped:
    """The bootstrap p-value of what a search saw in its first round.

    Refits have a part in every simulated series only where they had one in the data: they take most
    of the time.
    """
    seen = search.rounds[0].screen
    swallowed = seen.p_value < seen.family_wise(seen.smallest)
    return bootstrap_p(question, seen, n, seed, swallowed=swallowed, progress=progress, kept=kept)


def _one(question: Question, swallowed: bool, seed: list[int]) -> float | None:
    """The smallest p-value on one series drawn from the fit; None where the run was lost."""
    drawn = screen_of_simulated(question, np.random.default_rng(seed), swallowed)
    if drawn is None:
        return None
    seen, refitted = drawn
    return min(seen.p_value, refitted) if swallowed else seen.smallest
