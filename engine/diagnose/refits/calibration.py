"""How bold the p-values of a screen are on this model and record: a short parametric bootstrap.

The multiplier draws of :mod:`engine.diagnose.screening.screen` keep the size of every time's score. They do not
know that theta was estimated from the same data, nor that scores are correlated in time where the
filter is an approximation (a kink, a coarse step): p-values of some effects then come out too small,
those of slow forces on short records above all. Here B series are simulated from the fitted model,
refitted, and screened again. With x = -log p, which has mean 1 where p is right,

    boldness of an effect = (PRIOR * overall mean + sum of its x) / (PRIOR + B),      at least 1,

and its p-value counts as p^(1 / boldness); what the smallest p-value of all is still too small then,
-log of it on simulated series over that of their own multiplier draws, counts for all effects alike. (Not
over that of the data's draws: a score that few times make up raises their p-values, which the data's own
p-value has in it already.) Ratios of means need far fewer series than tails of distributions.
The simulation is made only where it decides:
where an alarm would be none at BOLDEST. Only effects that may decide are screened again on each series, and
of the others some, in turn, which tell the overall mean.

Refits of what process noise has swallowed are judged by simulation alone: until ENOUGH simulated series
show as small a p-value, ENOUGH / alpha - 1 of them at most (Besag, Clifford 1991). One would do for the level
as well, but then a single unlucky series among many decides what is seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from engine.data.joined import apart
from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.refits.checkpoint import NOTHING, Kept
from engine.diagnose.refits.refitting import refit_swallowed, swallowed_p
from engine.diagnose.screening.screen import Screen
from engine.diagnose.screening.screening import Progress, screen_effects
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.simulation.simulate import copies
from engine.statespace.model import Array

BOLDEST = 2.0  # p-values with more than twice the logarithm they should have are rare
# at most; FEWEST where the p-value is then CLEARLY above or below alpha, by this factor, or can be no less
SERIES = 19
FEWEST, CLEARLY = 7, 4.0
ENOUGH = 3  # simulated series with as small a p-value of refits, for no alarm
OTHERS = 40  # effects that are screened again for the overall mean ...
TURNS = 4  # ... each on every so many-th series
PRIOR = 10.0  # series that the overall mean stands for
LEAST_P = 1e-300  # of which there is a logarithm
LEVEL = 0.05  # of a screen whose threshold nobody asks for


@dataclass(frozen=True, eq=False)
class Question:
    """What is asked of the data, and again of every simulated series."""

    fit: QuasiFit
    series: Series
    setting: Setting
    kinds: Sequence[str] | None


def decides(p_value: Callable[[float], float], alpha: float, seen: Screen) -> bool:
    """Whether simulation decides about an alarm, ``p_value`` being a function of the boldness."""
    return not seen.simulated and p_value(1.0) <= alpha < p_value(BOLDEST)


def calibrated(
    seen: Screen,
    question: Question,
    alpha: float,
    seed: int,
    progress: Progress,
    kept: Kept = NOTHING,
) -> Screen:
    """The screen with its p-values as bold as simulation shows them to be."""
    names = [score.effect.name for score in seen.scores]
    rows: list[Array] = []
    expected: list[float] = []
    # the model may not let itself be simulated: then the least that may be believed
    judged = with_boldness(seen, np.full(len(names), BOLDEST), SERIES)
    near, others = _telling(seen)
    for k in range(SERIES):
        progress("calibration", k / SERIES)
        asked = replace(question, kinds=[*near, *others[k % TURNS :: TURNS]])
        one = partial(simulated_logs, asked, names, [seed, k, SERIES])
        row = kept.numbers(f"calibrated {k + 1}", one)
        if row is None:
            continue
        rows.append(row[:-1])
        expected.append(float(row[-1]))
        judged = with_boldness(seen, boldness(np.array(rows), np.array(expected)), len(rows))
        surely = judged.p_value <= alpha and judged.at_floor
        if len(rows) >= FEWEST and (
            surely or not CLEARLY * alpha > judged.p_value > alpha / CLEARLY
        ):
            break
    return judged


def _telling(seen: Screen) -> tuple[list[str], list[str]]:
    """Names of the effects whose p-values may decide, at BOLDEST, and of OTHERS that stand for all the rest."""
    by_p = sorted(seen.scores, key=lambda score: (score.p_value, score.effect.name))
    least = by_p[0].p_value ** (1.0 / BOLDEST)
    near = [score.effect.name for score in by_p if score.p_value <= least]
    rest = sorted(score.effect.name for score in by_p if score.p_value > least)
    return near, rest[:: max(len(rest) // OTHERS, 1)]


def boldness(x: Array, expected: Array) -> Array:
    """Of each of n effects, from x = -log p (B, n) on simulated series, NaN where not tested.

    ``expected`` (B,) are the means of the largest x by multiplier draws, on each series.
    """
    tested = ~np.isnan(x)
    n, total = tested.sum(axis=0), np.nansum(x, axis=0)
    overall = float(total.sum() / max(int(n.sum()), 1))
    each = np.maximum((PRIOR * overall + total) / (PRIOR + n), 1.0)
    largest = np.where(tested, x / each, 0.0).max(axis=1)
    # where draws never see anything, nothing can be too large beside them
    left = float(largest.mean() / expected.mean()) if expected.any() else 1.0
    return np.asarray(each * max(left, 1.0))


def with_boldness(seen: Screen, each: Array, series: int) -> Screen:
    """The screen judged at a boldness of each of its effects (n,), known from so many series."""
    scores = tuple(
        replace(score, p_value=score.p_value ** (1.0 / float(own)), boldness=float(own))
        for score, own in zip(seen.scores, each, strict=True)
    )
    judged = replace(seen, scores=scores, simulated=series)
    return replace(judged, p_value=judged.family_wise(judged.smallest))


def simulated(question: Question, rng: np.random.Generator) -> tuple[QuasiFit, Series]:
    """A series drawn from the fit as :func:`drawn_from`, and the fit to it.

    Raises EngineError or LinAlgError where the run or the filter is lost.
    """
    fit = question.fit
    drawn = drawn_from(fit, question.series, rng)
    return quasi_ml(fit.model, drawn, fit.theta, fit.free), drawn


def drawn_from(fit: QuasiFit, like: Series, rng: np.random.Generator) -> Series:
    """A series drawn from the fit, with the inputs, times and gaps of another one, record by record."""
    return several_drawn(fit, like, 1, rng)[0]


def several_drawn(
    fit: QuasiFit, like: Series, n: int, rng: np.random.Generator
) -> tuple[Series, ...]:
    """n series as of :func:`drawn_from`, in little more time than one takes; EngineError where one is lost."""
    y = np.full((n, *like.y.shape), np.nan)
    for first, one in zip((0, *like.begins), apart(like), strict=True):
        drawn, _, _ = copies(fit.model, fit.theta, one, n, rng)
        y[:, first : first + len(one)] = drawn.swapaxes(0, 1)
    return tuple(like.replace(y=np.where(like.observed, each, np.nan)) for each in y)


def screen_of_simulated(
    question: Question, rng: np.random.Generator, swallowed: bool = False
) -> tuple[Screen, float] | None:
    """The screen of one simulated series, and the p-value of refits of what noise swallows.

    The latter is 1 where they are not asked for. None where the run was lost.
    """
    try:
        refitted, drawn = simulated(question, rng)
        draws = int(rng.integers(2**31))
        seen = _screened(question, refitted, drawn, draws)
        if not swallowed:
            return seen, 1.0
        return seen, swallowed_p(seen, refit_swallowed(refitted, drawn, seen, silent))
    except (EngineError, np.linalg.LinAlgError):
        return None


def _screened(
    question: Question,
    fit: QuasiFit,
    series: Series,
    seed: int,
    asked: Callable[[Effect], bool] = lambda effect: True,
) -> Screen:
    """The same screen of a fit to a simulated series."""
    setting, kinds = question.setting, question.kinds
    return screen_effects(fit, series, setting, kinds, LEVEL, seed, silent, asked=asked)


def sequential_p(
    p_value: float,
    question: Question,
    alpha: float,
    seed: int,
    progress: Progress,
    kept: Kept = NOTHING,
) -> float:
    """How rare so small a p-value of refits is: at most alpha where fewer than ENOUGH series have one."""
    n = _series(alpha)
    extreme = 0
    for k in range(n):
        progress("calibration of refits", k / n)
        one = partial(swallowed_of_simulated, question, [seed, k, n, 1])
        drawn = kept.numbers(f"refits simulated {k + 1}", one)
        extreme += drawn is not None and drawn <= p_value
        if extreme == ENOUGH:
            return max(ENOUGH / (k + 1.0), float(np.nextafter(alpha, 1.0)))
    return max(p_value, (extreme + 1.0) / (n + 1.0))


def sequential_floor(alpha: float) -> float:
    """The least that :func:`sequential_p` can give."""
    return 1.0 / (_series(alpha) + 1.0)


def _series(alpha: float) -> int:
    return int(np.ceil(ENOUGH / alpha)) - 1


def swallowed_of_simulated(question: Question, seed: list[int]) -> float | None:
    """The p-value of these refits on one simulated series; None where lost.

    Of the screen no more is made than says which they are.
    """
    rng = np.random.default_rng(seed)
    try:
        refitted, drawn = simulated(question, rng)
        draws = int(rng.integers(2**31))
        seen = _screened(question, refitted, drawn, draws, lambda one: one.traits.swallowed)
        return swallowed_p(seen, refit_swallowed(refitted, drawn, seen, silent))
    except (EngineError, np.linalg.LinAlgError):
        return None


def simulated_logs(question: Question, names: Sequence[str], seed: list[int]) -> Array | None:
    """The x = -log p of the named effects on one simulated series, NaN where not tested.

    Last comes what its multiplier draws say that the largest of them is in the mean; None where it was lost.
    """
    drawn = screen_of_simulated(question, np.random.default_rng(seed))
    if drawn is None:
        return None
    found = {score.effect.name: score.p_value for score in drawn[0].scores}
    p_values = [found.get(name, np.nan) for name in names]
    x = -np.log(np.maximum(p_values, LEAST_P))
    return np.append(x, -np.log(np.maximum(drawn[0].lowest, LEAST_P)).mean())


def silent(stage: str, fraction: float) -> None:
    """Progress is told per series, not within one."""
