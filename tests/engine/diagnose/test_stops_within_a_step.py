"""A drive of a user whose friction acts over a whole step, on a record of one that stops at any time."""

import numpy as np
import pytest

import engine
from engine.diagnose import diagnose
from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.kinds.time_step import KIND
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.steps.substeps import undeclared

M, B, FRICTION, GAIN = 0.8, 1.6, 0.15, 0.3  # kg, N s/m, N, N/V
DT, T, SHORT = 0.02, 800, 40  # s, samples, steps a sample


def dynamics(a, u, t, dt, theta):
    """Friction is constant over a step, at most what brings the slide to rest at its end: else exact."""
    v, force = a[:, 0], GAIN * u[0]
    decay = np.exp(-theta.b * dt / theta.m)
    push = (1.0 - decay) / theta.b
    friction = np.clip((decay * v + push * force) / push, -theta.friction, theta.friction)
    way = theta.m * push * v + (dt - theta.m * push) / theta.b * (force - friction)
    Q = np.diag([theta.q**2 * dt, (1e-2 * theta.q) ** 2 * dt**3])
    return [decay * v + push * (force - friction), way], [[0.0], [1.0]], Q


SLIDE = engine.MixedModel(
    name="slide",
    dynamics=dynamics,
    measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r**2]]),
    initial=lambda theta: (engine.Gaussian([0.0], [[1e-6]]), [0.0], [[1e-6]]),
    nonlinear={"speed": "m/s"},
    linear={"position": "m"},
    inputs={"voltage": "V"},
    outputs={"reading": "m"},
    parameters=[
        engine.Parameter("m", M, "kg", (1e-2, 1e2)),
        engine.Parameter("b", B, "N s/m", (1e-3, 1e2)),
        engine.Parameter("friction", FRICTION, "N", (0.0, 10.0)),
        engine.Parameter("q", 4e-3, "m/s^1.5", (1e-7, 1.0)),
        engine.Parameter("r", 1e-4, "m", (1e-7, 1.0)),
    ],
)


def record(seed, held=25):
    """Coulomb's law in short steps; so many samples the voltage is the same."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-6.0, 6.0, T // held), held)
    h, x, v, y = DT / SHORT, 0.0, 0.0, np.zeros(T)
    for k in range(T):
        y[k] = x + 1e-4 * rng.standard_normal()
        for _ in range(SHORT):
            pushed = v + h * (GAIN * u[k] - B * v) / M + 4e-3 * np.sqrt(h) * rng.standard_normal()
            after = np.sign(pushed) * max(abs(pushed) - h * FRICTION / M, 0.0)
            x, v = x + 0.5 * h * (v + after), after
    return engine.Series(y, u=u, dt=DT)


def test_shorter_steps_are_asked_for_though_few_rows_tell():
    series = record(0, held=200)
    setting = setting_for(SLIDE, series, np.asarray(SLIDE.theta()))
    assert [effect.name for effect in all_effects(setting, [KIND])] == ["time-step:dt"]
    assert undeclared(SLIDE, series) == ""  # two half-steps do not agree with one wherever it stops


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_it_is_no_other_friction(seed):
    kinds = ["coulomb", "stribeck", "deadzone", "time-step"]
    found = diagnose(SLIDE, record(seed), effects=kinds, seed=1, held_out=0, processes=1)
    (cause,) = found.causes
    assert cause.effect == "time-step:dt"
    assert 0.8 < cause.size < 1.6
