"""A state without noise that forgets its beginning is known ever better: what acts on it is seen as before."""

import numpy as np
import pytest

import engine
from engine.filters.sigma_point import moment_path

DT, TAU, T = 0.01, 0.06, 600
GAIN = TAU * (1.0 - np.exp(-DT / TAU))  # of speed over force, one step on


def cart(unit=1.0, zero=0.0):
    """A cart that is pushed through a motor's lag; forces in ``unit``, counted from ``zero``."""

    def dynamics(a, u, t, dt, theta):
        keep = np.exp(-dt / theta.tau)
        pushed = theta.tau * (1.0 - keep)
        A = [[1.0, pushed / unit], [0.0, keep]]
        f = [
            (dt - pushed) * (u[0] - zero) / unit - pushed * zero / unit,
            (1.0 - keep) * u[0],
        ]
        return f, A, np.diag([theta.q * dt, 0.0])

    return engine.MixedModel(
        name="cart",
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([0.0], [[1.0, 0.0]], [[theta.r]]),
        initial=lambda theta: (None, [0.0, zero], np.diag([1e-4, (1e-4 * unit) ** 2])),
        linear={"speed": "m/s", "force": "N"},
        inputs={"command": "N"},
        outputs={"tacho": "m/s"},
        parameters=[
            engine.Parameter("tau", TAU, "s", (0.005, 1.0)),
            engine.Parameter("q", 1e-3, "m^2/s^3", (0.0, 1.0)),
            engine.Parameter("r", 1e-4, "m^2/s^2", (1e-9, 1.0)),
        ],
    )


def pushed(offset=0.0, unit=1.0, zero=0.0):
    """A record of it, by steps of a tenth of the samples; the motor pushes ``offset`` more than it is told."""
    rng = np.random.default_rng(1)
    u, h = np.repeat(rng.uniform(-1.0, 1.0, T // 30), 30), DT / 10.0
    y, speed, force = np.empty(T), 0.0, 0.0
    for k in range(T):
        y[k] = speed + 0.01 * rng.standard_normal()
        for _ in range(10):
            speed += h * force + np.sqrt(1e-3 * h) * rng.standard_normal()
            force += h * (u[k] + offset - force) / TAU
    return engine.Series(y, unit * u + zero, dt=DT)


@pytest.mark.parametrize(("unit", "zero"), [(1.0, 0.0), (1e-9, 0.0), (1e6, 3e6)])
def test_slopes_are_those_of_the_model_however_well_the_state_is_known(unit, zero):
    model = cart(unit, zero)
    path = moment_path(model, np.asarray(model.theta()), pushed(unit=unit, zero=zero))
    assert np.sqrt(path.P_predicted[-1, 1, 1]) < 1e-20 * unit
    np.testing.assert_allclose(path.F[:, 0, 1] * unit, GAIN, rtol=1e-3)
    np.testing.assert_allclose(path.F[:, 1, 1], np.exp(-DT / TAU), rtol=1e-3)


@pytest.mark.slow
def test_what_acts_on_it_is_named_and_no_size_is_said_that_nobody_could_see():
    """Once the offset was not testable, and a drag of the force was said to be seen from 1e-103 on."""
    kinds = ["input-offset", "linear"]
    found = engine.diagnose(cart(), pushed(0.2), effects=kinds, seed=0)
    (cause,) = found.causes
    assert "input-offset:command" in cause.equivalent
    smallest = {one.effect: one.smallest for one in found.detectable if one.testable}
    assert "input-offset:command" in smallest
    assert min(smallest.values()) > 1e-4
