"""Standard errors of linear Gaussian models are those of the likelihood, and take one smoother."""

from __future__ import annotations

import numpy as np
import pytest

import engine
from engine.estimation.uncertainty.score import Score
from engine.filters.kalman import kalman_smoother

NAMES = ["loss", "gain", "q", "r"]
THETA = {"loss": 0.2, "gain": 1.0, "q": 0.03, "r": 0.01}


def room(unit: float = 1.0) -> engine.MixedModel:
    """A temperature around 20, in a unit."""

    def dynamics(a, u, t, dt, theta):
        k, gain, Q = theta.loss, dt * theta.gain * u[0], [[theta.q * dt * unit**2]]
        return [unit * (dt * k * 20.0 + gain)], [[1.0 - dt * k]], Q

    def measurement(a, u, t, theta):
        return [0.0], [[1.0]], [[theta.r * unit**2]]

    def initial(theta):
        return None, [20.0 * unit], [[unit**2]]

    return engine.MixedModel(
        name="room",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        linear={"temperature": "K"},
        inputs={"heat": "W"},
        outputs={"reading": "K"},
        parameters=[engine.Parameter(name, THETA[name], "", (1e-9, 10.0)) for name in NAMES],
    )


def record(unit: float = 1.0) -> engine.Series:
    rng = np.random.default_rng(101)
    u = np.repeat((rng.random(20) > 0.5).astype(float), 10)
    x, y = 20.0, np.zeros(200)
    for k in range(200):
        y[k] = x + 0.1 * rng.normal()
        x += 0.5 * (-0.2 * (x - 20.0) + u[k]) + np.sqrt(0.015) * rng.normal()
    y[40:60] = np.nan
    return engine.Series(unit * y[:, None], u=u[:, None], dt=0.5)


@pytest.fixture
def scores(monkeypatch):
    """How often a score was had by a smoother."""
    counted, at = [], Score.at

    def counting(self, x, seed):
        counted.append(1)
        return at(self, x, seed)

    monkeypatch.setattr(Score, "at", counting)
    return counted


@pytest.mark.long
@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_of_linear_states_they_take_one_smoother_and_are_those_of_a_hessian(scores, unit):
    """They took 25, each a pass in Python, and 2.7 times the processor time of the fit."""
    model, series = room(unit), record(unit)
    own = np.asarray(engine.rts_em(model, series).theta)
    errors = engine.standard_errors(model, own, series)
    assert len(scores) == 1

    def value(x):
        theta = dict(zip(NAMES, x, strict=True))
        return kalman_smoother(model, theta, series).log_likelihood

    h, n = 0.05 * errors.values, len(own)
    H = np.empty((n, n))
    for i, a in enumerate(np.diag(h)):
        for j, b in enumerate(np.diag(h)):
            around = value(own + a + b) - value(own + a - b) - value(own - a + b)
            H[i, j] = -(around + value(own - a - b)) / (4.0 * h[i] * h[j])
    np.testing.assert_allclose(errors.values, np.sqrt(np.diag(np.linalg.inv(H))), rtol=0.01)
