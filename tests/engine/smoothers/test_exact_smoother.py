"""The smoother without Approximations 1 and 2, against integration over all trajectories of a."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import engine
from engine.smoothers.linear_cost import rb_ffbsi_linear

A_A, A_Z = 1.5, 0.8  # strong coupling of z into a
Q_A, Q_Z, Q_AZ = 0.1, 0.15, 0.02
R = 0.3


def f_a(a: Any) -> Any:
    return np.arctan(2.0 * a)


def bent_dynamics(a: Any, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
    return [f_a(a[:, 0]), 0.3 * a[:, 0]], [[A_A], [A_Z]], [[Q_A, Q_AZ], [Q_AZ, Q_Z]]


def bent_measurement(a: Any, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
    return [0.3 * a[:, 0] ** 2], [[0.5]], [[R]]


def bent_initial(theta: Any) -> tuple[Any, Any, Any]:
    return engine.Gaussian([0.3], [[0.5]]), np.zeros(1), np.eye(1)


BENT = engine.MixedModel(
    name="bent",
    nonlinear={"a": "1"},
    linear={"z": "1"},
    outputs={"y": "1"},
    parameters=[],
    dynamics=bent_dynamics,
    measurement=bent_measurement,
    initial=bent_initial,
)


def integrate(y: np.ndarray) -> dict[str, Any]:
    """Exact moments for T = 3: a grid of all a_1:3, and scalar Kalman and RTS formulas for z."""
    line = np.linspace(-6.0, 6.0, 121)
    a = np.stack(np.meshgrid(line, line, line, indexing="ij")).reshape(3, -1)
    log_p = -0.5 * (a[0] - 0.3) ** 2 / 0.5
    m, P = np.zeros_like(a[0]), 1.0
    filtered, ahead = [], []
    for t in range(3):
        S = 0.25 * P + R
        nu = y[t] - 0.3 * a[t] ** 2 - 0.5 * m
        log_p -= 0.5 * (nu**2 / S + np.log(S))
        m, P = m + 0.5 * P / S * nu, P - 0.25 * P * P / S
        if t == 2:
            filtered.append((m, P))
            break
        S = A_A**2 * P + Q_A  # a_{t+1} measures z_t
        nu = a[t + 1] - f_a(a[t]) - A_A * m
        log_p -= 0.5 * (nu**2 / S + np.log(S))
        m_a, P_a = m + A_A * P / S * nu, P - (A_A * P) ** 2 / S
        filtered.append((m_a, P_a))
        # z_{t+1} = drift + slope z_t + noise uncorrelated with what a_{t+1} has told
        slope = A_Z - Q_AZ / Q_A * A_A
        drift = 0.3 * a[t] + Q_AZ / Q_A * (a[t + 1] - f_a(a[t]))
        m, P = drift + slope * m_a, slope**2 * P_a + Q_Z - Q_AZ**2 / Q_A
        ahead.append((m, P, slope))
    z, V, cross = [filtered[2][0]], [filtered[2][1]], []
    for t in (1, 0):
        (m_f, P_f), (m_p, P_p, slope) = filtered[t], ahead[t]
        G = P_f * slope / P_p
        cross.insert(0, G * V[0])
        z.insert(0, m_f + G * (z[0] - m_p))
        V.insert(0, P_f + G * G * (V[0] - P_p))
    w = np.exp(log_p - log_p.max())
    w /= w.sum()
    mean_a, mean_z = a @ w, np.array(z) @ w
    return {
        "a": mean_a,
        "z": mean_z,
        "var a": (a**2) @ w - mean_a**2,
        "var z": (np.array(z) ** 2) @ w + V - mean_z**2,
        "lag z": [(z[t] * z[t + 1]) @ w + cross[t] - mean_z[t] * mean_z[t + 1] for t in (0, 1)],
        "z next a": [(z[t] * a[t + 1]) @ w - mean_z[t] * mean_a[t + 1] for t in (0, 1)],
    }


def moments(s: engine.Smoothed) -> dict[str, Any]:
    a, z, P, M = s.a[..., 0], s.z[..., 0], s.P[..., 0, 0], s.M[..., 0, 0]

    def cov(x: Any, y: Any) -> Any:
        return (x * y).mean(axis=1) - x.mean(axis=1) * y.mean(axis=1)

    return {
        "a": a.mean(axis=1),
        "z": z.mean(axis=1),
        "var a": a.var(axis=1),
        "var z": z.var(axis=1) + P.mean(axis=1),
        "lag z": cov(z[:-1], z[1:]) + M.mean(axis=1),
        "z next a": cov(z[:-1], a[1:]),
    }


@pytest.mark.long
@pytest.mark.parametrize("sampler", ["full", "mcmc", "rejection"])
def test_exact_moments_on_a_nonlinear_model(sampler: str) -> None:
    y = np.array([0.6, 1.4, 0.2])
    exact = integrate(y)
    runs = []
    for k in range(30):
        rng = np.random.default_rng(k)
        filtered = engine.rbpf(BENT, None, engine.Series(y), 600, rng)
        if sampler == "full":
            draws = engine.rb_ffbsi(filtered, 600, rng, joint=True)
            runs.append(moments(engine.condition_on_trajectories(draws)))
        else:
            runs.append(moments(rb_ffbsi_linear(filtered, 600, rng, sampler)))
    for name, want in exact.items():
        got = np.array([run[name] for run in runs])
        error = got.std(axis=0) / np.sqrt(len(runs))
        assert (np.abs(got.mean(axis=0) - want) < 4.5 * error + 0.004).all(), name


def hurting_dynamics(a: Any, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
    return [0.7 * a[:, 0], 0.0], [[3.0], [theta.pole]], [[0.1, 0.01], [0.01, 0.1]]


def hurting_measurement(a: Any, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
    return [a[:, 0]], [[0.0]], [[1.0]]


def hurting_initial(theta: Any) -> tuple[Any, Any, Any]:
    return engine.Gaussian([0.0], [[1.0]]), np.zeros(1), np.eye(1)


# linear, so that the exact answer is known: with A_a = 3, a_{t+1} says more of z_t than all else
HURTING = engine.MixedModel(
    name="hurting",
    nonlinear={"a": "1"},
    linear={"z": "1"},
    outputs={"y": "1"},
    parameters=[engine.Parameter("pole", 0.95, bounds=(-2.0, 2.0))],
    dynamics=hurting_dynamics,
    measurement=hurting_measurement,
    initial=hurting_initial,
)


@pytest.mark.long
def test_a_model_built_to_hurt(capsys: pytest.CaptureFixture[str]) -> None:
    """Strong A_a, small Q_az: Algorithm 3 is far off whatever M; the exact moments are not."""
    model = HURTING
    series = engine.simulate(model, None, 80, np.random.default_rng(1)).series
    k = engine.kalman_smoother(model, None, series)
    exact = {
        "var z": k.P[:-1, 1, 1].mean(),
        "lag z": k.M[:, 1, 1].mean(),
        "z next a": k.M[:, 1, 0].mean(),
    }
    ratio: dict[tuple[str, int], dict[str, float]] = {}
    for M in (300, 1200):
        runs: dict[str, list[dict[str, Any]]] = {"algorithm 3": [], "exact": []}
        for replicate in range(1200 // M * 2):
            rng = np.random.default_rng(replicate)
            filtered = engine.rbpf(model, None, series, M, rng)
            runs["algorithm 3"].append(moments(engine.rb_ffbsi(filtered, 400, rng)))
            draws = engine.rb_ffbsi(filtered, 400, rng, joint=True)
            runs["exact"].append(moments(engine.condition_on_trajectories(draws)))
        for name, those in runs.items():
            ratio[name, M] = {
                what: float(np.mean([run[what][:79].mean() for run in those]) / want)
                for what, want in exact.items()
            }
    with capsys.disabled():
        print("\nsmoothed covariances over the exact ones, strong A_a, small Q_az")
        for (name, M), row in ratio.items():
            print(f"  {name:12s} M = {M:5d}: " + ", ".join(f"{w} {r:.3f}" for w, r in row.items()))
    for M in (300, 1200):
        assert all(abs(r - 1.0) < 0.06 for r in ratio["exact", M].values())
    assert all(ratio["algorithm 3", M]["lag z"] < 0.82 for M in (300, 1200))


def trend(P1, Q, R, units=(1.0, 1.0, 1.0)):
    """A local linear trend, of which the level is measured; ``units`` of its two states and of y."""
    s, o = np.array(units[:2]), units[2]
    F = np.array([[1.0, 1.0], [0.0, 1.0]])
    return engine.MixedModel(
        name="trend",
        dynamics=lambda a, u, t, dt, th: ([0.0, 0.0], F * s[:, None] / s, Q * s[:, None] * s),
        measurement=lambda a, u, t, th: ([0.0], [[o / s[0], 0.0]], [[R * o**2]]),
        initial=lambda th: (None, [0.0, 0.0], P1 * s[:, None] * s),
        linear={"level": "", "slope": ""},
        outputs={"y": ""},
        parameters=[engine.Parameter("unused", 1.0)],
    )


def in_fractions(y, P1, Q, R):
    """Smoothed covariances (T, 2, 2), and M, of the trend without rounding: Rauch, Tung, Striebel (1965)."""

    def of(A):
        return np.array([[Fraction(float(x)) for x in row] for row in A], dtype=object)

    def inverse(A):
        d = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
        return np.array([[A[1, 1], -A[0, 1]], [-A[1, 0], A[0, 0]]], dtype=object) / d

    F, P, Q, R = of([[1, 1], [0, 1]]), of(P1), of(Q), Fraction(R)
    predicted, filtered = [], []
    for _ in y:
        predicted.append(P)
        P = P - np.outer(P[:, 0], P[0]) / (P[0, 0] + R)
        filtered.append(P)
        P = F @ P @ F.T + Q
    smoothed, M = [filtered[-1]], []
    for t in range(len(y) - 2, -1, -1):
        G = filtered[t] @ F.T @ inverse(predicted[t + 1])
        M.insert(0, G @ smoothed[0])
        smoothed.insert(0, filtered[t] + G @ (smoothed[0] - predicted[t + 1]) @ G.T)
    return np.array(smoothed, dtype=float), np.array(M, dtype=float)


@settings(max_examples=15, deadline=None)
@given(
    st.integers(0, 12),
    st.tuples(*[st.integers(-9, 9)] * 3),
)
def test_a_diffuse_start_does_not_drown_the_first_smoothed_states_in_any_units(diffuse, powers):
    y, P1, Q, R = np.arange(12.0) ** 1.5, 10.0**diffuse * np.eye(2), 1e-2 * np.eye(2), 1e-2
    P, M = in_fractions(y, P1, Q, R)
    units = 10.0 ** np.array(powers, dtype=float)
    series = engine.Series(units[2] * y, dt=1.0)
    k = engine.kalman_smoother(trend(P1, Q, R, units), None, series)
    size = np.sqrt(np.diagonal(P, axis1=1, axis2=2)) * units[:2]
    own = size[:, :, None] * size[:, None, :]
    np.testing.assert_allclose(k.P / own, P * units[:2, None] * units[:2] / own, atol=1e-7)
    own = size[:-1, :, None] * size[1:, None, :]
    np.testing.assert_allclose(k.M / own, M * units[:2, None] * units[:2] / own, atol=1e-7)


@pytest.mark.parametrize("P1", [np.eye(2), np.ones((2, 2)), np.diag([0.0, 1.0])])
def test_states_without_noise_of_their_own_are_smoothed_as_what_they_are_functions_of(P1):
    y = 0.3 * np.arange(15.0) + np.random.default_rng(0).standard_normal(15)
    k = engine.kalman_smoother(trend(P1, np.zeros((2, 2)), 1.0), None, engine.Series(y, dt=1.0))
    on_first = np.array([[[1.0, t], [0.0, 1.0]] for t in range(15)])  # x_t as a function of x_1
    H = on_first[:, 0]
    gain = P1 @ H.T @ np.linalg.inv(H @ P1 @ H.T + np.eye(15))
    x1, P = gain @ y, P1 - gain @ H @ P1
    np.testing.assert_allclose(k.x, on_first @ x1, atol=1e-9)
    np.testing.assert_allclose(k.P, on_first @ P @ np.swapaxes(on_first, 1, 2), atol=1e-9)
    np.testing.assert_allclose(k.M, on_first[:-1] @ P @ np.swapaxes(on_first[1:], 1, 2), atol=1e-9)
