"""Whether what is found is an error of the steps that the model makes.

An effect acts step by step. The model that was diagnosed may be exact at any step, and with the effect it no
longer is: what the steps get wrong, where friction turns within one or a user's effect is put in before it, is
a static function of the states that is in proportion to the step. On a nearly noise-free record it passes for
a further effect of sensors or states, or makes another name fit better. Steps half as long get rid of half of
it, and so of three quarters of what its likelihood ratio would be; of an effect that is there they leave all.
The round before is then ranked anew by such steps, for the longer ones may have favoured one of its names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.catalogue import extend, make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.refits.checkpoint import Kept
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import MARGIN, Round, settle
from engine.diagnose.steps.substeps import can_be_finer, have_finer
from engine.errors import EngineError
from engine.estimation.long_steps import apart as predictions_apart
from engine.estimation.quasi_ml import QuasiFit, quasi_ml
from engine.filters.sigma_point import moment_filter
from engine.statespace.model import Array, MixedModel

EXPLAINED = 0.5  # of a likelihood ratio, from which steps half as long explain it
WHOLE = 4.0  # times what half of an error is worth
REACH = 10.0  # times what it is worth to first order a refit may gain by shorter steps: noise shrinks as well
NEAREST = 3  # rivals that are asked whether the lead over them outlasts shorter steps
MOVED = 0.5  # standard errors by which steps half as long may move a parameter


def by_shorter_steps(
    gain: float,
    setting: Setting,
    names: Sequence[str],
    fit: QuasiFit,
    series: Series,
    kept: Kept,
) -> float:
    """What steps half as long gain, 2 x log-likelihood, where it is most of an effect's ``gain``; else 0.

    ``fit`` is of the setting's model with the effects ``names``, without the one in question.
    """
    model, theta = setting.model, np.asarray(fit.theta)
    if not can_be_finer(setting, series, theta[: len(model.parameters)], names):
        return 0.0
    finer, extended = _finer(model, names, fit, series)
    if WHOLE * apart(fit, extended, series, finer) < EXPLAINED * gain:
        return 0.0  # so small an error cannot be worth so much
    gained = _gained(extended, fit, finer, kept)
    return gained if gained >= EXPLAINED * gain else 0.0


def ranked_anew(
    found: Round,
    within: float,
    names: Sequence[str],
    series: Series,
    setting: Setting,
    kept: Kept,
) -> Round:
    """A round whose refits ``within`` so much of the best are judged by steps half as long.

    For so much the steps may have favoured one; a third of it is left in these steps, by which names cannot be
    told apart. ``names`` are effects of earlier rounds.
    """
    least = found.refits[0].score - within
    refits = []
    for one in (*found.refits, *(() if found.generic is None else (found.generic,))):
        own = [*names, one.effect.name]
        # outliers are judged by a filter of their own
        if one.score >= least and have_finer(own, series) and not one.effect.traits.outliers:
            finer, extended = _finer(setting.model, own, one.fit, series)
            more = _gained(extended, one.fit, finer, kept)
            one = replace(one, gain=one.gain + more, score=one.score + more)
        refits.append(one)
    return settle(found.screen, refits, series, setting, steps_margin(within))


def steps_margin(gained: float) -> float:
    """Of the score, within which names are a set where steps half as long gain so much: a third is left."""
    return max(MARGIN, gained / 3.0)


def decides(
    found: Round,
    names: Sequence[str],
    fit: QuasiFit,
    series: Series,
    setting: Setting,
    kept: Kept,
    enough: int,
) -> float:
    """What the error of the steps is worth, 2 x log-likelihood, where it may decide a first round; else 0.

    ``fit`` is of the model with all effects that were found, ``names``. It may where it is worth as much as the
    lead over others is, but if with ``enough`` steps a sample, after which none are halved, the lead is seen to
    outlast that; and where another, as friction that turns within a step, comes near the one that leads with
    shorter steps, which may change nothing for that one. Errors of the steps are in proportion to them, so what
    the last halving gained is more than further ones would.
    """
    model, theta = setting.model, np.asarray(fit.theta)
    if not can_be_finer(setting, series, theta[: len(model.parameters)], names):
        return 0.0
    best = found.refits[0]
    others = [
        one
        for one in found.refits
        if one not in found.equivalent
        and not (one.effect.traits.outliers or one.effect.traits.unnamed)
        and have_finer([one.effect.name], series)
    ]

    def with_it(one: Refit) -> list[str]:
        """The effects of a refit's model: in a search that looked back those of other rounds that it holds."""
        beside = [name for name in names if name not in (best.effect.name, one.effect.name)]
        sizes = [make_effect(name, setting).size.name for name in beside]
        held = set(one.fit.theta.names) if beside else set()
        return [
            one.effect.name,
            *(n for n, size in zip(beside, sizes, strict=True) if size in held),
        ]

    def shorter(one: Refit) -> tuple[float, float]:
        """The score with steps half as long, and again up to ``enough``; what the last ones gained."""
        finer, fit, score, own = series, one.fit, one.score, kept.within(one.effect.name)
        while True:
            finer, extended = _finer(model, with_it(one), fit, finer)
            again = _refitted(extended, fit, finer, own)
            gained = 2.0 * (again.log_likelihood - fit.log_likelihood)
            score, fit, own = score + gained, again, own.further("half steps")
            if finer.substeps >= enough or gained < MARGIN:
                return score, max(gained, 0.0)

    def come_near(rivals: Sequence[Refit]) -> list[float]:
        """How far those are behind that are no longer so, or may not be by steps that are shorter still."""
        if not rivals:
            return []
        least = shorter(best)[0] - MARGIN
        return [best.score - one.score for one in rivals if sum(shorter(one)) > least]

    lead = best.score - max([0.0, *(one.score for one in others)])
    worth = _worth(model, names, fit, series)
    if worth > max(lead, MARGIN):
        nearest = [one for one in others if one.score > max(best.score - worth, 0.0)][:NEAREST]
        if series.substeps < enough or come_near(nearest):
            return worth
    behind = [
        one
        for one in others
        if best.score > one.score > 0.0
        and REACH * _worth(model, with_it(one), one.fit, series)
        > max(best.score - one.score, MARGIN)
    ]
    return max(come_near(behind), default=0.0)


def decided_by_steps(
    found: Round, series: Series, setting: Setting, kept: Kept, enough: int
) -> bool:
    """Whether the error of the steps may decide this first round, of fewer than ``enough`` steps a sample."""
    best = found.refits[0]
    if not enough or series.substeps >= enough or best.effect.traits.outliers:
        return False
    own = kept.apart("the first by half steps")
    try:
        return decides(found, [best.effect.name], best.fit, series, setting, own, enough) > 0.0
    except (EngineError, np.linalg.LinAlgError):
        return False


def steps_for_sizes(
    names: Sequence[str], fit: QuasiFit, series: Series, setting: Setting, most: int, kept: Kept
) -> int:
    """How many steps a sample, up to ``most``, of which twice as many move no parameter by half its error.

    An error in proportion to the step is then less than one standard error. ``fit`` is of the model with all
    effects that were found, ``names``.
    """
    model, k = setting.model, series.substeps
    theta = np.asarray(fit.theta)[: len(model.parameters)]
    if not can_be_finer(setting, series, theta, names):
        return k
    while k < most:
        finer, extended = _finer(model, names, fit, series)
        if WHOLE * apart(fit, extended, series, finer) < MOVED**2:
            break  # so small an error moves nothing by as much
        theta = _same(extended, fit)
        again = _refitted(extended, fit, finer, kept)
        free = extended.free_indices(fit.free)
        variance = np.diag(again.covariance)
        if ((np.asarray(again.theta) - theta)[free] ** 2 <= MOVED**2 * variance).all():
            break
        fit, series, k = again, finer, finer.substeps
    return k


def _finer(
    model: MixedModel, names: Sequence[str], fit: QuasiFit, series: Series
) -> tuple[Series, MixedModel]:
    """The record with steps half as long, and the extended model for it."""
    finer = series.held(series.hold).refined(2 * series.substeps)
    base = np.asarray(fit.theta)[: len(model.parameters)]
    return finer, extend(model, names, setting_for(model, finer, base))


def _worth(model: MixedModel, names: Sequence[str], fit: QuasiFit, series: Series) -> float:
    """What the error of the steps of an extended model is worth, 2 x log-likelihood, to first order."""
    finer, extended = _finer(model, names, fit, series)
    return WHOLE * apart(fit, extended, series, finer)


def _gained(extended: MixedModel, fit: QuasiFit, finer: Series, kept: Kept) -> float:
    try:
        refitted = _refitted(extended, fit, finer, kept)
    except (EngineError, np.linalg.LinAlgError):
        return 0.0
    return 2.0 * (refitted.log_likelihood - fit.log_likelihood)


def _refitted(extended: MixedModel, fit: QuasiFit, finer: Series, kept: Kept) -> QuasiFit:
    return kept.further("half steps").fit(
        extended, lambda: quasi_ml(extended, finer, _same(extended, fit), fit.free)
    )


def apart(fit: QuasiFit, other: MixedModel, series: Series, finer: Series) -> float:
    """Squared differences of one-step predictions at the samples, in their own scatter, summed.

    ``other`` is the fit's model for the ``finer`` record; its parameters may stand in another order.
    """
    same = _same(other, fit)
    pairs = ((fit.model, np.asarray(fit.theta), series), (other, same, finer))
    one, two = (moment_filter(m, theta[None], s) for m, theta, s in pairs)
    return predictions_apart(one, series, two, finer)


def _same(other: MixedModel, fit: QuasiFit) -> Array:
    """The fit's parameters (n_theta,) in the order of another model, within its bounds: some grow with dt."""
    known = fit.theta.asdict()
    return np.clip([known[name] for name in other.parameter_names], other.lower, other.upper)
