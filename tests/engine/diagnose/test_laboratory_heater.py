"""A heater with a thermometer behind it, as it stands in a laboratory; nothing of the engine simulates it.

Its model is a balance of first order at rest. Left out are the thermometer's lag, which is to be named, and
that the heater radiates, which is a small rest.
"""

import numpy as np
import pytest

import engine

ROOM, LAG, ROWS, CUT = 23.0, 20.0, 800, 600
LIKELY = ["slow-sensor", "slow-input", "path", "delay", "lag"]


def readings(seed, warmer=0.0):
    """Heater in % and readings in degC, in steps of 0.3; after the cut the room warms up by as much."""
    rng = np.random.default_rng(seed)
    heater = np.repeat(rng.choice([0, 20, 35, 50, 80, 100], ROWS // 60 + 1), 60)[:ROWS].astype(
        float
    )
    capacity, area, fine = 2.0, 1.2e-3, 20
    hot = seen = ROOM
    y = np.empty(ROWS)
    for k in range(ROWS):
        y[k] = seen
        room = ROOM + warmer * max(k - CUT, 0) / (ROWS - CUT)
        for _ in range(fine):
            lost = 5.0 * area * (hot - room)
            lost += 0.9 * 5.67e-8 * area * ((hot + 273.15) ** 4 - (room + 273.15) ** 4)
            hot += (0.01 * heater[k] - lost) / capacity / fine
            seen += (hot - seen) / LAG / fine
        hot += 0.01 * rng.standard_normal()
    return heater, np.round((y + 0.1 * rng.standard_normal(ROWS)) / 0.3) * 0.3


def dynamics(a, u, t, dt, th):
    warmer = (th.room - a[:, 0] + th.gain * u[0]) / th.tau
    return [a[:, 0] + dt * warmer], np.zeros((1, 0)), [[th.q**2 * dt]]


def measurement(a, u, t, th):
    return [a[:, 0]], np.zeros((1, 0)), [[th.r**2]]


def heater(variance=0.25):
    """The model; ``variance`` of where a record begins, in degC^2 or another unit."""

    def initial(th):
        return engine.Gaussian([th.room], [[variance]]), np.zeros(0), np.zeros((0, 0))

    return engine.MixedModel(
        name="heater",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        nonlinear={"T": "degC"},
        inputs={"heater": "%"},
        outputs={"sensor": "degC"},
        parameters=[
            engine.Parameter("tau", 150.0, "s", (1, 2000)),
            engine.Parameter("gain", 0.5, "degC/%", (0, 5)),
            engine.Parameter("room", 23.0, "degC", (0, 100)),
            engine.Parameter("q", 0.02, "degC/s^0.5", (1e-5, 5)),
            engine.Parameter("r", 0.2, "degC", (1e-3, 5)),
        ],
    )


HEATER = heater()


@pytest.mark.long
@pytest.mark.parametrize("seed", [22])
def test_the_slow_thermometer_is_named_and_adopted(seed):
    u, y = readings(seed)
    train, test = (engine.Series(y=y[i], u=u[i], dt=1.0) for i in (slice(CUT), slice(CUT, None)))
    found = engine.diagnose(HEATER, train, test=test, effects=LIKELY, seed=1)
    assert found.verdict.value in (
        "named",
        "set",
    )  # with a slow actuator, which says nearly the same
    assert [cause.effect for cause in found.causes] == ["slow-sensor:sensor"]
    assert abs(found.causes[0].size / LAG - 1.0) < 0.1
    assert found.adopted
    (run,) = found.gain.outputs
    assert run.rmse_after < 0.7 * run.rmse_before


@pytest.mark.long
def test_what_else_moves_the_held_out_rows_does_not_take_the_name():
    """A fit that leaves nothing to noise loses there, be its cause right or not."""
    u, y = readings(25, warmer=5.0)
    t = np.arange(ROWS)
    train, test = (engine.Series(y=y[i], u=u[i], t=t[i]) for i in (slice(CUT), slice(CUT, None)))
    found = engine.diagnose(HEATER, train, test=test, effects=["slow-sensor", "delay"], seed=1)
    assert [cause.effect for cause in found.causes] == ["slow-sensor:sensor"]
    assert found.verdict.value == "named"
    assert found.gain.noise_of_all
    assert found.adopted
    assert any("fitted to the held-out rows as well" in note for note in found.gain.notes)
    assert not any("steps as long as the model makes them" in note for note in found.notes)
