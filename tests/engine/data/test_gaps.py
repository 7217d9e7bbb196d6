"""Inputs over gaps of the times: told where they will have changed, in any units and at any origin."""

import numpy as np
import pytest

from engine import fit_simulation, get_model
from engine.data.faults import faults_of
from engine.data.series import Series


def levels(seed, n=300, rows=20):
    return np.repeat(np.random.default_rng(seed).uniform(0.0, 40.0, n // rows + 1), rows)[:n]


def told(u, t, hold="zoh", unit="W"):
    series = Series(y=np.zeros((len(t), 0)), u=u, t=t, hold=hold)
    names = [f"heater{k}" if k else "heater" for k in range(series.u.shape[1])]
    return " ".join(faults_of({}, dict.fromkeys(names, unit), series))


def with_gap(n=300, rows=100, at=150, step=5.0):
    t = step * np.arange(n, dtype=float)
    t[at:] += rows * step
    return t


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("scale", "shift"), [(1.0, 0.0), (1e-7, 3.0), (1e6, -1e9)])
def test_a_gap_over_which_an_input_moves_is_told_in_any_units(seed, scale, shift):
    u, t = levels(seed), with_gap()
    said = told(scale * u + shift, t)
    assert "No rows for 505 s after t = 745 s, where a step is 5 s" in said
    assert "heater is taken for" in said
    assert "No rows for 0.505 s" in told(scale * u + shift, 1e-3 * t)


def test_inputs_between_samples_are_taken_as_the_series_says():
    u, t = levels(1), with_gap()
    before, after = (f"{u[k]:.3g} W" for k in (149, 150))
    u[150:] = np.roll(u[150:], 7)
    after = f"{u[150]:.3g} W"
    assert f"is taken for {before} in" in told(u, t)
    assert f"is taken for {after} in" in told(u, t, "past")
    assert f"goes straight from {before} to {after} in" in told(u, t, "foh")


def test_what_is_no_gap():
    u, even = levels(2), 5.0 * np.arange(300)
    assert not told(u, even)
    rng = np.random.default_rng(0)
    assert not told(u, even + rng.uniform(-2.0, 2.0, 300))  # a clock that jitters
    assert not told(u, np.cumsum(rng.exponential(5.0, 300)))  # somebody came to read it
    assert not told(u, with_gap(rows=2))  # two rows lost
    assert not told(np.full(300, 7.0), with_gap())  # rests
    slow = 20.0 + np.sin(np.arange(300) / 40.0)
    assert not told(slow, with_gap(rows=8))  # as good as known


def test_only_inputs_that_move_are_named():
    u = np.column_stack([np.full(300, 3.0), levels(4)])
    said = told(u, with_gap())
    assert "heater1 is taken for" in said
    assert "heater is taken" not in said


def test_the_longest_of_several_gaps_is_told():
    t = with_gap()
    t[220:] += 3600.0
    said = told(levels(5), t)
    assert "No rows for 3605 s after t = 1595 s" in said
    assert "It is the longest of 2 gaps." in said


def test_a_fit_tells_of_it():
    model = get_model("servo")
    u, t = levels(6, n=200) / 5.0 - 4.0, with_gap(200, 60, 90, 0.02)
    y = np.random.default_rng(6).normal(size=(200, 1))
    found = fit_simulation(model, Series(y=y, u=u, t=t), free=["offset"])
    assert "Look at the record first. No rows for 1.22 s after t = 1.78 s" in found.message
