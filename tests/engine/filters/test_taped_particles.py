"""The particle filter through tapes is the one by calls, number for number."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

import engine
import engine.filters.rbpf
from engine.data.joined import joined
from engine.data.series import Series
from engine.filters.heavy_tails import with_mixture
from engine.filters.proposals import adapted
from engine.filters.rbpf import RESAMPLING, rbpf
from engine.kernels.taped_particles import filter_particles_taped
from engine.models.registry import get_model
from engine.statespace.model import Gaussian, MixedModel, Parameter
from tests.engine.models_for_tests import (
    awkward_series,
    linear_mixed,
    partly_noise_free,
    random_walk,
    theta_everywhere,
)

T, M = 50, 20


def both(model, series, monkeypatch, **options):
    """The filter through tapes, and by calls; each with the next number of its generator."""
    gone = []
    by_tape = engine.filters.rbpf.rows_by_tape

    def noted(*args):
        gone.append(by_tape(*args))
        return gone[-1]

    out = []
    for rows in (noted, lambda *_: None):
        rng = np.random.default_rng(5)
        with monkeypatch.context() as patch:
            patch.setattr(engine.filters.rbpf, "rows_by_tape", rows)
            out.append((rbpf(model, None, series, M, rng, **options), rng.random()))
    return gone[0] is not None, *out


def assert_same(taped, called):
    (one, next_of_one), (other, next_of_other) = taped, called
    assert next_of_one == next_of_other
    for field in fields(one):
        x, y = getattr(one, field.name), getattr(other, field.name)
        if field.name not in ("model", "theta", "series"):
            shape = np.broadcast_shapes(x.shape, y.shape)  # what is common may be said once
            np.testing.assert_allclose(
                *(np.broadcast_to(z, shape) for z in (x, y)),
                rtol=1e-7,
                atol=1e-9,
                err_msg=field.name,
            )


@pytest.mark.parametrize("proposal", ["adapted", "bootstrap"])
@pytest.mark.parametrize(
    "model",
    [
        linear_mixed(),
        linear_mixed(2, 0, True),
        linear_mixed(1),
        theta_everywhere(),
        theta_everywhere(False),
        partly_noise_free(),
        random_walk(),
        get_model("mixed-4"),
    ],
    ids=lambda model: model.name,
)
def test_it_is_what_calls_make(model, proposal, monkeypatch):
    """With uneven steps, missing readings and two records, which begin anew."""
    series = joined(awkward_series(model, T), awkward_series(model, T, seed=6))
    on_tape, taped, called = both(model, series, monkeypatch, proposal=proposal)
    assert on_tape
    assert_same(taped, called)


@pytest.mark.parametrize("resampling", RESAMPLING)
@pytest.mark.parametrize("threshold", [0.0, 0.5, 1.0])
def test_whatever_the_resampling(resampling, threshold, monkeypatch):
    model = theta_everywhere()
    options = {"resampling": resampling, "ess_threshold": threshold}
    on_tape, taped, called = both(model, awkward_series(model, T), monkeypatch, **options)
    assert on_tape
    assert_same(taped, called)


def test_what_depends_on_time_and_inputs_alone_is_common_to_all_particles(monkeypatch):
    """Their covariances are one, and found once."""
    model = linear_mixed()
    on_tape, (taped, _), _ = both(model, awkward_series(model, T), monkeypatch)
    assert on_tape
    assert taped.root.shape[1] == taped.L.shape[1] == 1


def leaking():
    """A tank that leaks no more once it was mended, as its model asks the clock."""

    def dynamics(a, u, t, dt, theta):
        if t < 30.0:
            return [a[:, 0] - theta.c], np.zeros((1, 0)), [[0.001]]
        return [a[:, 0]], np.zeros((1, 0)), [[0.001]]

    model = random_walk()
    given = {field.name: getattr(model, field.name) for field in fields(model)}
    given["parameters"] = [Parameter("c", 0.05, bounds=(0.0, 1.0))]
    given["measurement"] = lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[0.05]])
    given["initial"] = lambda theta: (Gaussian([2.0], [[0.01]]), [], np.zeros((0, 0)))
    return MixedModel(**given | {"dynamics": dynamics})


def test_where_another_way_is_taken_it_is_made_from_the_same_random_numbers(monkeypatch):
    model = leaking()
    series = Series(np.maximum(np.linspace(2.0, 0.0, T), 0.9)[:, None])
    on_tape, taped, called = both(model, series, monkeypatch)
    assert on_tape
    assert_same(taped, called)


def test_draws_of_other_kinds_are_called(monkeypatch):
    series = Series(np.zeros((T, 1)))
    mixture = with_mixture(random_walk())
    for model, proposal in ((random_walk(), lambda step: adapted(step)), (mixture, "adapted")):
        on_tape, taped, called = both(model, series, monkeypatch, proposal=proposal)
        assert not on_tape
        assert_same(taped, called)


def test_a_covariance_that_is_none_is_told_as_by_calls():
    def measurement(a, u, t, theta):
        return [a[:, 0]], np.zeros((1, 0)), [[theta.r - 0.3 * (t == 21.0)]]

    model = random_walk()
    given = {field.name: getattr(model, field.name) for field in fields(model)}
    bad = MixedModel(**given | {"measurement": measurement})
    with pytest.raises(engine.ModelError, match="t = 21"):
        rbpf(bad, None, Series(np.zeros((T, 1)), dt=1.0), M, 1)


class Square:
    """An initial density of a user, whose draws lie in memory by columns."""

    def sample(self, rng, n):
        return np.asfortranarray(rng.uniform(-1.0, 1.0, (n, 2)))

    def log_density(self, a):
        return np.where((np.abs(a) <= 1.0).all(axis=1), -2.0 * np.log(2.0), -np.inf)


def test_however_users_write_it_the_kernel_is_the_one_that_is_there(monkeypatch):
    """Inputs and draws by columns, and a share that is a whole number; each would be compiled for anew."""
    model = linear_mixed()
    rbpf(model, None, awkward_series(model, T), M, 1)
    before = list(filter_particles_taped.signatures)
    given = {field.name: getattr(model, field.name) for field in fields(model)}
    given["initial"] = lambda theta: (Square(), [1.0, 0.0], 0.1 * np.eye(2))
    own = MixedModel(**given)
    drawn = awkward_series(model, T)
    series = Series(np.asfortranarray(drawn.y), np.asfortranarray(drawn.u), t=drawn.t)
    on_tape, taped, called = both(own, series, monkeypatch, ess_threshold=1)
    assert on_tape
    assert_same(taped, called)
    assert list(filter_particles_taped.signatures) == before
