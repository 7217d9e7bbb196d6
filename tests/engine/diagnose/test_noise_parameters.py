"""Noise parameters among what a screen projects out."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.screening.noise_parameters import inside, noise_left_to_states
from engine.diagnose.screening.screening import screen_effects
from engine.estimation.quasi_ml import quasi_ml
from engine.filters.sigma_point import moment_path
from tests.engine.design.models_for_design import drive


def screened(model, series, free):
    fit = quasi_ml(model, series, None, free)
    setting = setting_for(model, series, np.asarray(fit.theta))
    return fit, screen_effects(
        fit, series, setting, ["drag", "cubic", "force"], 0.05, 0, lambda stage, share: None
    )


@pytest.fixture(scope="module")
def quiet():
    """A drive whose process noise is estimated at zero, its bound."""
    model = drive(q=0.02)
    u = np.repeat(np.random.default_rng(3).uniform(-6.0, 6.0, 8), 10)
    for seed in range(20):
        rng = np.random.default_rng([7, seed])
        series = engine.simulate(model, {"q": 0.0}, 80, rng, u=u, dt=0.1).series
        fit = quasi_ml(model, series, None, ["k", "b", "q", "r"])
        if fit.theta["q"] == 0.0:
            return model, series, fit
    raise AssertionError("in none of 20 records the noise was estimated at its bound")


def test_noise_at_its_bound_is_not_projected_out(quiet):
    """It is not estimated there: the screen is the one of a fit where it is held at the bound."""
    model, series, fit = quiet
    theta, every = np.asarray(fit.theta), model.free_indices(fit.free)
    left = inside(model, theta, every, series, moment_path(model, theta, series))
    assert [model.parameter_names[k] for k in left] == ["k", "b", "r"]
    _, free = screened(model, series, ["k", "b", "q", "r"])
    model = drive(q=0.0)
    _, held = screened(model, series, ["k", "b", "r"])
    for one, other in zip(free.scores, held.scores, strict=True):
        assert one.effect.name == other.effect.name
        assert one.statistic == pytest.approx(other.statistic, rel=0.02, abs=0.02)


def test_a_parameter_of_the_mean_at_its_bound_is_projected_out(quiet):
    model, series, fit = quiet
    theta = np.array(np.asarray(fit.theta))
    theta[model.parameter_names.index("b")] = 0.0
    every = model.free_indices(["k", "b", "r"])
    path = moment_path(model, theta, series)
    assert inside(model, theta, every, series, path).tolist() == every.tolist()


def test_it_is_said_when_the_noise_of_readings_is_estimated_at_nothing():
    """Whatever the model gets wrong is then noise of its states."""
    model = drive(q=0.02)
    free = [replace(p, bounds=(1e-9, 1.0)) if p.name == "r" else p for p in model.parameters]
    model = replace(model, parameters=free)
    u = np.repeat(np.random.default_rng(3).uniform(-6.0, 6.0, 8), 10)
    series = engine.simulate(model, {"r": 1e-9}, 80, 5, u=u, dt=0.1).series
    fit = quasi_ml(model, series, None, ["k", "b", "q", "r"])
    ends = {name: model.lower[model.index(name)] for name in ("r", "q")}
    for names, said in ((["r"], True), (["q"], False), (["r", "q"], False), ([], False)):
        values = {**fit.theta.asdict(), "r": 1e-3, **{name: ends[name] for name in names}}
        at = replace(fit, theta=model.theta(values))
        note = noise_left_to_states(at, series)
        assert bool(note) == said
    at = replace(fit, theta=model.theta({**fit.theta.asdict(), "r": ends["r"]}))
    assert "(r)" in noise_left_to_states(at, series)
    assert "(q)" in noise_left_to_states(at, series)
