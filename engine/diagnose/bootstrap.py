"""The family-wise p-value by parametric bootstrap: simulate the fitted model, refit, screen again.

The multiplier draws of :mod:`engine.diagnose.screen` hold the fitted parameters' directions fixed and
rely on limits for long series. The bootstrap relies on neither: it repeats everything that led from
the data to the smallest p-value, on data of which it knows that nothing is hidden in them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from engine.diagnose.kept import NOTHING, Kept
from engine.diagnose.screen import Screen
from engine.diagnose.search import Search, refit_swallowed, screen_effects
from engine.diagnose.setting import Setting
from engine.errors import EngineError
from engine.quasi_ml import QuasiFit, quasi_ml
from engine.series import Series
from engine.simulate import simulate

STAGE = "bootstrap"

Progress = Callable[[str, float], Any]


def bootstrap_p(
    base_fit: QuasiFit,
    series: Series,
    setting: Setting,
    screen: Screen,
    n: int,
    seed: int,
    *,
    kinds: Sequence[str] | None = None,
    swallowed: bool = False,
    progress: Progress = lambda stage, fraction: None,
    kept: Kept = NOTHING,
) -> float:
    """The share of n simulated series whose screen is as extreme as that of the data.

    ``screen`` is what :func:`engine.diagnose.search.screen_effects` found on ``series`` at ``base_fit``,
    over the effects ``kinds`` of ``setting``; the same effects are asked of every simulated series.
    With ``swallowed`` the screen includes :func:`engine.diagnose.search.refit_swallowed`, which is then
    repeated too. Each series has the inputs, times and missing values of the data. Runs that are
    lost (no simulation or no filter) are left out; p = (1 + as extreme) / (1 + runs not lost).
    """
    observed = _smallest(screen, swallowed)
    extreme = used = 0
    for k in range(n):
        progress(STAGE, k / n)
        one = partial(_one, base_fit, series, setting, kinds, swallowed, [seed, k])
        drawn = kept.number(f"bootstrap {k + 1}", one)
        if drawn is not None:
            used += 1
            extreme += drawn <= observed
    return (1.0 + extreme) / (1.0 + used)


def first_round_p(
    base_fit: QuasiFit,
    series: Series,
    setting: Setting,
    search: Search,
    n: int,
    seed: int,
    *,
    alpha: float,
    kinds: Sequence[str] | None,
    progress: Progress,
    kept: Kept = NOTHING,
) -> float:
    """The bootstrap p-value of what a search saw in its first round, begun with the same seed.

    Refits have a part in every simulated series only where they had one in the data: they take most
    of the time.
    """
    seen = search.rounds[0].screen
    alone = screen_effects(base_fit, series, setting, kinds, alpha, seed, _silent)
    swallowed = seen.p_value < alone.p_value
    return bootstrap_p(
        base_fit,
        series,
        setting,
        seen,
        n,
        seed,
        kinds=kinds,
        swallowed=swallowed,
        progress=progress,
        kept=kept,
    )


def _one(
    fit: QuasiFit,
    series: Series,
    setting: Setting,
    kinds: Sequence[str] | None,
    swallowed: bool,
    seed: list[int],
) -> float | None:
    """The smallest p-value on one series drawn from the fit; None where the run was lost."""
    rng = np.random.default_rng(seed)
    try:
        y = simulate(fit.model, fit.theta, len(series), rng, u=series.u, t=series.t).y
        drawn = series.replace(y=np.where(series.observed, y, np.nan))
        refitted = quasi_ml(fit.model, drawn, fit.theta, fit.free)
        seen = screen_effects(
            refitted, drawn, setting, kinds, 0.05, int(rng.integers(2**31)), _silent
        )
        if swallowed:
            seen, _ = refit_swallowed(refitted, drawn, seen, _silent)
    except (EngineError, np.linalg.LinAlgError):
        return None
    return _smallest(seen, swallowed)


def _smallest(screen: Screen, swallowed: bool) -> float:
    """Of the effects' own p-values, or the family-wise one where refits have a part in it."""
    return screen.p_value if swallowed else min(score.p_value for score in screen.scores)


def _silent(stage: str, fraction: float) -> None:
    """Progress is told per series, not within one."""
