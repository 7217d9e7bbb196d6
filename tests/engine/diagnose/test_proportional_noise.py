"""Readings whose noise grows with what they read, of a model all of whose states are linear."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.diagnose import make_effect
from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.screening.score_columns import effect_columns
from engine.diagnose.search.pipeline import find_causes
from engine.filters.sigma_point import moment_path
from tests.engine.plain_models import Units, cart, pendulum, record, referred

PLASMA = engine.continuous(
    name="plasma",
    drift=lambda a, u, t, theta: ([u[0]], [[-theta.k]]),
    diffusion=lambda a, u, t, theta: [[1e-6]],
    measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r]]),
    initial=lambda theta: (None, [0.0], [[1e-4]]),
    linear={"level": "mg/L"},
    inputs={"dose": "mg/L/h"},
    outputs={"conc": "mg/L"},
    parameters=[
        engine.Parameter("k", 0.3, "1/h", (0.01, 5.0)),
        engine.Parameter("r", 0.02, "(mg/L)^2", (1e-6, 10.0)),
    ],
)


KINDS = [
    "relative-noise",
    "variance:conc->level",
    "variance:conc->dose",
    "level:conc",
    "heavy-tails:conc",
]


def assayed(seed, scatter):
    """Levels that rise and fall, read with a noise of ``scatter(level)``."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.0, 6.0, 12), 15)
    clean = engine.simulate(PLASMA, {"r": 1e-6}, len(u), rng, u=u, dt=0.25).series
    level = clean.y[:, 0]
    return clean.replace(y=(level + scatter(level) * rng.standard_normal(len(u)))[:, None])


@pytest.mark.parametrize(
    ("zeros", "own", "zero"),
    [
        ({}, [0.01, 2.0], 2.0),
        ({"conc": 1.5}, [0.01], 1.5),
    ],  # held there until data free it, or declared
)
def test_noise_is_a_share_of_what_is_read(zeros, own, zero):
    """Of a linear state, on which no variance may depend: it becomes a nonlinear one."""
    model = make_effect("relative-noise:conc", Setting(PLASMA, zeros=zeros)).apply(PLASMA)
    assert (list(model.nonlinear), list(model.linear)) == (["level"], [])
    level, theta = np.array([[-3.0], [0.5], [40.0]]), model.record(np.array([0.3, 0.02, *own]))
    h, _, R = model.observation(level, np.zeros(1), 0.0, theta)
    np.testing.assert_allclose(h, level)
    np.testing.assert_allclose(R[:, 0, 0], 0.02 + 0.01 * (level[:, 0] - zero) ** 2)


@pytest.mark.parametrize(
    ("low", "high", "asked"), [(1.0, 30.0, True), (28.0, 30.0, False), (-30.0, 30.0, True)]
)
def test_a_share_is_asked_for_only_where_readings_vary_in_relation_to_their_size(low, high, asked):
    """Else it is another level of the noise, and nothing tells the two apart."""
    y, u = np.linspace(low, high, 90), np.zeros(90)
    setting = setting_for(PLASMA, engine.Series(y, u, dt=0.25), np.asarray(PLASMA.theta()))
    assert ("relative-noise:conc" in {e.name for e in all_effects(setting)}) is asked


def test_a_reading_without_a_zero_has_no_share():
    series = record(cart(), 60)
    setting = setting_for(cart(), series, np.asarray(cart().theta()))
    assert "relative-noise" not in {e.kind for e in all_effects(setting)}
    declared = replace(cart(), reference={"tape": 0.0})
    setting = setting_for(declared, series, np.asarray(declared.theta()))
    assert "relative-noise:tape" in {e.name for e in all_effects(setting)}


def seen(model, series):
    """The standardised score of noise in proportion to the pendulum's reading."""
    theta = np.asarray(model.theta())
    effect = make_effect("relative-noise:y", setting_for(model, series, theta))
    path = moment_path(model, theta, series)
    ((_, column),) = effect_columns(effect, model, theta, series, path)
    return column.s.sum() / np.linalg.norm(column.v)


def test_a_share_is_the_same_in_other_units_and_from_another_declared_zero():
    model = referred(pendulum())
    series = record(model, 60)
    channels = [*model.nonlinear, *model.linear, *model.inputs, *model.outputs]
    each = {name: (3.0**i, 40.0 + 7.0 * i) for i, name in enumerate(channels)}
    units = Units(model, each, (1.0, 300.0))
    assert seen(units.converted(), units.series(series)) == pytest.approx(seen(model, series))


@pytest.mark.long
@pytest.mark.parametrize(
    ("scatter", "named"),
    [
        (lambda level: np.hypot(0.05, 0.08 * level), ["relative-noise:conc"]),
        (lambda level: 0.15, []),
    ],
)
def test_an_assays_error_in_percent_is_named_and_a_plain_one_is_not(scatter, named):
    found = find_causes(PLASMA, assayed(3, scatter), effects=KINDS, seed=1)
    assert [one.effect.name for one in found.search.named] == named
    if named:
        share = np.sqrt(found.search.final.theta["relative_noise_conc"])
        assert 0.06 < share < 0.1


@pytest.mark.long
def test_noise_may_grow_with_a_linear_state_that_is_read():
    """An assay's error in percent of what it reads: there was no effect for it, and the answer was nothing."""
    series = assayed(2, lambda level: 0.05 * np.exp(0.1 * level))
    kinds = ["variance:conc->level", "variance:conc->dose", "level:conc"]
    found = find_causes(PLASMA, series, effects=kinds, seed=1)
    assert [one.effect.name for one in found.search.named] == ["variance:conc->level"]
    theta = found.search.final.theta
    growth = 0.5 * theta["variance_conc_level"] / theta["variance_conc_level_per"]
    assert 0.07 < growth < 0.13


@pytest.mark.long
def test_noise_that_grows_otherwise_is_not_said_to_be_a_share_alone():
    found = find_causes(
        PLASMA, assayed(2, lambda level: 0.02 * np.exp(0.25 * level)), effects=KINDS, seed=1
    )
    first = found.search.rounds[0]
    assert "variance:conc->level" in {one.effect.name for one in first.equivalent}
