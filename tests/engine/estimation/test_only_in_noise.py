"""Nonlinear states that show in the readings' noise only: the moment filter does not choose where EM starts."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

import engine
from engine.estimation.particle_likelihood import ParticleLikelihood
from engine.estimation.start import WarmStart


def volatility(shown):
    """Stochastic volatility, y = shown h + exp(h / 2) e."""
    return engine.MixedModel(
        name="volatility",
        dynamics=lambda a, u, t, dt, th: (
            [th.mu + th.phi * (a[:, 0] - th.mu)],
            np.zeros((1, 0)),
            [[th.s2]],
        ),
        measurement=lambda a, u, t, th: (
            [shown * a[:, 0]],
            np.zeros((1, 0)),
            np.exp(a[:, 0])[:, None, None],
        ),
        initial=lambda th: (engine.Gaussian([-1.0], [[1.0]]), [], np.zeros((0, 0))),
        nonlinear={"h": ""},
        outputs={"y": ""},
        parameters=[
            engine.Parameter("phi", 0.8, "", (-1.0, 1.0)),
            engine.Parameter("mu", 0.0, "", (-10.0, 10.0)),
            engine.Parameter("s2", 0.2, "", (1e-5, 5.0)),
        ],
    )


def returns(T=400):
    rng = np.random.default_rng(5)
    h, y = -1.0, np.zeros(T)
    for k in range(T):
        y[k] = np.exp(h / 2.0) * rng.normal()
        h = -1.0 + 0.95 * (h + 1.0) + np.sqrt(0.06) * rng.normal()
    return engine.Series(y, dt=1.0)


@pytest.mark.long
@pytest.mark.parametrize("shown", [0.0, 1.0])
def test_a_start_is_searched_for_where_the_readings_show_the_states(shown):
    model = volatility(shown)
    ahead = WarmStart(model, [returns(60)], model.free_indices(None))
    assert bool(ahead(model.theta())) == bool(shown)
    assert ("does not see them" in ahead.note) == (not shown)


@pytest.mark.slow
def test_a_variance_is_not_left_on_its_bound():
    """There it lies 16 nats below the maximum, phi = 0.957 and s2 = 0.028 by a grid of 500 points."""
    found = engine.rbps_em(volatility(0.0), returns(), n_iterations=25, method="em", seed=5)
    assert found.theta["phi"] > 0.7
    assert found.theta["s2"] > 0.01


@pytest.mark.slow
def test_states_that_an_input_at_rest_hides_at_first_are_seen():
    model = volatility(0.0)
    seen = replace(
        model,
        inputs={"u": ""},
        measurement=lambda a, u, t, th: (
            [a[:, 0] * u[0]],
            np.zeros((1, 0)),
            np.exp(a[:, 0])[:, None, None],
        ),
    )
    u = np.r_[np.zeros(40), np.ones(20)]
    series = engine.Series(returns(60).y, u, dt=1.0)
    assert WarmStart(seen, [series], seen.free_indices(None))(seen.theta())


def by_grid(y, mu, phi, s2, n=250):
    """The log-likelihood of stochastic volatility by the point-mass filter on a grid."""
    spread = np.sqrt(s2 / (1.0 - phi**2))
    h = np.linspace(mu - 6.0 * spread, mu + 6.0 * spread, n)
    step = np.exp(-0.5 * (h[None] - mu - phi * (h[:, None] - mu)) ** 2 / s2)
    step *= (h[1] - h[0]) / np.sqrt(2.0 * np.pi * s2)
    p = np.exp(-0.5 * (h + 1.0) ** 2)
    total = 0.0
    p /= p.sum()
    for value in y:
        p = p * np.exp(-0.5 * (value**2 * np.exp(-h) + h)) / np.sqrt(2.0 * np.pi)
        total += np.log(p.sum())
        p = (p / p.sum()) @ step
    return total


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_from_a_start_far_off_the_maximum_is_reached(seed):
    """By scores of jumping likelihoods it ended 3 to 9 nats below and said that it had converged."""
    rng = np.random.default_rng(seed)
    h, y = -0.3, np.zeros(300)
    for k in range(300):
        y[k] = np.exp(h / 2.0) * rng.normal()
        h = -0.3 + 0.95 * (h + 0.3) + np.sqrt(0.06) * rng.normal()
    series = engine.Series(y, dt=1.0)
    found = engine.rbps_em(volatility(0.0), series, {"s2": 0.4, "phi": 0.6, "mu": 0.5}, seed=seed)

    def loss(x):
        return -by_grid(y, x[0], np.tanh(x[1]), np.exp(x[2]))

    best = minimize(loss, [-0.3, 1.8, -2.8], method="Nelder-Mead", options={"xatol": 1e-2})
    reached = by_grid(y, *(found.theta[name] for name in ("mu", "phi", "s2")))
    assert found.outcome.success
    assert reached > -best.fun - 0.6


@pytest.mark.long
def test_slopes_by_a_few_particles_are_those_of_the_grid():
    """And their products the information, which noise made fifty times too large."""
    model, series = volatility(0.0), returns()
    x = np.array([0.85, -0.7, 0.3])
    slope, information = ParticleLikelihood(model, [series]).score(model.theta(x), np.arange(3))

    def exact(x):
        return by_grid(series.y[:, 0], x[1], x[0], x[2])

    ways = 1e-3 * np.eye(3)
    expected = [(exact(x + way) - exact(x - way)) / 2e-3 for way in ways]
    error = 1.0 / np.sqrt(np.diag(np.linalg.inv(information)))
    assert (
        np.abs(slope - expected) < 0.7 * error
    ).all()  # the step is a third of an error, over which slopes bend
    curved = [-(exact(x + 20 * way) - 2.0 * exact(x) + exact(x - 20 * way)) / 4e-4 for way in ways]
    share = np.diag(information) / curved
    assert (share > 0.4).all()
    assert (share < 2.5).all()
