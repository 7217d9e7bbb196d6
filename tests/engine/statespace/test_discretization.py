"""Discretisation against closed forms and against numerical integration."""

from __future__ import annotations

from decimal import Decimal, localcontext

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad_vec
from scipy.linalg import expm

from engine.errors import OptionError
from engine.kernels.van_loan import van_loan
from engine.statespace.discretization import discretize


@pytest.mark.parametrize("dt", [1e-3, 0.1, 5.0, 300.0])
def test_double_integrator(dt):
    A, B, Q = discretize([[0, 1], [0, 0]], [[0], [1]], np.diag([0.0, 2.0]), dt=dt)
    np.testing.assert_allclose(A, [[1, dt], [0, 1]], rtol=1e-12)
    np.testing.assert_allclose(B, [[dt**2 / 2], [dt]], rtol=1e-12)
    expected = 2.0 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    np.testing.assert_allclose(Q, expected, rtol=1e-11)


@pytest.mark.parametrize("dt", [1e-4, 0.3, 40.0, 1e4])
def test_ornstein_uhlenbeck_also_where_it_is_fast_beside_the_step(dt):
    rate, q = 2.5, 0.7
    A, B, Q = discretize([[-rate]], [[3.0]], [[q]], dt=dt)
    np.testing.assert_allclose(A, [[np.exp(-rate * dt)]], rtol=1e-9, atol=1e-300)
    np.testing.assert_allclose(B, [[-3.0 * np.expm1(-rate * dt) / rate]], rtol=1e-11)
    np.testing.assert_allclose(Q, [[-q * np.expm1(-2 * rate * dt) / (2 * rate)]], rtol=1e-11)


def test_undamped_oscillator():
    w, q, dt = 3.0, 0.4, 0.9
    A, B, Q = discretize([[0, 1], [-(w**2), 0]], [[0], [w**2]], np.diag([0.0, q]), dt=dt)
    c, s = np.cos(w * dt), np.sin(w * dt)
    np.testing.assert_allclose(A, [[c, s / w], [-w * s, c]], rtol=1e-12)
    np.testing.assert_allclose(B, [[1 - c], [w * s]], rtol=1e-12)
    sine2 = np.sin(2 * w * dt)
    expected = q * np.array(
        [
            [(dt / 2 - sine2 / (4 * w)) / w**2, s**2 / (2 * w**2)],
            [s**2 / (2 * w**2), dt / 2 + sine2 / (4 * w)],
        ]
    )
    np.testing.assert_allclose(Q, expected, rtol=1e-11)


@pytest.mark.parametrize("seed", range(5))
def test_random_systems_against_numerical_integration(seed):
    rng = np.random.default_rng(seed)
    F, G = rng.standard_normal((4, 4)), rng.standard_normal((4, 2))
    root = rng.standard_normal((4, 2))
    Qc, dt = root @ root.T, rng.uniform(0.1, 3.0)
    A, B, Q = discretize(F, G, Qc, dt=dt)
    np.testing.assert_allclose(A, expm(F * dt), rtol=1e-9, atol=1e-9)
    integral = quad_vec(lambda s: expm(F * s) @ G, 0.0, dt, epsabs=1e-12)[0]
    np.testing.assert_allclose(B, integral, rtol=1e-8, atol=1e-8 * np.abs(B).max())
    integral = quad_vec(lambda s: expm(F * s) @ Qc @ expm(F * s).T, 0.0, dt, epsabs=1e-12)[0]
    np.testing.assert_allclose(Q, integral, rtol=1e-8, atol=1e-8 * np.abs(Q).max())
    np.testing.assert_array_equal(Q, Q.T)


# ---- against the same series with hundreds of digits ---------------------------------------------------------

UNITS = [1e-9, 1e-6, 1e-3, 1.0, 60.0, 1e5]  # of a state in nanometres, minutes, pascals, ...


def series_of(F, G, Qc, dt, digits=260, orders=1200):
    """A, B, Q by their series, summed with so many digits."""
    with localcontext() as context:
        context.prec = digits
        h = Decimal(float(dt))
        F, G, Qc = (
            np.array([[Decimal(float(x)) for x in row] for row in matrix], dtype=object).reshape(
                np.shape(matrix)
            )
            for matrix in (F, G, Qc)
        )
        power = np.array([[Decimal(int(i == j)) for j in range(len(F))] for i in range(len(F))])
        pushed, term = h * G, h * Qc
        A, B, Q = power, pushed, term
        for order in range(1, orders):
            power = F.dot(power) * (h / order)
            pushed = F.dot(pushed) * (h / (order + 1))
            half = F.dot(term) * (h / (order + 1))
            term = half + half.T
            A, B, Q = A + power, B + pushed, Q + term
            if max(abs(x) for part in (power, pushed, term) for x in part.ravel()) < Decimal(
                "1e-60"
            ):
                break
        return tuple(np.array(x, dtype=float) for x in (A, B, Q))


@st.composite
def systems(draw, stiffness):
    """F, G, Qc and dt, in units D (n,): chains, decoupled states, states without noise among them."""
    n = draw(st.integers(1, 4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    dt = draw(st.sampled_from([1e-6, 1e-3, 1.0, 4.0, 3600.0]))
    F = rng.uniform(-1.0, 1.0, (n, n)) * (rng.random((n, n)) < 0.6)
    norm = np.abs(F).sum(axis=1).max()
    F *= draw(st.sampled_from(stiffness)) / (norm * dt) if norm > 0.0 else 0.0
    root = rng.uniform(-1.0, 1.0, (n, n)) * (rng.random((n, 1)) < 0.7)
    D = np.array(draw(st.lists(st.sampled_from(UNITS), min_size=n, max_size=n)))
    return F, rng.uniform(-1.0, 1.0, (n, 2)), root @ root.T, dt, D


@pytest.mark.long
@given(systems([1e-9, 1e-4, 0.03, 0.2, 0.5]))
@settings(max_examples=120, deadline=None)
def test_every_entry_to_rounding_in_any_units(system):
    """Noise that reaches a state through two others too, however short the step."""
    F, G, Qc, dt, D = system
    found = discretize(F * D[:, None] / D, G * D[:, None], Qc * D[:, None] * D, dt=dt)
    known = series_of(F, G, Qc, dt)
    sizes = series_of(np.abs(F), np.abs(G), np.abs(Qc), dt)
    in_units = (D[:, None] / D, D[:, None], D[:, None] * D)
    for ours, right, size, unit in zip(found, known, sizes, in_units, strict=True):
        assert (np.abs(ours / unit - right) <= 4e-15 * size).all()


@pytest.mark.long
@given(systems([1.0, 20.0, 60.0]))
@settings(max_examples=60, deadline=None)
def test_stiff_systems_in_any_units(system):
    """Of norm 1 to 60 in a step; in units in which the norm is up to 1e14 times as large."""
    F, G, Qc, dt, D = system
    found = discretize(F * D[:, None] / D, G * D[:, None], Qc * D[:, None] * D, dt=dt)
    in_units = (D[:, None] / D, D[:, None], D[:, None] * D)
    for ours, right, unit in zip(found, series_of(F, G, Qc, dt), in_units, strict=True):
        np.testing.assert_allclose(ours / unit, right, rtol=0.0, atol=1e-12 * np.abs(right).max())


def test_a_chain_in_odd_units_is_not_stiff():
    """An angle in nanoradians and its rate in rad/s: half the digits were lost in 27 doublings."""
    nano, dt, decay, q = 1e9, 0.05, 0.2, 1e-4
    F, Qc = [[0.0, nano], [0.0, -decay]], np.diag([0.0, q])
    A, _, Q = discretize(F, None, Qc, dt=dt)
    lag = -np.expm1(-decay * dt) / decay
    np.testing.assert_allclose(A, [[1.0, nano * lag], [0.0, np.exp(-decay * dt)]], rtol=1e-15)
    _, _, right = series_of([[0.0, 1.0], [0.0, -decay]], np.zeros((2, 0)), Qc, dt)
    np.testing.assert_allclose(Q, right * np.outer([nano, 1.0], [nano, 1.0]), rtol=1e-14)


@pytest.mark.long
def test_many_systems_of_which_some_are_stiff():
    """Side by side as alone: one that is halved leaves the others as they are."""
    rng = np.random.default_rng(0)
    F = rng.standard_normal((150, 3, 3)) * 10.0 ** rng.uniform(-4.0, 1.5, (150, 1, 1))
    Qc = np.diag([1.0, 0.0, 2.0])
    together = discretize(F, np.eye(3), Qc, dt=1.0)
    for k in (0, 63, 64, 149):
        alone = discretize(F[k], np.eye(3), Qc, dt=1.0)
        for one, other in zip(together, alone, strict=True):
            np.testing.assert_allclose(one[k], other, rtol=1e-13, atol=1e-13 * np.abs(other).max())


@pytest.mark.parametrize("other", [np.inf, -np.inf, np.nan, 1e308, 1e200, 1e30])
def test_a_system_that_runs_away_says_nothing_about_the_next_ones(other):
    """Units in which its step is short were taken for theirs, and what was infinite raised OverflowError."""
    rng = np.random.default_rng(0)
    for n in (2, 3, 4):
        size = 10.0 ** rng.uniform(-6.0, 6.0, n)
        units = size[:, None] / size
        F = rng.standard_normal((9, n, n)) * 5.0 * units
        G, Qc, dt = np.ones((9, n, 1)), np.zeros((9, n, n)), np.ones(9)
        for at in np.ndindex(n, n):
            beside = F.copy()
            beside[0][at] = other
            found = van_loan(beside, G, Qc, dt.copy())[0] / units
            for k in range(1, 9):
                alone = van_loan(F[k : k + 1], G[:1], Qc[:1], dt[:1].copy())[0][0] / units
                assert np.abs(found[k] - alone).max() < 1e-10 * np.abs(alone).max()


@pytest.mark.long
def test_several_systems_and_steps_at_once():
    F = np.array([[[0.0, 1.0], [0.0, -k]] for k in (0.1, 1.0, 10.0)])
    dt, Qc = np.array([0.1, 0.2, 0.3]), np.diag([0.0, 1.0])
    together = discretize(F, [[0], [1]], Qc, dt=dt)
    for i in range(3):
        alone = discretize(F[i], [[0], [1]], Qc, dt=dt[i])
        for one, other in zip(together, alone, strict=True):
            np.testing.assert_allclose(one[i], other, rtol=1e-10, atol=1e-14)


def test_without_input_and_noise():
    A, B, Q = discretize(np.zeros((2, 2)), dt=1.0)
    np.testing.assert_array_equal(A, np.eye(2))
    assert B.shape == (2, 0)
    np.testing.assert_array_equal(Q, np.zeros((2, 2)))


@pytest.mark.parametrize(
    ("arguments", "dt", "message"),
    [
        ([[[1.0, 2.0]]], 1.0, r"F has shape \(1, 2\); a square matrix"),
        ([[1.0, 2.0]], 1.0, r"F has shape \(2,\); a matrix"),
        ([[[np.nan]]], 1.0, r"F is not finite"),
        ([np.eye(2), np.ones((3, 1))], 1.0, r"G has shape \(3, 1\); 2 rows"),
        ([np.eye(2), None, np.eye(3)], 1.0, r"Qc has shape \(3, 3\); \(2, 2\)"),
        ([np.eye(2)], 0.0, r"dt = 0.0 s; positive"),
        ([np.eye(2)], np.inf, r"dt = inf s; positive"),
    ],
)
def test_errors(arguments, dt, message):
    with pytest.raises(OptionError, match=message):
        discretize(*arguments, dt=dt)


def test_an_asymmetric_intensity_is_refused_in_any_unit():
    for scale in (1.0, 1e-18):
        with pytest.raises(OptionError, match="Qc is not symmetric"):
            discretize(np.eye(2), Qc=scale * np.array([[1.0, 0.2], [0.1, 1.0]]), dt=0.1)
        discretize(np.eye(2), Qc=scale * np.array([[1.0, 0.2 + 1e-12], [0.2, 1.0]]), dt=0.1)
