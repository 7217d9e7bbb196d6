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
    assert not {"relative-noise:tape", "relative-noise:position"} & {
        e.name for e in all_effects(setting)
    }
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


STOCK = engine.continuous(
    name="stock",
    drift=lambda a, u, t, theta: ([theta.K / theta.tau], [[-1.0 / theta.tau]]),
    diffusion=lambda a, u, t, theta: [[theta.q]],
    measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r]]),
    initial=lambda theta: (None, [theta.K], [[100.0]]),
    linear={"biomass": "t"},
    outputs={"catch": "t"},
    parameters=[
        engine.Parameter("tau", 8.0, "year", (0.1, 200.0)),
        engine.Parameter("K", 20.0, "t", (0.0, 500.0)),
        engine.Parameter("q", 1.0, "t^2/year", (0.0, 1e3)),
        engine.Parameter("r", 0.1, "t^2", (1e-6, 1e6)),
    ],
)


def grown(seed, scatter):
    """A stock that good and bad years move by ``scatter(biomass)``, in twenty steps a year."""
    rng, x, y = np.random.default_rng(seed), 20.0, []
    for _ in range(250):
        y.append(x + 0.3 * rng.standard_normal())
        for dw in np.sqrt(0.05) * rng.standard_normal(20):
            x = max(x + 0.05 * (20.0 - x) / 8.0 + scatter(x) * dw, 1e-6)
    return engine.Series(np.array(y), dt=1.0, time_unit="year")


@pytest.mark.long
@pytest.mark.parametrize(
    ("scatter", "named"),
    [
        (lambda x: 0.25 * x, ["relative-noise:biomass"]),
        (lambda x: 2.0, []),
    ],
)
def test_process_noise_in_proportion_to_a_linear_state_is_named(scatter, named):
    """There was no effect for it, and a sensor that saturates or bends was named."""
    kinds = ["saturation-sensor", "cubic-sensor", "rectification", "variance", "relative-noise"]
    found = find_causes(STOCK, grown(1, scatter), effects=kinds, seed=1)
    assert [one.effect.name for one in found.search.named] == named
    if named:
        share = np.sqrt(found.search.final.theta["relative_noise_biomass"])
        assert 0.2 < share < 0.3  # of the stock in a year, whatever the model's own noise was


@pytest.mark.parametrize("dt", [1.0, 0.25])
def test_noise_is_a_share_of_a_state_in_each_unit_of_time(dt):
    """By its mean over the step: with the state at its beginning alone, rain in a store was missed."""
    setting = Setting(STOCK, zeros={"biomass": 2.0}, time_unit="year")
    effect = make_effect("relative-noise:biomass", setting)
    model = effect.apply(STOCK)
    assert list(model.nonlinear) == ["biomass"]
    theta = model.theta({"relative_noise_biomass": 0.04})
    a = np.array([[2.0], [12.0]])
    Q = model.transition(a, np.zeros(0), 0.0, dt, model.record(theta))[2]
    own = STOCK.transition(np.zeros((1, 0)), np.zeros(0), 0.0, dt, STOCK.record(STOCK.theta()))[2]
    ends = 20.0 + (a[:, 0] - 20.0) * np.exp(-dt / 8.0)
    squares = 0.5 * ((a[:, 0] - 2.0) ** 2 + (ends - 2.0) ** 2)
    assert Q[:, 0, 0] - own.item() == pytest.approx(0.04 * dt * squares)
    assert effect.size.unit == "1/year"


def test_noise_may_grow_with_a_linear_state_itself_as_with_a_nonlinear_one():
    names = {e.name for e in all_effects(Setting(STOCK))}
    assert {"variance:biomass->biomass", "variance:catch->biomass"} <= names
