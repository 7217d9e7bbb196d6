"""Every effect of the catalogue tested on a fitted model: scores, families over time, tails."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.screening.noise_parameters import inside
from engine.diagnose.screening.score_columns import Projection, effect_columns, parameter_columns
from engine.diagnose.screening.screen import Screen, Test, make_test, screen
from engine.diagnose.screening.tails import ROUGH, fit_tails, pit_of, standardised_errors, tail_test
from engine.diagnose.screening.time_scan import family_test, is_timed
from engine.distributions import chi2_sf
from engine.errors import EngineError, OptionError
from engine.estimation.quasi_ml import QuasiFit
from engine.filters.sigma_point import moment_path
from engine.forked import each
from engine.words import meant

# P-value from which outliers are judged by their likelihood, whatever their rank.
TAILS_ALARM = 1e-3

Progress = Callable[[str, float], Any]


def screen_effects(
    fit: QuasiFit,
    series: Series,
    setting: Setting,
    kinds: Sequence[str] | None,
    alpha: float,
    seed: int,
    progress: Progress,
    outliers: Effect | None = None,
    asked: Callable[[Effect], bool] = lambda effect: True,
) -> Screen:
    """Every effect of the catalogue tested on a fitted model, or those that are ``asked`` for.

    With ``outliers`` found and taken out no others are looked for, nor is their channel's noise: what
    is left of it, smaller outliers and a cut, is no finding of its own. The score of an effect does not depend
    on which others are tested.
    """
    model, theta = fit.model, np.asarray(fit.theta)
    path = moment_path(model, theta, series)
    indices = inside(model, theta, model.free_indices(fit.free), series, path)
    projection = Projection(parameter_columns(model, theta, indices, series))
    # those of the base model: a change of what an effect itself added is no cause of its own
    effects = [e for e in all_effects(setting, kinds) if e.size.name not in model.parameter_names]
    effects = [e for e in effects if asked(e)]
    if outliers is not None:
        left = outliers.channel
        effects = [e for e in effects if not e.traits.outliers and not _noise_of(e, left)]
    errors = None
    if any(
        e.traits.outliers for e in effects
    ):  # particles tell them, which take longer than the rest
        errors = standardised_errors(path, series.observed, pit_of(fit, series, seed))

    def tested(effect: Effect) -> Test | None:
        try:
            if effect.traits.outliers:
                test = None if errors is None else tail_test(effect, model, path, errors)
                return None if test is None else _confirmed(test, fit, series)
            if is_timed(effect):
                return family_test(effect, model, theta, series, path, projection)
            columns = effect_columns(effect, model, theta, series, path)
            return make_test(effect, [columns], projection)
        except (EngineError, np.linalg.LinAlgError):
            return None  # an extension whose filter is lost explains nothing

    tests: list[Test] = []
    progress("screen", 0.0)
    with closing(each([partial(_numbers_of, tested, effect) for effect in effects])) as found:
        for i, (effect, numbers) in enumerate(zip(effects, found, strict=True), 1):
            progress("screen", i / len(effects))
            if numbers:
                tests.append(Test(effect, *numbers))
    if not tests:
        raise OptionError(
            f"none of the effects asked for can be tested on model '{model.name}' and these data"
            f"{meant(kinds[0], [e.name for e in all_effects(setting)]) if kinds else ''}",
            "effects",
        )
    return screen(tests, np.random.default_rng(np.random.SeedSequence(seed)), alpha)


def _numbers_of(tested: Callable[[Effect], Test | None], effect: Effect) -> tuple[Any, ...]:
    """A test without its effect, which has functions; empty where there is none."""
    test = tested(effect)
    return () if test is None else tuple(getattr(test, of.name) for of in fields(test)[1:])


def _noise_of(effect: Effect, channel: str) -> bool:
    """Whether an effect changes the size of a channel's noise."""
    return effect.traits.noise_level and effect.channel.partition("->")[0] == channel


def _confirmed(test: Test, fit: QuasiFit, series: Series) -> Test:
    """A test of tails that would raise an alarm, judged by the refitted likelihood ratio instead.

    Predictions by few particles, or by moments where densities are far from Gaussian, look heavy-tailed
    too; then outliers in the model gain nothing.
    """
    if test.known is None or test.known[1] > TAILS_ALARM:
        return test
    gain, _ = fit_tails(fit, test.effect, series, ROUGH, enough=test.known[0])
    ratio = max(gain, 0.0)
    if ratio >= test.known[0]:
        return test
    return replace(test, known=(ratio, 0.5 * float(chi2_sf(ratio, 1))))
