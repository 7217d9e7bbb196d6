"""What the steps of an extended model get wrong is no further effect; a further effect is."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from engine import Gaussian, MixedModel, Parameter, Series
from engine.diagnose.effects.setting import setting_for
from engine.diagnose.search.pipeline import find_causes
from engine.diagnose.search.substeps import can_be_finer

DT = 0.05
KINDS = ["drag", "cubic", "coulomb", "cubic-sensor", "gain", "saturation-sensor"]


def dynamics(a, u, t, dt, th):
    """v' = k u - b v, exact at any step."""
    kept = math.exp(-th.b * dt)
    moved = th.k / th.b * (1.0 - kept)
    return [moved * u[0]], [[kept]], [[th.q**2 * dt]]


DRIVE = MixedModel(
    name="exact drive",
    dynamics=dynamics,
    measurement=lambda a, u, t, th: ([0.0], [[1.0]], [[th.r**2]]),
    initial=lambda th: (Gaussian([], np.zeros((0, 0))), [0.0], [[1e-4]]),
    linear={"speed": "m/s"},
    inputs={"voltage": "V"},
    outputs={"tacho": "m/s"},
    reference={"speed": 0.0, "tacho": 0.0},
    continuous=True,
    parameters=[
        Parameter("k", 1.0, "m/s^2/V", (0.01, 10.0)),
        Parameter("b", 1.0, "1/s", (0.01, 50.0)),
        Parameter("q", 0.01, "m/s^1.5", (1e-5, 1.0)),
        Parameter("r", 1e-3, "m/s", (1e-5, 1.0)),
    ],
)


def measured(drag, bent, T=400, fine=20, seed=3):
    """By another program: Euler steps twenty times shorter, a nearly noise-free sensor, ``bent`` or not."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-6.0, 6.0, T), rng.integers(5, 30, T))[:T]
    v, y, h = 0.0, np.empty(T), DT / fine
    for t in range(T):
        y[t] = v - bent * v**3
        for _ in range(fine):
            v += h * (u[t] - v - drag * v * abs(v)) + 0.01 * math.sqrt(h) * rng.standard_normal()
    return Series(y + 1e-3 * rng.standard_normal(T), u=u, dt=DT)


def names(found):
    return [r.refits[0].effect.name for r in found.search.rounds if r.equivalent]


@pytest.fixture(scope="module")
def plain():
    return find_causes(DRIVE, measured(0.1, 0.0), None, effects=KINDS, seed=1)


def test_what_shorter_steps_explain_is_not_named(plain):
    assert names(plain) == ["drag:speed"]
    assert plain.search.of_the_steps == "cubic-sensor:tacho"
    assert any("what the steps get wrong" in note for note in plain.notes)
    assert plain.verdict.value == "named"


def test_a_second_effect_is_named_beside_the_first():
    found = find_causes(DRIVE, measured(0.02, 2e-3), None, effects=KINDS, seed=1)
    assert {"drag:speed", "cubic-sensor:tacho"} == {*names(found)}
    assert found.search.of_the_steps == ""


def test_steps_are_halved_only_where_that_means_something():
    """A step that is none in time, and samples at no common step."""
    series = measured(0.02, 0.0, T=60)
    theta = np.asarray(DRIVE.theta())

    def fine(model, one):
        return can_be_finer(setting_for(model, one, theta), one, theta)

    assert fine(DRIVE, series)
    counted = replace(DRIVE, dynamics=lambda a, u, t, dt, th: dynamics(a, u, t, DT, th))
    assert not fine(counted, series)
    assert not fine(replace(DRIVE, continuous=False), series)
    assert not fine(DRIVE, Series(series.y, u=series.u, t=series.t + 1e-2 * (series.t > 1.0)))
