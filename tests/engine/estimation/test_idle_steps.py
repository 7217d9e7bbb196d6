"""A step that was cut short and gains next to nothing is no sign that the maximum is reached."""

from importlib import import_module

import numpy as np
import pytest

import engine

module = import_module("engine.estimation.quasi_ml")
MODEL = engine.get_model("local-level")


def test_a_search_goes_on_after_a_step_that_was_cut_short(monkeypatch):
    """As at a kink, beside which the way is long: drag of a motor was left at a sixth of what it gains."""
    series = engine.simulate(MODEL, None, 200, 1).series
    there = module.quasi_ml(MODEL, series)
    start = MODEL.theta(0.3 * np.asarray(there.theta))
    own, calls = module._step, []

    def step(model, given, theta, indices, direction, value, expected, visited, whole, edges):
        calls.append(value)
        if len(calls) == 1:
            moved = theta + 0.0
            moved[indices] += 1e-12 * direction
            return moved, module.derivatives(model, given, moved, indices, visited), False
        return own(model, given, theta, indices, direction, value, expected, visited, whole, edges)

    monkeypatch.setattr(module, "_step", step)
    found = module.quasi_ml(MODEL, series, start)
    assert len(calls) > 2
    assert found.converged
    assert found.log_likelihood == pytest.approx(there.log_likelihood, abs=1e-3)
