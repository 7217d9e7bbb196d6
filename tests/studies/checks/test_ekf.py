"""The extended Kalman filter: exact on linear models, consistent on nonlinear ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.data import nile
from engine.data.series import Series
from engine.errors import ModelError
from engine.models.linear_2 import MODEL as LINEAR
from engine.models.local_level import MODEL as LEVEL
from engine.models.tanks import MODEL as TANKS
from engine.simulation.simulate import simulate
from engine.statespace.model import Gaussian, MixedModel
from tests.studies.ekf import ekf


def joint_gaussian(y, m, P, F, b, H, Q, R):
    """log p of the observed y and E, cov of the last x given them, all from one big Gaussian."""
    T, n = len(y), len(m)
    mean, cov = np.empty((T, n)), np.zeros((T, n, T, n))
    mean[0], cov[0, :, 0] = m, P
    for t in range(1, T):
        mean[t] = F @ mean[t - 1] + b
        cov[t, :, :t] = np.einsum("ij,jsk->isk", F, cov[t - 1, :, :t])
        cov[:t, :, t] = np.transpose(cov[t, :, :t], (1, 2, 0))
        cov[t, :, t] = F @ cov[t - 1, :, t - 1] @ F.T + Q
    X, big = mean.ravel(), cov.reshape(T * n, T * n)
    Hs = np.kron(np.eye(T), H)
    seen = ~np.isnan(y.ravel())
    Hs, S = Hs[seen], (Hs @ big @ Hs.T + np.kron(np.eye(T), R))[np.ix_(seen, seen)]
    e = y.ravel()[seen] - Hs @ X
    log_p = -0.5 * (e @ np.linalg.solve(S, e) + np.linalg.slogdet(2 * np.pi * S)[1])
    G = np.linalg.solve(S, Hs @ big).T[-n:]
    return log_p, X[-n:] + G @ e, big[-n:, -n:] - G @ (Hs @ big)[:, -n:]


def coupled():
    """Two nonlinear states that are linear after all, one linear state, Q_az != 0, Q singular."""
    F = np.array([[0.9, 0.2, 0.3], [0.0, 0.7, -0.4], [0.1, 0.0, 0.8]])
    b, H = np.array([0.1, -0.2, 0.05]), np.array([[1.0, 0.0, 0.5], [0.0, 1.0, -1.0]])
    root = np.array([[0.3, 0.0], [0.1, 0.2], [0.2, -0.1]])
    Q, R = root @ root.T, np.array([[0.1, 0.02], [0.02, 0.2]])
    slope = np.array([0.3, -0.1])  # z_1 depends on a_1
    Pa, Pz = np.diag([0.5, 1.0]), np.array([[0.0]])

    def dynamics(a, u, t, dt, theta):
        return a @ F[:, :2].T + b, F[:, 2:], Q

    def measurement(a, u, t, theta):
        return a @ H[:, :2].T, H[:, 2:], R

    def initial(theta):
        return Gaussian([1.0, -1.0], Pa), lambda a: (a @ slope)[:, None], Pz

    model = MixedModel(
        name="coupled",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        nonlinear={"a1": "1", "a2": "1"},
        linear={"z": "1"},
        outputs={"y1": "1", "y2": "1"},
        parameters=[],
    )
    m = np.array([1.0, -1.0, slope @ [1.0, -1.0]])
    J = np.vstack((np.eye(2), slope))
    return model, (m, J @ Pa @ J.T, F, b, H, Q, R)


def test_linear_gaussian_model_is_filtered_exactly():
    model, matrices = coupled()
    y = simulate(model, None, 25, np.random.default_rng(0)).y
    y[3], y[7, 0], y[12, 1], y[20:22] = np.nan, np.nan, np.nan, np.nan
    got = ekf(model, None, Series(y))
    log_p, mean, cov = joint_gaussian(y, *matrices)
    assert got.log_likelihood == pytest.approx(log_p, abs=1e-6)
    np.testing.assert_allclose(got.means[-1], mean, atol=1e-7)
    np.testing.assert_allclose(got.covs[-1], cov, atol=1e-7)
    assert np.isnan(got.innovations[3]).all()
    np.testing.assert_array_equal(np.isnan(got.innovations), np.isnan(y))


def test_nile_log_likelihood():
    """Published for the local level with a diffuse start: -632.5 (Durbin, Koopman)."""
    got = ekf(LEVEL, {"q": 1469.1, "r": 15099.0, "level": 1120.0}, nile())
    first = -0.5 * np.log(2 * np.pi * 2 * 15099.0)  # what the proper first step adds to diffuse
    assert got.log_likelihood - first == pytest.approx(-632.5, abs=0.5)


def test_irregular_steps_and_nonlinear_model_are_consistent():
    rng = np.random.default_rng(1)
    n = 800
    t = np.cumsum(rng.uniform(1.0, 6.0, n))
    u = np.repeat(rng.uniform(1.0, 5.0, n // 20), 20)
    drawn = simulate(TANKS, None, n, rng, u=u, t=t)
    got = ekf(TANKS, None, drawn.series)
    white = got.innovations[5:, 0] / np.sqrt(got.S[5:, 0, 0])
    assert white.mean() == pytest.approx(0.0, abs=0.12)
    assert white.var() == pytest.approx(1.0, abs=0.2)
    e, P = (drawn.a - got.means[:, :2])[20:], got.covs[20:, :2, :2]
    nees = np.einsum("ti,tij,tj->t", e, np.linalg.inv(P), e)
    assert nees.mean() == pytest.approx(2.0, abs=0.4)


def test_the_true_parameter_is_more_likely_than_one_far_off():
    series = simulate(LINEAR, {"theta": 0.5}, 300, np.random.default_rng(2)).series
    at = {k: ekf(LINEAR, {"theta": k}, series).log_likelihood for k in (0.1, 0.5, 1.5)}
    assert at[0.5] == max(at.values())


def test_a_filter_that_is_lost_names_its_time():
    def dynamics(a, u, t, dt, theta):
        return [np.exp(3.0 * np.abs(a[:, 0]) + 3.0), 0.0], [[0.0], [1.0]], np.eye(2)

    unstable = replace(LINEAR, name="unstable", dynamics=dynamics)
    with pytest.raises(ModelError, match=r"'unstable': the extended Kalman filter is lost at t = "):
        ekf(unstable, None, Series(np.r_[1.0, np.full(20, np.nan)]))
