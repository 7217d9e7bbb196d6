"""Columns of effects with states of their own: where their filters start, how far a size is stepped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine import get_model, simulate
from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.setting import Setting
from engine.diagnose.screening import score_columns
from engine.diagnose.screening.score_columns import (
    REACH_ERRORS,
    Column,
    Projection,
    effect_columns,
)
from engine.filters.sigma_point import moment_path

KINDS = ["pole", "mode", "colored", "latent", "delay"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["servo", "tanks", "oscillator"])
def test_the_base_s_way_serves_an_effect_s_filters(name, monkeypatch):
    """As filters of their own do, run step by step, but for what is of third order in the step."""
    model = get_model(name)
    theta = np.asarray(model.theta())
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(0.5, 2.0, 30), 10) if model.inputs else None
    series = simulate(model, None, 300, rng, u=u, dt=0.05).series
    path = moment_path(model, theta, series)
    setting = Setting(model)
    effects = [
        effect
        for effect in all_effects(setting, KINDS)
        if effect.apply(model).nonlinear == model.nonlinear and effect.apply(model).nx > model.nx
    ]
    assert len(effects) >= 3
    found = [effect_columns(effect, model, theta, series, path) for effect in effects]
    assert any(found)
    monkeypatch.setattr(score_columns, "visited_on", lambda path, na: None)
    for effect, columns in zip(effects, found, strict=True):
        alone = effect_columns(effect, model, theta, series, path)
        assert [probe for probe, _ in columns] == [probe for probe, _ in alone]
        for (_, one), (_, other) in zip(columns, alone, strict=True):
            scale = np.linalg.norm(other.v)
            assert np.linalg.norm(one.v - other.v) < 1e-2 * scale, effect.name
            assert np.linalg.norm(one.s - other.s) < 1e-2 * np.linalg.norm(other.s), effect.name


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_a_step_is_found_in_three_attempts_whatever_the_unit(power, unit):
    """A prediction that answers to a size in proportion needs two."""
    step, before, attempts = 1e-3, None, 0
    while True:
        attempts += 1
        now = step, 0.3 * REACH_ERRORS * (step / (1e-3 * unit)) ** power
        if abs(np.log(now[1] / REACH_ERRORS)) < 0.1:
            break
        step, before = score_columns._next_step(now, before), now
    far = 4 if unit != 1.0 else 0  # a step changes by 1e4 at most
    assert attempts <= (2 if power == 1.0 else 3) + far


def test_a_step_that_shows_nothing_or_loses_the_filter_is_changed_first():
    assert score_columns._next_step((1e-3, 0.0), None) > 1e-3
    assert score_columns._next_step((1e-3, np.nan), None) < 1e-3
    # what was seen before a lost filter tells no power
    assert score_columns._next_step((1e-5, 0.01), (1e-3, np.inf)) == pytest.approx(0.5e-5)


@pytest.mark.parametrize("given", [(1, 1), (4, 1), (1, 3), (4, 3)])
@pytest.mark.parametrize("writeable", [True, False])
def test_matrices_are_of_one_kind_whoever_made_them(given, writeable):
    """A kernel is compiled for each: seconds, in the middle of a diagnosis."""
    matrix = np.random.default_rng(0).standard_normal((*given, 2, 2))
    matrix.flags.writeable = writeable
    rows = score_columns._rows(matrix, 4, 3)
    assert rows.flags.c_contiguous
    assert rows.flags.writeable
    whole = np.broadcast_to(matrix, (4, 3, 2, 2)).reshape(12, 2, 2)
    np.testing.assert_array_equal(np.broadcast_to(rows, whole.shape), whole)


def test_what_all_columns_share_is_found_once(monkeypatch):
    model = get_model("mixed-4")
    theta = np.asarray(model.theta())
    series = simulate(model, None, 100, np.random.default_rng(4)).series
    path, asked = moment_path(model, theta, series), []
    scatter = score_columns._scatter
    monkeypatch.setattr(score_columns, "_scatter", lambda path: asked.append(path) or scatter(path))
    for effect in all_effects(Setting(model), ["bias", "offset"]):
        assert effect_columns(effect, model, theta, series, path)
    assert asked == [path]


def test_a_parameter_beside_which_the_filter_is_lost_takes_nothing_out():
    rng = np.random.default_rng(4)
    known, lost = (Column(rng.standard_normal(30), rng.standard_normal(60)) for _ in range(2))
    s, v = rng.standard_normal((2, 30)), rng.standard_normal((2, 60))
    beside = replace(lost, v=np.where(np.arange(60) == 7, np.nan, lost.v))
    for one, other in zip(
        Projection([known])(s, v), Projection([known, beside])(s, v), strict=True
    ):
        assert np.array_equal(one, other)
