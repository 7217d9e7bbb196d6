"""A ship's heading and rate of turn in degrees; compass and gyro.

    heading' = rate      T rate' = K rudder - rate + T m      m the waves' and the wind's moment, slow

The user's model is exact, its matrices filled in entry by entry; the moment is a disturbance state.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from engine.statespace.model import Gaussian, MixedModel, Parameter
from tests.studies.foreign import faults, outside, sensors
from tests.studies.foreign.plant import SUBSTEPS, Array, Numbers, Plant
from tests.studies.foreign.written import System, Units, model

DT = 2.0
TRUE = {"T": 18.0, "K": 0.09, "tau": 60.0}
WAVES, SLOW = 0.02, 2e-3  # deg/s and deg/s^2 per root second
SENSORS = {"ordinary": (1.0, 0.12), "fine": (0.05, 2e-3)}


def rhs(x: Numbers, u: Numbers, p: Mapping[str, float]) -> list[float]:
    """Nomoto's first-order model."""
    _, rate, moment = x
    return [rate, (p["K"] * u[0] - rate) / p["T"] + moment, -moment / p["tau"]]


def inputs(T: int, dt: float, rng: np.random.Generator) -> Array:
    """Rudder angles to either side."""
    hold = rng.integers(8, 30, size=T)
    return np.repeat(rng.uniform(-25.0, 25.0, size=T), hold)[:T, None]


PLANT = Plant(
    name="ship",
    dt=DT,
    states=("heading", "rate", "moment"),
    inputs_named=("rudder",),
    outputs=("compass", "gyro"),
    p=TRUE,
    rhs=rhs,
    see=lambda x, u, p: [x[0], x[1]],
    intensities=(0.0, WAVES, SLOW),
    sensors=SENSORS,
    start=lambda rng: [120.0 + rng.standard_normal(), 0.1 * rng.standard_normal(), 0.0],
    inputs=inputs,
)


def dynamics(a: Any, u: Any, t: Any, dt: Any, th: Any) -> Any:
    """Exact but for the moment's own decay within a step, which is taken to second order."""
    e = np.exp(-dt / th.T)
    A = np.eye(3)
    A[0, 1] = th.T * (1 - e)
    A[0, 2] = th.T * (dt - th.T * (1 - e)) * (1 - dt / th.tau / 3)
    A[1, 1] = e
    A[1, 2] = th.T * (1 - e) * (1 - dt / th.tau / 2)
    A[2, 2] = np.exp(-dt / th.tau)
    turn = th.K * u[0]
    f = np.array([turn * (dt - th.T * (1 - e)), turn * (1 - e), 0.0])
    n = th.q**2
    Q = np.zeros((3, 3))
    Q[0, 0] = n * dt**3 / 3
    Q[0, 1] = Q[1, 0] = n * dt**2 / 2 * e
    Q[1, 1] = n * th.T * (1 - e**2) / 2
    Q[2, 2] = SLOW**2 * dt
    Q[1, 2] = Q[2, 1] = SLOW**2 * dt**2 / 2
    Q[1, 1] += SLOW**2 * dt**3 / 3
    return f, A, Q


def measurement(a: Any, u: Any, t: Any, th: Any) -> Any:
    """Compass and gyro."""
    C = np.zeros((2, 3))
    C[0, 0] = C[1, 1] = 1
    return np.zeros(2), C, np.diag([th.r_compass, th.r_gyro]) ** 2


def initial(th: Any) -> Any:
    """On course."""
    return Gaussian([], np.zeros((0, 0))), [120, 0, 0], np.diag([4.0, 0.04, 1e-5])


def base(level: str) -> MixedModel:
    """As a naval architect would write it."""
    compass, gyro = SENSORS[level]
    return model(
        name="ship",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        linear={"heading": "deg", "rate": "deg/s", "moment": "deg/s^2"},
        inputs={"rudder": "deg"},
        outputs={"compass": "deg", "gyro": "deg/s"},
        parameters=[
            Parameter("T", 20.0, "s", (0.5, 500.0)),
            Parameter("K", 0.1, "1/s", (1e-3, 5.0)),
            Parameter("tau", TRUE["tau"], "s", (1.0, 1e4)),
            Parameter("q", 1.15 * WAVES, "deg/s^1.5", (1e-5, 5.0)),
            Parameter("r_compass", 0.9 * compass, "deg", (1e-4, 20.0)),
            Parameter("r_gyro", 1.2 * gyro, "deg/s", (1e-5, 5.0)),
        ],
        kinematic=("heading",),
        reference={"rate": 0.0, "moment": 0.0},
    )


SYSTEM = System(
    PLANT,
    base,
    {
        "rudder": faults.parameter_step("K", 0.1, 5.0),
        "dead-zone": faults.input_dead_zone("input-deadzone:rudder", 0, 1.0),
        "bias": sensors.bias("bias:gyro", 1, 0.05),
        "gain": sensors.gain("gain:gyro", 1, 0.0, 0.03),
        "current": faults.harmonic("harmonic:rate", 1, 3, 5e-3),
        "delay": faults.input_delay("delay:rudder", 0, SUBSTEPS, 0.2),
        "chirp": outside.chirp(1, 3, 500, DT, 5e-3),
    },
    known=("tau",),
    units=Units(
        {
            "heading": np.pi / 180.0,
            "rate": 60.0,
            "compass": np.pi / 180.0,
            "gyro": 60.0,
            "moment": 3600.0,
            "rudder": np.pi / 180.0,
        },
        {"heading": -2.0, "compass": -2.0},
        1.0 / 60.0,
    ),
    noise=lambda level: {
        "q": WAVES,
        "r_compass": SENSORS[level][0],
        "r_gyro": SENSORS[level][1],
    },
)
