"""A valve that answers late: an input that multiplies a state, and so does not simply add."""

import numpy as np
import pytest

import engine
from engine import Parameter
from engine.diagnose import extend
from engine.diagnose.effects.of_series import setting_for
from engine.simulation.simulate import step_lengths
from engine.simulation.taped import run_by_tape
from tests.engine.diagnose.test_friction import DT, body, measured

LATE, T = 7, 400
TANK = engine.MixedModel(
    name="valve",
    dynamics=lambda a, u, t, dt, theta: (
        [a[:, 0] + dt * (theta.feed - theta.c * u[0] * a[:, 0])],
        np.zeros((1, 0)),
        [[theta.q]],
    ),
    measurement=lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[theta.r]]),
    initial=lambda theta: (engine.Gaussian([1.0], [[0.04]]), [], np.zeros((0, 0))),
    nonlinear={"level": "m"},
    inputs={"valve": "1"},
    outputs={"gauge": "m"},
    parameters=[
        Parameter("feed", 0.08, "m/s", (0.0, 1.0)),
        Parameter("c", 0.15, "1/s", (0.0, 1.0)),
        Parameter("q", 1e-4, "m^2", (1e-9, 1.0)),
        Parameter("r", 1e-3, "m^2", (1e-9, 1.0)),
    ],
)


def record(late, seed=1):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.2, 1.5, T // 16), 16)
    seen = np.concatenate([np.full(late, u[0]), u])[:T]
    level, y = 1.0, np.empty(T)
    for k in range(T):
        y[k] = level + 0.02 * rng.standard_normal()
        level += 0.1 - 0.12 * seen[k] * level + 0.01 * rng.standard_normal()
    return engine.Series(y, u=u, dt=1.0)


@pytest.mark.long
@pytest.mark.parametrize("late", [0, pytest.param(LATE, marks=pytest.mark.slow)])
def test_a_valve_that_is_seven_samples_late_is_found(late):
    found = engine.diagnose(TANK, record(late), effects=["delay", "direct", "lag", "path"], seed=1)
    assert [cause.effect for cause in found.causes] == ["delay:valve"] * bool(late)
    if late:
        assert found.causes[0].size == pytest.approx(late, abs=0.5)


@pytest.mark.parametrize("name", ["delay:force", "delay:y"])
def test_a_late_channel_beside_steps_is_run_without_calls(name):
    """Whether a step begins at a sample was a branch: a free run by calls took ninety times as long."""
    x, u = measured(T=60)
    series = engine.Series(x, u, dt=DT, y_names=["y"], u_names=["force"]).refined(4)
    model = body()
    late = extend(model, [name], setting_for(model, series, np.asarray(model.theta())))
    record = late.record(late.theta({name.replace(":", "_"): 2.5}))
    taped = run_by_tape(late, record, series, np.zeros((1, late.nx)), step_lengths(series))
    assert taped is not None
    for x, u, t, dt, after in zip(
        taped[:, 0], series.u_step, series.t, step_lengths(series), taped[1:, 0], strict=False
    ):
        f, A, _ = late.transition(x[None, : late.na], u, t, dt, record)
        called = f[0] + np.reshape(A, (late.nx, late.nz)) @ x[late.na :]
        np.testing.assert_allclose(after, called, rtol=1e-9, atol=1e-12)
