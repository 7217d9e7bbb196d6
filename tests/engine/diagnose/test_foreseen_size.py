"""A drive by Euler's rule: of names for what its steps get wrong, the one whose size is foreseen leads."""

import numpy as np
import pytest
from scipy.linalg import expm

import engine
from engine.diagnose import diagnose

T, DT = 300, 0.01
J, B, K, R, L = 0.025, 0.015, 0.28, 1.0, 0.06


def dynamics(a, u, t, dt, theta):
    A = [
        [1.0 - dt * theta.b / theta.J, dt * theta.k / theta.J],
        [-dt * theta.k / theta.L, 1.0 - dt * theta.R / theta.L],
    ]
    return [0.0, dt * u[0] / theta.L], A, np.diag([1e-4 * dt, 1e-6 * dt])


DRIVE = engine.MixedModel(
    name="drive",
    dynamics=dynamics,
    measurement=lambda a, u, t, theta: ([0.0], [[1.0, 0.0]], [[theta.r**2]]),
    initial=lambda theta: (None, [0.0, 0.0], 0.01 * np.eye(2)),
    nonlinear={},
    linear={"speed": "rad/s", "current": "A"},
    inputs={"voltage": "V"},
    outputs={"tachometer": "rad/s"},
    parameters=[
        engine.Parameter("J", 0.02, "kg m^2", (1e-3, 1.0)),
        engine.Parameter("b", 0.02, "N m s", (1e-5, 1.0)),
        engine.Parameter("k", 0.3, "N m/A", (0.01, 2.0)),
        engine.Parameter("L", 0.05, "H", (0.005, 0.5)),
        engine.Parameter("R", 1.2, "Ohm", (0.1, 10.0)),
        engine.Parameter("r", 0.2, "rad/s", (1e-4, 5.0)),
    ],
)


def record():
    """Its differential equations, exactly."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(-12.0, 12.0, T // 20), 20)
    F = expm(DT * np.array([[-B / J, K / J, 0.0], [-K / L, -R / L, 1.0 / L], [0.0, 0.0, 0.0]]))
    x, y = np.zeros(3), np.zeros(T)
    for k in range(T):
        x[2] = u[k]
        y[k] = x[0] + 0.2 * rng.standard_normal()
        x = F @ x
    return engine.Series(y, u=u, dt=DT)


@pytest.mark.long
def test_what_the_steps_of_a_model_get_wrong_is_named_so():
    """An input that acts on the speed at once does the same, at a size that is fitted: before, it led."""
    kinds = ["extra-input", "time-step", "hold"]
    found = diagnose(DRIVE, record(), effects=kinds, seed=1, held_out=0, processes=1)
    assert found.verdict.value == "named"
    (cause,) = found.causes
    assert cause.effect == "time-step:dt"
    assert cause.size == pytest.approx(4 / 3, abs=0.2)  # of a scheme of first order
    rival = next(r for r in found.search.rounds[0].refits if r.effect.kind == "extra-input")
    assert rival.gain > cause.gain - 2.0
