"""Inputs that a logger writes one row late: told of, and no direct path or outliers in their place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import Round
from engine.diagnose.search.between_samples import earlier, read_otherwise, read_wrongly
from engine.estimation.quasi_ml import quasi_ml

P = engine.Parameter


def cell(through: float, scale: float = 1.0) -> engine.MixedModel:
    """A branch driven by a current in ``scale`` A, whose reading takes ``through`` Ohm of it at once."""

    def dynamics(a, u, t, dt, theta):
        keep = np.exp(-theta.rate * dt)
        return [theta.R * (1.0 - keep) * scale * u[0]], [[keep]], [[theta.q * dt]]

    return engine.MixedModel(
        name="cell",
        nonlinear={},
        linear={"branch": "V"},
        inputs={"current": "A"},
        outputs={"volt": "V"},
        parameters=[
            P("R", 1.0, "Ohm", (0.01, 50.0)),
            P("rate", 0.1, "1/s", (0.01, 1.0)),
            P("q", 1e-5, "V^2/s", (0.0, 1.0)),
            P("r", 1e-3, "V^2", (1e-8, 1.0)),
        ],
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([through * scale * u[0]], [[1.0]], [[theta.r]]),
        initial=lambda theta: (engine.Gaussian([], np.zeros((0, 0))), [0.0], [[0.01]]),
    )


def written(seed: int, through: float, late: bool = True, direct: float = 0.0) -> engine.Series:
    """Readings of the cell, and its current as it was or one row late."""
    rng = np.random.default_rng(seed)
    n, keep, x = 300, np.exp(-0.15), 0.0
    u = np.repeat(rng.uniform(-1.0, 3.0, n // 6), 6)
    y = np.zeros(n)
    for t in range(n):
        y[t] = x + (through + direct) * u[t] + 0.03 * rng.standard_normal()
        x = keep * x + 1.4 * (1.0 - keep) * u[t] + 0.003 * rng.standard_normal()
    given = np.concatenate([u[:1], u[:-1]]) if late else u
    return engine.Series(y, given, dt=1.0, y_names=["volt"], u_names=["current"])


def searched(model, series, effects, gains):
    """A fit of the model, and a search whose first round has refits of such gains beside it."""
    base = quasi_ml(model, series)
    setting = setting_for(model, series, base.theta)
    refits = []
    for name, gain in zip(effects, gains, strict=True):
        effect = make_effect(name, setting)
        theta = effect.apply(model).theta(base.theta.asdict())
        fit = replace(base, theta=theta, log_likelihood=base.log_likelihood + 0.5 * gain)
        refits.append(Refit(effect, fit, gain, gain))
    first = Round(None, tuple(refits), None, tuple(refits[:1]))
    return Search(base, refits[0].fit, (first,), False)


def nothing_more(fit, series):
    empty = Round(None, (), None, ())
    return Search(fit, fit, (empty,), False)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_outliers_are_no_name_where_the_input_comes_a_row_late(seed, scale):
    series, model = written(seed, 2.0), cell(2.0, scale)
    series = series.replace(u=series.u / scale)
    found = searched(model, series, ["heavy-tails:volt"], [60.0])
    said = read_wrongly(found, series, ("foh", "past"), nothing_more)
    assert said.startswith("Read with current one row earlier the model as it is gains")
    assert "move its column up by a row" in said


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_they_are_where_it_does_not(seed):
    series = written(seed, 2.0, late=False)
    found = searched(cell(2.0), series, ["heavy-tails:volt"], [60.0])
    assert read_wrongly(found, series, ("foh", "past"), nothing_more) == ""


def test_columns_are_moved_within_a_record_and_the_last_one_is_held():
    u = np.arange(12.0).reshape(6, 2)
    series = engine.Series(np.zeros(6), u)
    moved = earlier(series.refined(3), [1])
    assert moved.u[:, 0].tolist() == u[:, 0].tolist()
    assert moved.u[:, 1].tolist() == [3.0, 5.0, 7.0, 9.0, 11.0, 11.0]


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_a_reading_without_a_size_is_said_before_a_direct_path(seed):
    series = written(seed, 0.0)
    model = cell(0.0)
    worth = 2.0 * (quasi_ml(model, series.held("past")).log_likelihood)
    gain = worth - 2.0 * quasi_ml(model, series).log_likelihood
    pair = ["direct:current->volt", "hold:current"]
    other = read_otherwise(searched(model, series, pair, [gain, gain - 1.0]), series, nothing_more)
    assert other is not None
    assert [one.effect.name for one in other.search.named] == ["hold:current"]
    assert "direct:current->volt, which says nearly the same" in other.note
    more = searched(model, series, pair, [gain + 20.0, gain - 1.0])
    assert read_otherwise(more, series, nothing_more) is None


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_direct_path_keeps_its_name_and_a_late_input_has_none(seed):
    asked = ["direct", "hold", "bias", "heavy-tails:volt"]
    found = engine.diagnose(cell(0.0), written(seed, 0.0, False, 0.3), effects=asked, processes=1)
    assert [cause.effect for cause in found.causes] == ["direct:current->volt"]
    found = engine.diagnose(cell(0.0), written(seed, 0.0), effects=asked, processes=1)
    assert [cause.effect for cause in found.causes] == ["hold:current"]
