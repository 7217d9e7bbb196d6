"""Refits from elsewhere, where an effect is so large that it bends the fit of the model without it.

Without the effect the parameters go far off to explain some of it, perhaps to another basin of the likelihood.
What the screen sees from there is bent too, and refits that begin there may end in a maximum that is not the
highest. So all effects are screened again at parameters that are not bent, those the model was given with and
those of the refit that leads, and the best are refitted from there, too. So is what looks like the one that
leads: from the bent fit a lag of a sensor may seem to want a negative time, and is not refitted there, and
beside the parameters of a lag of the input its slope at no lag is less than those of eight others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.refits.checkpoint import Kept
from engine.diagnose.refits.refit import refit
from engine.diagnose.refits.refitted import Refit, cost
from engine.diagnose.screening.screen import Score, Screen
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit, log_likelihoods
from engine.statespace.model import Theta

Screened = Callable[[QuasiFit, Sequence[str]], Screen]

REFITS = 8  # effects refitted from each place


def bent(refits: Sequence[Refit], series: Series) -> bool:
    """Whether the best of these gains more than a unit of 2 x log-likelihood for every reading."""
    named = (r.gain for r in refits if not r.effect.traits.unnamed)
    return max(named, default=0.0) > int(series.observed.sum())


def from_elsewhere(
    fit: QuasiFit,
    series: Series,
    effects: Sequence[Effect],
    own: Sequence[str],
    screened: Screened,
    refits: Sequence[Refit],
    kept: Kept,
) -> tuple[list[Refit], list[Score]]:
    """Refits that begin at parameters the data without the effect did not choose, with their scores there.

    ``own`` are the parameters of the user's model; ``screened`` tells what is seen of some of
    ``effects`` at other parameters; ``refits`` begun at the fit itself.
    """
    # not of noise, which would be worth most, as all errors are large from there
    effects = [effect for effect in effects if not _of_noise(effect)]
    kinds = [effect.name for effect in effects]
    named = [one for one in refits if not one.effect.traits.unnamed]
    leading = max(named, key=lambda one: one.score)
    found, scores = list[Refit](), list[Score]()
    for name, theta in _places(fit, leading, own).items():
        there, here = replace(fit, theta=theta, rivals=()), kept.further(name)
        try:
            value = float(log_likelihoods(fit.model, [series], np.asarray(theta)[None])[0])
            seen = here.screen(effects, partial(screened, there, kinds))
        except (EngineError, np.linalg.LinAlgError):
            continue
        fall = 2.0 * (fit.log_likelihood - value)
        for score in _asked(seen, leading.effect, series):
            best = max(r.score for r in (*refits, *found))
            once = partial(refit, there, series, score, best + fall)
            try:
                one = here.refit(fit.model, score.effect, once)
            except (EngineError, np.linalg.LinAlgError):
                continue
            found.append(replace(one, gain=one.gain - fall, score=one.score - fall))
            scores.append(score)
    return found, scores


def _places(fit: QuasiFit, leading: Refit, own: Sequence[str]) -> dict[str, Theta]:
    """Parameters at which to look again: the model's own at their defaults, or as in the refit that leads."""
    moved = [name for name in fit.free if name in own]
    known = fit.theta.asdict()
    defaults, beside = fit.model.theta().asdict(), leading.fit.theta.asdict()
    return {
        "as given": fit.model.theta(known | {name: defaults[name] for name in moved}),
        "beside the leading": fit.model.theta({name: beside[name] for name in known}),
    }


def _asked(seen: Screen, leading: Effect, series: Series) -> list[Score]:
    """The effects that are worth most from there, and those that look like the one that leads."""
    named = [s for s in seen.scores if s.statistic > 0.0]
    ranked = sorted(named, key=lambda s: cost(s.effect, series) - s.statistic)
    alike = (s for s in ranked[REFITS:] if _alike(s.effect, leading))
    return [*ranked[:REFITS], *alike]


def _alike(one: Effect, other: Effect) -> bool:
    """Whether either says so, at the same place or at one of another sort."""
    near = one.channel == other.channel or one.family != other.family
    return near and (one.kind in other.look_alikes or other.kind in one.look_alikes)


def _of_noise(effect: Effect) -> bool:
    traits = effect.traits
    return traits.noise_level or traits.outliers or traits.unnamed
