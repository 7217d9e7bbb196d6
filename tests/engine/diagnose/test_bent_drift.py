"""What drifts may bend: no second cause is named for it."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.diagnose import all_effects, diagnose, extend
from engine.diagnose.effects.kinds.bend import EVEN, bend
from engine.diagnose.effects.setting import Setting

VESSEL = engine.continuous(
    name="vessel",
    drift=lambda a, u, t, theta: ([theta.U * u[0] + theta.g * u[1]], [[-theta.U]]),
    diffusion=lambda a, u, t, theta: [[theta.q]],
    measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r]]),
    initial=lambda theta: (None, [20.0], [[1.0]]),
    linear={"T": "degF"},
    inputs={"around": "degF", "heat": "kW"},
    outputs={"y": "degF"},
    parameters=[
        engine.Parameter("U", 0.2, "1/min", (0.0, 5.0)),
        engine.Parameter("g", 1.0, "degF/min/kW", (0.0, 50.0)),
        engine.Parameter("q", 1e-3, "degF^2/min", (1e-8, 10.0)),
        engine.Parameter("r", 0.01, "degF^2", (1e-6, 10.0)),
    ],
)
N, DT, LEFT = 500, 0.5, 0.6  # of the coefficient at the end


def fouled(seed=1, left=LEFT):
    """A coefficient that decays exponentially, by exact steps that are fine beside it."""
    rng = np.random.default_rng(seed)
    around = np.repeat(rng.uniform(10.0, 60.0, N // 20), 20)
    heat = np.repeat(rng.uniform(0.0, 5.0, N // 25), 25)
    x = [20.0]
    for i in range(N - 1):
        U = 0.2 * left ** ((i + 0.5) / N)
        rest = around[i] + 1.5 * heat[i] / U
        x.append(rest + (x[-1] - rest) * np.exp(-U * DT))
    y = np.array(x) + 0.1 * rng.standard_normal(N)
    return engine.Series(y, u=np.column_stack([around, heat]), dt=DT, time_unit="min")


def test_a_bend_is_none_at_the_ends_and_one_in_the_middle():
    """At any sharpness, and a parabola at none."""
    for sharpness in (-12.0, -1.0, 1e-9, 0.0, 0.5, 30.0):
        np.testing.assert_allclose(
            bend(np.array([-0.5, 0.0, 0.5]), sharpness), [0, 1, 0], atol=1e-9
        )
    s = np.linspace(-0.5, 0.5, 11)
    np.testing.assert_allclose(bend(s, 0.0), 1.0 - 4.0 * s**2, atol=1e-12)
    np.testing.assert_allclose(bend(s, 0.99 * EVEN), bend(s, 1.01 * EVEN), atol=1e-4)


def test_bends_are_looked_for_beside_the_drift_that_was_found():
    def bends(setting, kinds=None):
        return [e.name for e in all_effects(setting, kinds) if e.traits.bends]

    plain = Setting(VESSEL)
    assert bends(plain) == []
    beside = plain.beside(extend(VESSEL, ["parameter-drift:U", "drift:y"]))
    assert bends(beside) == ["parameter-bend:U", "bend:y"]
    assert bends(beside, ["parameter-drift:U"]) == ["parameter-bend:U"]
    assert bends(beside, ["step"]) == []
    known = extend(VESSEL, ["ramp:T"])
    assert bends(Setting(known)) == ["bend:T"]
    assert bends(replace(plain, found=("parameter_drift_g",))) == ["parameter-bend:g"]


@pytest.mark.long
def test_a_coefficient_that_decays_has_a_drift_that_bends_and_no_other_cause():
    """What bends was a slow wave of a force, adopted, and of other records a step of another parameter."""
    kinds = ["parameter-drift", "harmonic:T"]
    found = diagnose(VESSEL, fouled(), effects=kinds, seed=1, processes=1)
    assert found.verdict.value == "named"
    assert [cause.effect for cause in found.causes] == ["parameter-drift:U", "parameter-bend:U"]
    searched = 0.8 * N  # the rest is held out
    ends, middle = 0.2 * LEFT ** (np.array([0.0, searched]) / N), 0.2 * LEFT ** (0.5 * searched / N)
    drift, bent = found.causes
    assert drift.size == pytest.approx(ends[1] - ends[0], abs=4.0 * drift.standard_error + 1e-3)
    assert bent.size == pytest.approx(middle - ends.mean(), abs=4.0 * bent.standard_error)


@pytest.mark.long
def test_a_sensor_that_drifts_less_and_less_bends_and_the_vessel_is_left_alone():
    """It was a drift, and beside it a set of steps of other places."""
    clean = fouled(left=1.0)
    later = engine.Series(
        clean.y + 1.5 * (1.0 - np.exp(-clean.t / 150.0))[:, None],
        u=clean.u,
        dt=DT,
        time_unit="min",
    )
    kinds = ["drift", "step"]
    found = diagnose(VESSEL, later, effects=kinds, seed=1, processes=1)
    assert found.verdict.value == "named"
    assert [cause.effect for cause in found.causes] == ["drift:y", "bend:y"]
    bent = found.causes[1]
    assert bent.size == pytest.approx(0.177, abs=4.0 * bent.standard_error)


CAR = engine.continuous(
    name="car",
    drift=lambda a, u, t, theta: (
        [(u[0] - theta.rolling - theta.air * (a[:, 0] / 100.0) ** 2) / theta.m],
        np.zeros((1, 0)),
    ),
    diffusion=lambda a, u, t, theta: [[theta.q]],
    measurement=lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[theta.r]]),
    initial=lambda theta: (engine.Gaussian([60.0], [[100.0]]), [], np.zeros((0, 0))),
    nonlinear={"v": "km/h"},
    inputs={"traction": "kN"},
    outputs={"speed": "km/h"},
    parameters=[
        engine.Parameter("m", 0.4, "kN s h/km", (0.1, 2.0)),
        engine.Parameter("rolling", 0.2, "kN", (0.0, 2.0)),
        engine.Parameter("air", 0.4, "kN", (0.0, 5.0)),
        engine.Parameter("q", 0.01, "(km/h)^2/s", (1e-8, 10.0)),
        engine.Parameter("r", 0.01, "(km/h)^2", (1e-4, 10.0)),
    ],
)


@pytest.mark.long
def test_tyres_that_warm_up_are_no_path_from_the_pedal():
    """A path whose first state fades bends as well: it was named, and the straight drift ruled out."""
    rng = np.random.default_rng(100)
    pedal = np.repeat(rng.uniform(-0.1, 1.4, 20), 25)
    v, y, fine = 60.0, [], 20
    for k, force in enumerate(pedal):
        y.append(v + 0.1 * rng.standard_normal())
        for i in range(fine):
            rolling = 0.2 + 0.12 * np.exp(-(k + i / fine) / 250.0)
            v += (force - rolling - 0.42 * (v / 100.0) ** 2) / 0.4 / fine
    found = diagnose(
        CAR,
        engine.Series(y, u=pedal, dt=1.0),
        effects=["parameter-drift:rolling", "path"],
        seed=1,
        processes=1,
    )
    assert found.verdict.value == "named"
    drift, bent = found.causes
    assert (drift.effect, bent.effect) == ("parameter-drift:rolling", "parameter-bend:rolling")
    assert drift.size == pytest.approx(0.12 * np.expm1(-400 / 250), abs=0.006)
