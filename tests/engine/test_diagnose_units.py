"""The catalogue on other people's models: the same answers in all units, and from every zero."""

from functools import cache

import numpy as np
import pytest

from engine.diagnose.catalogue import all_effects
from engine.diagnose.columns import Projection, effect_columns
from engine.diagnose.families import family_test, is_timed
from engine.diagnose.setting import setting_for
from engine.moment_filter import moment_filter, moment_path
from tests.engine.plain_models import Units, pendulum, record, referred, room, tank

ROWS = 60
MODELS = {"room": room, "pendulum": pendulum, "tank": tank}


def seen(model, series):
    """{effect: its standardised scores, one per probe}, and the effects."""
    theta = np.asarray(model.theta())
    setting = setting_for(model, series, theta)
    path = moment_path(model, theta, series)
    out, effects = {}, {}
    for effect in all_effects(setting):
        if effect.kind == "heavy-tails":
            continue
        effects[effect.name] = effect
        if is_timed(effect):
            test = family_test(effect, model, theta, series, path, Projection([]))
            out[effect.name] = [] if test is None else test.statistics(test.s.sum(axis=1))
            continue
        columns = effect_columns(effect, model, theta, series, path)
        out[effect.name] = [c.s.sum() / max(np.linalg.norm(c.v), 1e-300) for _, c in columns]
    return out, effects


@cache
def plainly_seen(name, declared):
    """The scores of one of the models in the units it was written in."""
    model = MODELS[name]()
    return seen(referred(model) if declared else model, record(model, ROWS))


def compare(one, other, names):
    for name in names:
        np.testing.assert_allclose(
            np.asarray(other[name], dtype=float), one[name], rtol=2e-3, atol=2e-3, err_msg=name
        )


@pytest.mark.parametrize("name", MODELS)
def test_at_size_zero_every_effect_leaves_the_model_as_it_is(name):
    model = MODELS[name]()
    series = record(model, ROWS)
    theta = np.asarray(model.theta())
    base = moment_filter(model, theta[None], series).log_likelihood[0]
    setting = setting_for(model, series, theta)
    for effect in all_effects(setting):
        if effect.kind == "heavy-tails":
            continue
        extended = effect.apply(model)
        assert len(effect.probes[0]) == len(effect.parameters) - 1, effect.name
        at = np.array([[*theta, 0.0, *probe] for probe in effect.probes])
        values = moment_filter(extended, at, series).log_likelihood
        np.testing.assert_allclose(values, base, rtol=0.0, atol=1e-6, err_msg=effect.name)


@pytest.mark.parametrize("factor", [1e-3, 1e4])
@pytest.mark.parametrize("name", MODELS)
def test_scores_are_the_same_in_other_units(name, factor):
    model = MODELS[name]()
    series = record(model, ROWS)
    channels = [*model.nonlinear, *model.linear, *model.inputs, *model.outputs]
    factors = factor ** np.linspace(0.5, 1.0, len(channels))
    units = Units(
        model, {n: (f, 0.0) for n, f in zip(channels, factors, strict=True)}, (1.0 / factor, 0.0)
    )
    one, _ = plainly_seen(name, False)
    other, _ = seen(units.converted(), units.series(series))
    assert set(one) == set(other)
    compare(one, other, one)


@pytest.mark.parametrize("name", MODELS)
def test_scores_are_the_same_from_another_zero(name):
    model = MODELS[name]()
    series = record(model, ROWS)
    channels = [*model.nonlinear, *model.linear, *model.inputs, *model.outputs]
    shifts = {n: (1.0, 40.0 + 7.0 * i) for i, n in enumerate(channels)}
    for base, declared in ((model, False), (referred(model), True)):
        units = Units(base, shifts, (1.0, 300.0))
        one, effects = plainly_seen(name, declared)
        other, _ = seen(units.converted(), units.series(series))
        free = [n for n, effect in effects.items() if effect.zero is None]
        assert not declared or len(free) == len(effects)
        assert len(free) > 10
        compare(one, other, free)
