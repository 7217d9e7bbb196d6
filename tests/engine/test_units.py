"""Nothing depends on the units of states, outputs, inputs, time or parameters, from 1e-9 to 1e9.

The factors are powers of two, which round nothing: what differs differs by an absolute constant.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import engine
from engine import Gaussian, MixedModel, ModelError, Parameter, Series, kalman_smoother
from engine.estimation.ps_em import ps_em
from engine.estimation.quasi_ml import quasi_ml, whitening
from engine.filters.sigma_point import moment_path
from engine.smoothers.linear_cost import rb_ffbsi_linear
from tests.engine.estimation.test_noise_free import TRUTH, level
from tests.engine.models_for_tests import (
    awkward_series,
    draw,
    linear_mixed,
    partly_noise_free,
    theta_everywhere,
)
from tests.engine.other_units import Units
from tests.studies.ekf import ekf

factors = st.integers(-30, 30)
UNITS = np.random.default_rng(8)
few = settings(max_examples=8, deadline=None, derandomize=True, database=None)


def drawn(model, T=20):
    times = np.arange(float(T))
    return Series(draw(model, np.zeros((T, model.nu)), times, np.random.default_rng(0)))


def level_series(nonlinear=True):
    return engine.simulate(level(nonlinear), TRUTH, 40, np.random.default_rng(1)).series


CASES = {  # singular P_1, inputs and missing channels; a row of Q that is zero, P_1 = 0; nonlinear
    "linear": (linear_mixed(), awkward_series(linear_mixed())),
    "noise-free": (partly_noise_free(), drawn(partly_noise_free())),
    "everywhere": (theta_everywhere(), drawn(theta_everywhere())),
    "exact start": (level(True), level_series()),
}


def particles(model, series, theta=None):
    rng = np.random.default_rng(5)
    filtered = engine.rbpf(model, theta, series, 15, rng)
    smoothed = engine.rb_ffbsi(filtered, 10, rng, joint=True)
    exact = engine.condition_on_trajectories(smoothed)
    chain = rb_ffbsi_linear(filtered, 10, rng)
    return filtered, smoothed, exact, chain


@pytest.mark.parametrize("name", CASES)
@few
@given(data=st.data())
def test_filters_and_smoothers(name, data):
    model, series = CASES[name]
    units = Units.of(model, lambda: data.draw(factors))
    other, there = units.model(model), units.series(series)
    at = TRUTH if name == "exact start" else None
    theta = np.asarray(model.theta(at))
    one, two = particles(model, series, theta), particles(other, there, theta * units.theta)
    fall = units.log_jacobian(series)
    assert two[0].log_likelihood == pytest.approx(one[0].log_likelihood - fall, rel=1e-9, abs=1e-7)
    np.testing.assert_array_equal(two[0].ancestors, one[0].ancestors)
    for mine, yours in zip(one[1:], two[1:], strict=True):
        np.testing.assert_array_equal(yours.index, mine.index)
        for value in ("mean", "std"):
            expected = getattr(mine, value)() * units.x
            floor = 1e-6 * np.abs(expected).max(axis=0)  # a noise-free sd is rounding
            off = np.abs(getattr(yours, value)() - expected)
            assert (off <= 1e-6 * np.abs(expected) + floor).all()


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
@few
@given(data=st.data())
def test_moments_and_ekf(name, data):
    model, series = CASES[name]
    units = Units.of(model, lambda: data.draw(factors))
    theta = np.asarray(model.theta())
    other, there = units.model(model), units.series(series)
    one, two = (
        moment_path(m, th, s)
        for m, th, s in ((model, theta, series), (other, theta * units.theta, there))
    )
    fall = units.log_jacobian(series)
    assert two.log_likelihood == pytest.approx(one.log_likelihood - fall, rel=1e-9, abs=1e-7)
    D = units.x
    for got, expected in (
        (two.predicted, one.predicted * D),
        (two.F, one.F * (D[:, None] / D)),
        (two.H, one.H * (units.y[:, None] / D)),
        (two.K, one.K * (D[:, None] / units.y)),
    ):
        np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-9 * np.abs(expected).max())
    one, two = (
        ekf(m, th, s) for m, th, s in ((model, theta, series), (other, theta * units.theta, there))
    )
    assert two.log_likelihood == pytest.approx(one.log_likelihood - fall, rel=1e-7, abs=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("name", ["linear", "noise-free", "exact start"])
@few
@given(data=st.data())
def test_the_exact_smoother(name, data):
    model, series = CASES[name]
    units = Units.of(model, lambda: data.draw(factors))
    one = kalman_smoother(model, None, series)
    two = kalman_smoother(units.model(model), None, units.series(series))
    assert two.log_likelihood == pytest.approx(
        one.log_likelihood - units.log_jacobian(series), rel=1e-9, abs=1e-7
    )
    D = np.outer(units.x, units.x)
    np.testing.assert_allclose(two.x, one.x * units.x, rtol=1e-6, atol=0)
    floor = 1e-9 * np.abs(one.P * D).max(axis=0)
    assert (np.abs(two.P - one.P * D) <= floor + 1e-6 * np.abs(one.P * D)).all()


@pytest.mark.long
@pytest.mark.filterwarnings(
    "ignore::engine.NotSettledWarning"
)  # after few steps nothing has settled
@pytest.mark.parametrize("method", ["rbps", "ps", "scoring", "errors"])
def test_estimates(method):
    """Each a few steps on a model whose parameters stand everywhere, told in units drawn at random."""
    model, series = CASES["everywhere"]
    units = Units.of(model, lambda: UNITS.integers(-30, 31))
    pairs = [(model, series, 1.0), (units.model(model), units.series(series), units.theta)]
    at, free = np.asarray(model.theta()), ["f", "Q", "R", "z1"]
    em = {"n_particles": 6, "n_iterations": 2, "seed": 2, "free": free}
    if method == "errors":
        one, two = (
            engine.standard_errors(m, at * b, s, ["f", "R"], 6, 6, replicates=2)
            for m, s, b in pairs
        )
        assert two.decrement == pytest.approx(one.decrement, rel=1e-5)
        assert two.settled == one.settled
        one, two = one.values, two.values
    elif method == "scoring":
        one, two = (quasi_ml(m, s, free=free, max_iterations=3).theta for m, s, _ in pairs)
    elif method == "ps":
        one, two = (ps_em(m, s, **em).trace for m, s, _ in pairs)
    else:
        one, two = (engine.rbps_em(m, s, warm_start=False, **em).trace for m, s, _ in pairs)
    np.testing.assert_allclose(two, one * units.theta, rtol=1e-5)


@pytest.mark.slow
@settings(few, max_examples=3)
@given(data=st.data())
def test_estimates_of_what_has_no_scale_of_its_own(data):
    """Defaults of zero without bounds, P_1 = 0, a row of Q that is zero; the sizes come from the data."""
    model, series = CASES["exact start"]
    units = Units.of(model, lambda: data.draw(factors))
    other, there = units.model(model), units.series(series)
    one, two = (quasi_ml(m, s) for m, s in ((model, series), (other, there)))
    np.testing.assert_allclose(two.theta, np.asarray(one.theta) * units.theta, rtol=1e-3)
    one, two = (engine.rts_em(m, s, n_iterations=4) for m, s in ((model, series), (other, there)))
    np.testing.assert_allclose(two.trace, one.trace * units.theta, rtol=1e-3)
    at = np.asarray(one.theta)
    em = {"n_particles": 6, "n_iterations": 2, "warm_start": False}
    one, two = (
        engine.rbps_em(m, s, th, **em)
        for m, s, th in ((model, series, at), (other, there, at * units.theta))
    )
    np.testing.assert_allclose(two.trace, one.trace * units.theta, rtol=1e-3)
    one, two = (
        engine.fit_simulation(m, s, free=["z0", "b"]) for m, s in ((model, series), (other, there))
    )
    np.testing.assert_allclose(
        two.theta[:2], np.asarray(one.theta)[:2] * units.theta[:2], rtol=1e-3
    )


# ---- what must be seen in any unit -----------------------------------------------------------------


def curved(part, size, unit, offset=0.0):
    """A random walk at ``offset`` whose ``part`` depends on its state, in a unit of size ``unit``."""

    def bend(a):
        return size * (a[:, 0] - offset) ** 2 / unit

    def dynamics(a, u, t, dt, theta):
        q = 1e-2 * unit**2
        if part == "Q":
            q = [[q * (1.0 + size * ((a[:, 0] - offset) / unit) ** 2)]]
            return a, np.zeros((1, 0)), q
        return a + (bend(a)[:, None] if part == "f" else 0.0), np.zeros((1, 0)), [[q]]

    def measurement(a, u, t, theta):
        return [a[:, 0] + (bend(a) if part == "h" else 0.0)], np.zeros((1, 0)), [[unit**2]]

    def initial(theta):
        return Gaussian([offset], [[unit**2]]), [], np.zeros((0, 0))

    return MixedModel(
        name="curved", dynamics=dynamics, measurement=measurement, initial=initial,
        nonlinear={"a": "m"}, outputs={"y": "m"}, parameters=[Parameter("k", 1.0)],
    )  # fmt: skip


@pytest.mark.parametrize("unit", [1e-9, 1e-6, 1.0, 1e5, 1e9])
@pytest.mark.parametrize("offset", [0.0, 300.0])
@pytest.mark.parametrize("part", ["f", "h", "Q"])
def test_a_nonlinear_model_is_refused_in_any_unit(part, unit, offset):
    offset *= unit
    series = Series(np.full(8, offset))
    assert np.isfinite(
        kalman_smoother(curved(part, 0.0, unit, offset), None, series).log_likelihood
    )
    with pytest.raises(ModelError, match=f"not linear Gaussian: {part}"):
        kalman_smoother(curved(part, 1e-4, unit, offset), None, series)


def test_a_start_that_is_not_linear_is_refused():
    model = level(True)

    def initial(theta):
        return Gaussian([0.0], [[1e-20]]), lambda a: [1e10 * a[:, 0] ** 2], [[1e-20]]

    curved_start = MixedModel(
        **{**{n: getattr(model, n) for n in model.__dataclass_fields__}, "initial": initial}
    )
    with pytest.raises(ModelError, match="z1 is not affine"):
        kalman_smoother(curved_start, None, level_series())


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_noise_free_states_are_told_apart_in_any_unit(unit):
    """Particles at rest at different places: no trajectory may change from one to another."""

    def dynamics(a, u, t, dt, theta):
        return a, np.zeros((1, 0)), [[0.0]]

    def measurement(a, u, t, theta):
        return [a[:, 0]], np.zeros((1, 0)), [[unit**2]]

    def initial(theta):
        return Gaussian([1e6 * unit], [[unit**2]]), [], np.zeros((0, 0))

    model = MixedModel(
        name="rest", dynamics=dynamics, measurement=measurement, initial=initial,
        nonlinear={"a": "m"}, outputs={"y": "m"}, parameters=[],
    )  # fmt: skip
    rng = np.random.default_rng(0)
    filtered = engine.rbpf(
        model, None, Series(np.full(6, 1e6 * unit)), 20, rng, "bootstrap", ess_threshold=0.0
    )
    for smoothed in (engine.rb_ffbsi(filtered, 30, rng), rb_ffbsi_linear(filtered, 30, rng)):
        assert np.isfinite(filtered.log_likelihood)
        np.testing.assert_array_equal(smoothed.a, np.broadcast_to(smoothed.a[:1], smoothed.a.shape))
        assert len(np.unique(smoothed.a[0])) > 5


def test_channels_of_very_different_size_are_whitened_alike():
    """A ridge by the trace of S would drown the small channel."""
    S = np.array([[[2.0, 0.5], [0.5, 1.0]]])
    D = np.diag([1e-9, 1e9])
    there = np.ones((1, 2), dtype=bool)
    np.testing.assert_allclose(whitening(D @ S @ D, there) @ D, whitening(S, there), atol=1e-12)
