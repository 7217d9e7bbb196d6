"""Nonlinear states that show in the readings' noise only: the moment filter does not choose where EM starts."""

from dataclasses import replace

import numpy as np
import pytest

import engine
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


@pytest.mark.parametrize("shown", [0.0, 1.0])
def test_a_start_is_searched_for_where_the_readings_show_the_states(shown):
    model = volatility(shown)
    ahead = WarmStart(model, [returns(60)], model.free_indices(None))
    assert bool(ahead(model.theta())) == bool(shown)
    assert ("does not see them" in ahead.note) == (not shown)


def test_a_variance_is_not_left_on_its_bound():
    """There it lies 16 nats below the maximum, phi = 0.957 and s2 = 0.028 by a grid of 500 points."""
    found = engine.rbps_em(volatility(0.0), returns(), n_iterations=25, method="em", seed=5)
    assert found.theta["phi"] > 0.7
    assert found.theta["s2"] > 0.01


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
