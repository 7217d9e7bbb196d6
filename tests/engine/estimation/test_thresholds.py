"""Levels at which a model jumps: the slope of a trajectory's density says nothing of where they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.estimation.particle_likelihood import likelihood_of
from engine.estimation.thresholds import jumping

P = engine.Parameter
LEVEL = P("level", -0.2, "1", (-10.0, 10.0))
NONE = np.zeros((1, 0))


def model_of(dynamics, *more: engine.Parameter) -> engine.MixedModel:
    """A state that is measured well, with the parameter ``level`` and others."""
    return engine.MixedModel(
        name="levels",
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([a[:, 0]], NONE, [[0.05**2]]),
        initial=lambda theta: (engine.Gaussian([0.0], [[1.0]]), [], np.zeros((0, 0))),
        nonlinear={"x": "1"},
        linear={},
        outputs={"y": "1"},
        parameters=[LEVEL, P("keep", 0.5, "1", (-1.0, 1.0)), *more],
    )


def in_noise(a, u, t, dt, theta):
    q = np.where(a[:, 0] > theta.level, theta.above, theta.below) ** 2
    return [theta.keep * a[:, 0]], NONE, q[:, None, None]


def in_mean(a, u, t, dt, theta):
    x = a[:, 0]
    return [theta.keep * x - np.where(x > theta.level, theta.level, 0.0)], NONE, [[0.3]]


def bend(a, u, t, dt, theta):
    return [theta.keep * np.maximum(a[:, 0] - theta.level, 0.0)], NONE, [[0.3]]


def weir(a, u, t, dt, theta):
    return [theta.keep * np.sqrt(np.maximum(a[:, 0] - theta.level, 0.0))], NONE, [[0.3]]


def sign(a, u, t, dt, theta):
    return [theta.keep * np.sign(a[:, 0]) + theta.level], NONE, [[0.3]]


NOISES = P("below", 0.3, "1", (1e-3, 10.0)), P("above", 0.5, "1", (1e-3, 10.0))


def record(T: int) -> engine.Series:
    """A state whose steps are three times as wide above 0.3."""
    rng, x, y = np.random.default_rng(4), 0.0, []
    for _ in range(T):
        y.append(x + 0.05 * rng.standard_normal())
        x = 0.8 * x + (1.0 if x > 0.3 else 0.3) * rng.standard_normal()
    return engine.Series(np.array(y))


@pytest.mark.parametrize(
    ("dynamics", "more", "found"),
    [
        (in_noise, NOISES, ["level"]),
        (in_mean, (), ["level"]),
        (bend, (), []),
        (weir, (), []),
        (sign, (), []),  # it jumps where no parameter moves it
    ],
)
def test_parameters_that_move_a_jump_are_known(dynamics, more, found):
    model = model_of(dynamics, *more)
    indices = model.free_indices(None)
    jumps = jumping(model, model.theta(), [record(200)], indices, 20)
    assert [model.parameter_names[k] for k in indices[jumps]] == found


def test_steps_that_a_bound_cuts_are_no_jump():
    """Next to it the longer one is no longer than the other, and what changes by both is as large."""
    model = model_of(lambda a, u, t, dt, theta: ([theta.keep * a[:, 0]], NONE, [[0.3]]))
    series = engine.simulate(model, None, 100, 1).series
    for keep in (0.999, -0.999):
        theta = model.theta({"keep": keep})
        assert not jumping(model, theta, [series], np.arange(2), 50).any()


@pytest.mark.slow
def test_a_level_at_which_noise_grows_is_estimated():
    """It stood at its start, 88 nats below the maximum, and was said not to enter the likelihood."""
    model, series = model_of(in_noise, *NOISES), record(400)
    found = engine.rbps_em(model, series, seed=1)
    assert found.outcome is engine.Outcome.CONVERGED
    assert not found.not_estimated
    assert abs(found.theta["level"] - 0.4) < 0.06  # the maximum by a filter on a grid
    assert abs(found.theta["above"] - 1.0) < 0.2
    assert "level" in engine.standard_errors(model, found, series).names


def dead_zone(a, u, t, dt, theta):
    x = a[:, 0]
    return [np.where(abs(x) < theta.level, x, theta.keep * x) + u[0]], NONE, [[0.2**2]]


@pytest.mark.long
def test_a_level_is_looked_for_beyond_the_nearest_maximum():
    """Of 22 records three ended below one at which the level was half of what it is, as settled."""
    rng, x, y = np.random.default_rng(13), 0.0, []
    u = rng.standard_normal((250, 1))
    for now in u[:, 0]:
        y.append(x + 0.05 * rng.standard_normal())
        x = (x if abs(x) < 1.0 else 0.7 * x) + now + 0.2 * rng.standard_normal()
    model = replace(model_of(dead_zone), inputs={"u": "1"})
    series, theta = engine.Series(np.array(y), u=u), model.theta({"level": 0.384, "keep": 0.718})
    likelihood = likelihood_of(model, [series], theta, 50, model.free_indices(None))
    there, gain = likelihood.ahead(theta, ["level", "keep"])
    assert abs(there["level"] - 1.0) < 0.1
    assert np.isclose(gain, likelihood.of(there) - likelihood.of(theta))
    assert gain > 5.0


def heater(a, u, t, dt, theta):
    """A room that is heated below a level; temperatures are counted from far below it."""
    x = a[:, 0] - ZERO
    heat = np.where(x < theta.level - ZERO, 1.0, 0.0)
    return [ZERO + x + 0.1 * (u[0] - x) + heat], NONE, [[0.1**2]]


ZERO = 293.0


def room(T: int, seed: int) -> tuple[engine.MixedModel, engine.Series]:
    model = engine.MixedModel(
        name="room",
        dynamics=heater,
        measurement=lambda a, u, t, theta: ([a[:, 0]], NONE, [[0.2**2]]),
        initial=lambda theta: (engine.Gaussian([ZERO], [[1.0]]), [], np.zeros((0, 0))),
        nonlinear={"x": "K"},
        inputs={"outside": "K"},
        outputs={"y": "K"},
        parameters=[P("level", ZERO, "K", (0.0, 400.0))],
    )
    u = (-6.0 + 3.0 * np.sin(np.arange(T) / 20.0))[:, None]
    return model, engine.simulate(model, None, T, np.random.default_rng(seed), u=u, dt=1.0).series


@pytest.mark.long
def test_the_slope_of_a_level_does_not_depend_on_where_its_zero_is():
    """It was a secant over 5 % of 293 K to either side, of a level that is known to 0.02 K."""
    model, series = room(150, 1000)
    theta, level = model.theta(), model.free_indices(None)
    likelihood = likelihood_of(model, [series], theta, 50, level)
    values = {off: likelihood.of(model.theta([ZERO + off])) for off in (-0.1, -0.05, 0.05, 0.1)}
    for low, high in ((-0.1, -0.05), (0.05, 0.1)):
        slope, information = likelihood.score(model.theta([ZERO + 0.5 * (low + high)]), level)
        exact = (values[high] - values[low]) / (high - low)
        assert slope[0] == pytest.approx(exact, abs=0.3 * abs(exact))
        assert 0.01 < 1.0 / np.sqrt(information[0, 0]) < 0.05


@pytest.mark.slow
def test_errors_of_a_level_cover_it():
    """Estimates were 3 to 7 of their errors above the level, "converged"."""
    each = []
    for seed in range(1000, 1005):
        model, series = room(200, seed)
        found = engine.rbps_em(model, series, seed=1)
        errors = engine.standard_errors(model, found, series)
        assert "moment filter" not in errors.warning  # it is blind to levels
        each.append((found.theta["level"] - ZERO) / errors.values[0])
    assert np.abs(each).max() < 3.0
    assert np.sqrt(np.mean(np.square(each))) < 1.8
