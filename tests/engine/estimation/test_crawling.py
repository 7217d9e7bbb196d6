"""A search that gains next to nothing of what it expects, as at a kink, is left where it has a target."""

import numpy as np
import pytest

from engine import get_model, simulate
from engine.estimation import quasi_ml as module


@pytest.fixture
def crawling(monkeypatch):
    """A search of which each step gains a hundredth of a nat, whatever the slopes promise."""
    derivatives = module.derivatives

    def step(model, every, theta, indices, direction, value, expected, visited, whole, edges):
        moved = theta.copy()
        moved[indices] += 1e-6 * direction
        _, g, H = derivatives(model, every, moved, indices)
        return moved, (value + 0.01, 1e3 * g, H), whole

    monkeypatch.setattr(module, "_step", step)
    model = get_model("mixed-4")
    series = simulate(model, None, 40, np.random.default_rng(3)).series
    begun, _, _ = module.derivatives(
        model, [series], np.asarray(model.theta()), model.free_indices(None)
    )
    return model, series, begun


@pytest.mark.parametrize("hope", [1.0, 10.0])
def test_a_target_that_the_pace_of_the_last_steps_does_not_reach_is_given_up(crawling, hope):
    model, series, begun = crawling
    found = module.quasi_ml(model, series, target=begun + 0.5 * hope, hope=hope, tolerance=0.02)
    assert found.given_up
    assert not found.converged
    assert found.iterations == module.PATIENCE + 1


def test_a_target_within_the_iterations_left_is_gone_on_for(crawling):
    model, series, begun = crawling
    found = module.quasi_ml(model, series, target=begun + 0.1, tolerance=0.02, max_iterations=20)
    assert not found.given_up
    assert found.iterations == 20
    assert found.log_likelihood == pytest.approx(begun + 0.2)
