"""The filter at neighbouring parameters, followed by slopes, against the filter itself."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from engine import Series, get_model, simulate
from engine.estimation.differences import neighbours
from engine.estimation.quasi_ml import derivatives
from engine.filters import neighbours as module
from engine.filters.filter_steps import FilterSteps, Thetas
from engine.filters.neighbours import (
    Visited,
    filter_all,
    filter_neighbours,
    followed,
    visited_on,
)
from engine.filters.sigma_point import moment_filter, moment_path, run_filter

MODELS = ("mixed-4", "servo", "tanks", "linear-2", "oscillator")


def one_vector_a_call(model):
    """The same model written by somebody whose functions take one parameter vector a call, as a key."""
    known = {}

    def plain(theta):
        return known.setdefault(theta, theta)

    def dynamics(a, u, t, dt, theta):
        return model.dynamics(a, u, t, dt, plain(theta))

    def measurement(a, u, t, theta):
        return model.measurement(a, u, t, plain(theta))

    return replace(model, dynamics=dynamics, measurement=measurement)


def record(name, T=120, gaps=True):
    model = get_model(name)
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(0.5, 2.0, T // 10), 10) if model.inputs else None
    series = simulate(model, None, T, rng, u=u, dt=0.05).series
    if not gaps:
        return model, series
    y = series.y.copy()
    y[20:27] = np.nan
    y[50, 0] = np.nan
    return model, Series(y, u=series.u, t=series.t)


@pytest.mark.parametrize("name", MODELS)
def test_derivatives_are_those_of_the_filter_itself(name):
    model, series = record(name)
    theta, free = np.asarray(model.theta()), np.arange(len(model.parameters))
    value, g, H = derivatives(model, [series], theta, free)
    value_2, g_2, H_2 = derivatives(one_vector_a_call(model), [series], theta, free)
    errors = np.sqrt(np.maximum(np.diag(np.linalg.pinv(H, hermitian=True)), 0.0))
    assert value_2 == pytest.approx(value, rel=1e-12)
    # differences of the likelihood hold no more digits than it has
    noise = 1e-14 * abs(value) / (1e-4 * np.abs(theta))
    assert (np.abs(g_2 - g) * errors <= 1e-4 * np.abs(g * errors) + 1e-4 + noise * errors).all()
    assert np.allclose(H_2, H, rtol=1e-4, atol=1e-6 * np.abs(H).max())


def test_such_a_model_is_called_once_at_every_time():
    calls = {"all": 0, "single": 0}
    model, series = record("mixed-4")
    model = one_vector_a_call(model)

    def counted(a, u, t, dt, theta):
        calls["all"] += 1
        calls["single"] += np.ndim(t) == 0
        return model.dynamics(a, u, t, dt, theta)

    counting = replace(model, dynamics=counted)
    thetas = neighbours(counting, np.asarray(model.theta()), np.arange(5))
    filter_neighbours(counting, thetas, series)  # looks what the function takes
    calls.update(all=0, single=0)
    filter_neighbours(counting, thetas, series)
    assert calls["all"] < 2 * len(series)
    calls.update(all=0, single=0)
    moment_filter(counting, thetas, series)
    assert calls["single"] > 10 * len(series)


def test_blocks_of_rows_make_no_difference(monkeypatch):
    model, series = record("tanks")
    thetas = neighbours(model, np.asarray(model.theta()), np.arange(4))
    whole = followed(FilterSteps(model, Thetas(model, thetas), series))
    monkeypatch.setattr(module, "NUMBERS", 2000)
    parts = followed(FilterSteps(model, Thetas(model, thetas), series))
    assert np.array_equal(whole.log_terms, parts.log_terms)
    assert np.array_equal(whole.S, parts.S)


def test_what_is_far_is_filtered_itself():
    model, series = record("tanks", gaps=False)
    model = one_vector_a_call(model)
    thetas = np.repeat(np.asarray(model.theta())[None], 5, axis=0)
    thetas[1:, 0] *= [0.5, 0.8, 1.3, 2.0]
    assert followed(FilterSteps(model, Thetas(model, thetas), series)) is None
    found = filter_neighbours(model, thetas, series)
    assert np.array_equal(found.log_terms, moment_filter(model, thetas, series).log_terms)


def test_a_step_of_an_input_seen_by_no_other_row_is_not_taken_for_another():
    """Irregular times and inputs of their own: rows must not be mixed up."""
    model, _ = record("servo")
    rng = np.random.default_rng(8)
    t = np.cumsum(rng.uniform(0.01, 0.05, 60))
    u = rng.standard_normal(60)
    y = rng.standard_normal((60, 1)) * 1e-3
    series = Series(y, u=u, t=t)
    thetas = neighbours(model, np.asarray(model.theta()), np.arange(len(model.parameters)))
    near = followed(FilterSteps(model, Thetas(model, thetas), series))
    exact = moment_filter(model, thetas, series)
    assert np.allclose(near.innovations, exact.innovations, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("share", [1e-3, 0.05, 0.5])
@pytest.mark.parametrize("name", MODELS)
def test_points_of_another_theta_lead_to_the_same_filter(name, share):
    """However far that theta was; where it is too far the filter is run step by step."""
    model, series = record(name)
    theta, visited = np.asarray(model.theta()), Visited()
    free = np.arange(len(theta))
    rng = np.random.default_rng(5)
    before = np.clip(
        theta * (1.0 + share * rng.uniform(-1.0, 1.0, len(theta))), model.lower, model.upper
    )
    filter_neighbours(model, neighbours(model, before, free), series, visited)
    thetas = neighbours(model, theta, free)
    found = filter_neighbours(model, thetas, series, visited)
    exact = moment_filter(model, thetas, series)
    np.testing.assert_allclose(found.log_terms[:, 0], exact.log_terms[:, 0], rtol=1e-7, atol=1e-9)
    for own, other in ((found.log_terms, exact.log_terms), (found.S, exact.S)):
        one, two = (x[:, 2::2] - x[:, 1::2] for x in (own, other))
        np.testing.assert_allclose(one, two, rtol=0.0, atol=1e-4 * np.abs(two).max())


@pytest.mark.parametrize("name", MODELS)
def test_a_filter_s_way_tells_the_points_it_looked_at(name):
    model, series = record(name)
    theta = np.asarray(model.theta())
    shape = (len(series), 2 * model.na + 1, model.na)
    own = np.empty(shape), np.empty(shape)
    run_filter(FilterSteps(model, Thetas(model, theta), series), own)
    told = visited_on(moment_path(model, theta, series), model.na)
    np.testing.assert_allclose(told.seen, own[0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(told.moved[:-1], own[1][:-1], rtol=1e-9, atol=1e-12)
    assert len(told.part(7).seen) == len(told.part(7).moved) == 7


@pytest.mark.parametrize("name", ["mixed-4", "servo", "tanks"])
def test_each_theta_has_its_own_filter_from_points_of_another(name, monkeypatch):
    """Those that are near, and those that must be filtered step by step, in their order."""
    model, series = record(name)
    model = one_vector_a_call(model)
    theta = np.asarray(model.theta())
    visited = visited_on(moment_path(model, theta, series), model.na)
    seen, moved = visited.seen.copy(), visited.moved.copy()
    far = np.clip(0.3 * theta, model.lower, model.upper)
    thetas = np.stack([theta, 1.01 * theta, far, 0.95 * theta, theta * (1.0 + 1e-6)])
    thetas = np.clip(thetas, model.lower, model.upper)
    exact = moment_filter(model, thetas, series)
    stepwise = []

    def counted(model, some, series):
        stepwise.append(len(some))
        return moment_filter(model, some, series)

    monkeypatch.setattr(module, "moment_filter", counted)
    found = filter_all(model, thetas, series, visited)
    assert sum(stepwise) <= 2
    np.testing.assert_allclose(found.log_terms, exact.log_terms, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(found.S, exact.S, rtol=1e-6, atol=1e-9 * np.abs(exact.S).max())
    assert np.array_equal(seen, visited.seen)
    assert np.array_equal(moved, visited.moved)


def test_a_theta_that_cannot_be_calculated_loses_beside_others():
    model, series = record("mixed-4")

    def dynamics(a, u, t, dt, theta):
        assert np.ndim(theta[0]) == 0
        root = math.sqrt(theta.theta_1)  # of a negative number: ValueError
        return model.dynamics(a, u, t, dt, theta._replace(theta_1=root**2))

    picky = replace(model, dynamics=dynamics)
    theta = np.asarray(model.theta())
    visited = visited_on(moment_path(model, theta, series), model.na)
    thetas = np.stack([theta, theta])
    thetas[1, 0] = -1.0
    found = filter_all(picky, thetas, series, visited).log_likelihood
    assert np.isfinite(found[0])
    assert found[1] == -np.inf
