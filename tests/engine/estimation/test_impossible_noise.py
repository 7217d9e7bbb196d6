"""Where a covariance would be none, theta is impossible: no search ends there and no filter runs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import engine
from engine.estimation.quasi_ml import log_likelihoods, quasi_ml
from engine.filters.sigma_point import moment_filter
from engine.kernels.gaussian import is_impossible

WHITE = [engine.Series(np.random.default_rng(k).standard_normal(60), dt=1.0) for k in (1, 2)]


def level(na=0, unit=1.0, bounds=(-np.inf, np.inf)):
    """A local level whose variances have no bounds unless they are given."""
    none = np.zeros((1, 0))

    def initial(th):
        if na:
            return engine.Gaussian([0.0], [[th.p]]), [], np.zeros((0, 0))
        return None, [0.0], [[th.p]]

    return engine.MixedModel(
        name="level",
        dynamics=lambda a, u, t, dt, th: (a if na else [0.0], none if na else [[1.0]], [[th.q]]),
        measurement=lambda a, u, t, th: (a if na else [0.0], none if na else [[1.0]], [[th.r]]),
        initial=initial,
        outputs={"y": ""},
        parameters=[
            engine.Parameter(name, default * unit**2, "", bounds)
            for name, default in (("q", 0.1), ("r", 0.5), ("p", 1.0))
        ],
        **({"nonlinear": {"x": ""}} if na else {"linear": {"x": ""}}),
    )


def correlated(asymmetric=False):
    """Two outputs whose noises have the covariance c and the variances 0.5."""
    return engine.MixedModel(
        name="correlated",
        dynamics=lambda a, u, t, dt, th: ([0.0, 0.0], [[0.9, 0.0], [0.0, 0.5]], np.eye(2)),
        measurement=lambda a, u, t, th: (
            [0.0, 0.0],
            np.eye(2),
            [[0.5, th.c], [0.0 if asymmetric else th.c, 0.5]],
        ),
        initial=lambda th: (None, [0.0, 0.0], np.eye(2)),
        linear={"x": "", "v": ""},
        outputs={"y": "", "w": ""},
        parameters=[engine.Parameter("c", 0.0, "", (-5.0, 5.0))],
    )


@settings(deadline=None)
@given(st.integers(1, 4), st.integers(0, 10**6))
def test_a_covariance_is_told_from_none_in_any_units(n, seed):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((n, rng.integers(1, n + 1)))
    root[rng.random(n) < 0.2] = 0.0
    unit = 10.0 ** rng.integers(-9, 10, n)
    S = (root @ root.T) * unit * unit[:, None]
    assert not is_impossible(S)
    values, vectors = np.linalg.eigh(np.corrcoef(rng.standard_normal((n, n + 2))).reshape(n, n))
    values[0] = -(10.0 ** rng.uniform(-5.0, 0.0))
    bad = (vectors * values) @ vectors.T
    assert is_impossible(bad * unit * unit[:, None])
    i = int(rng.integers(n))
    assert is_impossible(np.where(np.eye(n)[i] * np.eye(n)[i][:, None] > 0.0, -(unit[i] ** 2), S))


@pytest.mark.parametrize("name", ["q", "r", "p"])
@pytest.mark.parametrize("na", [0, 1])
def test_a_filter_says_what_is_negative_and_when_though_the_model_was_used_before(name, na):
    model = level(na)
    engine.kalman_smoother(model, None, WHITE[0])
    bad = {name: -0.05}
    said = {"q": r"dynamics: Q at t = 0", "r": r"measurement: R at t = 0", "p": "initial: "}[name]
    said += ".* has the negative eigenvalue -0.05"
    with pytest.raises(engine.ModelError, match=said):
        engine.kalman_smoother(model, bad, WHITE[0])
    with pytest.raises(engine.ModelError, match=said):
        engine.rbpf(model, bad, WHITE[0], 5, 0)
    with pytest.raises(engine.ModelError, match="negative eigenvalue"):
        engine.standard_errors(model, bad, WHITE[0], exact=True)
    engine.simulate(model, None, len(WHITE[0]), 0, dt=1.0)
    with pytest.raises(engine.ModelError, match="negative eigenvalue"):
        engine.simulate(model, bad, len(WHITE[0]), 0, dt=1.0)
    thetas = np.array([model.theta(), model.theta(bad)])
    for found in (
        moment_filter(model, thetas, WHITE[0]).log_likelihood,
        log_likelihoods(model, WHITE[:1], thetas),
    ):
        assert np.isfinite(found[0])
        assert found[1] == -np.inf
    assert log_likelihoods(model, WHITE[:1], thetas[1:])[0] == -np.inf


@pytest.mark.slow
@settings(max_examples=3, deadline=None)
@given(st.integers(-9, 9))
def test_a_variance_without_bounds_ends_at_zero_in_any_units(power):
    unit, free = 10.0**power, ["q", "r"]
    for one in WHITE:
        series = one.replace(y=unit * one.y)
        for found in (
            engine.rts_em(level(unit=unit), series, free=free),
            quasi_ml(level(unit=unit), series, free=free),
        ):
            q, r = np.asarray(found.theta)[:2] / unit**2
            wanted = quasi_ml(level(unit=unit, bounds=(0.0, 9.0 * unit**2)), series, free=free)
            assert 0.0 <= q < 1e-3
            assert r * unit**2 == pytest.approx(wanted.theta[1], rel=1e-2)


@pytest.mark.long
def test_neither_do_particles_end_at_a_negative_variance_nor_plain_em():
    model, free = level(1), ["q", "r"]
    options = {"n_particles": 10, "n_iterations": 12, "warm_start": "uphill"}
    found = engine.rbps_em(model, WHITE[0], free=free, **options)
    assert 0.0 <= found.theta[0] < 0.02
    assert found.model is model
    found = engine.rts_em(level(), WHITE[0], free=free, method="em", n_iterations=30)
    assert 0.0 <= found.theta[0] < 0.02


@pytest.mark.slow
def test_a_covariance_of_two_noises_ends_inside_what_is_possible():
    rng = np.random.default_rng(0)
    x, y = np.zeros(2), []
    for _ in range(100):
        w = rng.standard_normal()  # common to both, so that the data ask for more than 0.5
        y.append(x + np.sqrt(0.5) * rng.standard_normal() * np.ones(2))
        x = np.array([0.9, 0.5]) * x + w
    series = engine.Series(np.array(y), dt=1.0)
    for found in (
        engine.rts_em(correlated(), series),
        engine.rts_em(correlated(), series, method="em", n_iterations=10),
        quasi_ml(correlated(), series),
    ):
        assert abs(found.theta[0]) <= 0.5 * (1.0 + 1e-9)
        engine.kalman_smoother(correlated(), found.theta, series)


def test_a_covariance_that_only_a_parameter_makes_unsymmetric_is_refused():
    series = engine.Series(np.random.default_rng(0).standard_normal((50, 2)), dt=1.0)
    for search in (engine.rts_em, quasi_ml):
        with pytest.raises(engine.ModelError, match="measurement: R is not symmetric"):
            search(correlated(asymmetric=True), series)
