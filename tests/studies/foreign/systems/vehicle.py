"""A car on a road whose slope nobody knows; speedometer in km/h, satellite position in metres.

    x' = v      m v' = F - k v^2 - F0 + m g_slope      g_slope' = -g_slope / tau + noise

The user's model: speed nonlinear by one Runge-Kutta step, position and slope linear, lists of lists.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from engine.statespace.model import Gaussian, MixedModel, Parameter
from tests.studies.foreign import faults, outside, sensors
from tests.studies.foreign.plant import Array, Numbers, Plant
from tests.studies.foreign.written import System, Units, model

DT = 0.5
TRUE = {"m": 1500.0, "k": 0.45, "F0": 180.0, "tau": 40.0}
SLOPE, GUST = 0.03, 0.01  # m/s^2 and m/s per root second
SENSORS = {"ordinary": (1.0, 3.0), "fine": (0.02, 0.1)}


def rhs(x: Numbers, u: Numbers, p: Mapping[str, float]) -> list[float]:
    """Newton's law along the road."""
    _, v, slope = x
    drag = p["k"] * v * abs(v)
    return [v, (1e3 * u[0] - drag - p["F0"]) / p["m"] + slope, -slope / p["tau"]]


def inputs(T: int, dt: float, rng: np.random.Generator) -> Array:
    """Traction and braking in kN around what 25 m/s need."""
    hold = rng.integers(6, 30, size=T)
    return np.repeat(0.46 + rng.uniform(-1.0, 1.0, size=T), hold)[:T, None]


PLANT = Plant(
    name="vehicle",
    dt=DT,
    states=("position", "speed", "slope"),
    inputs_named=("traction",),
    outputs=("speedometer", "satellite"),
    p=TRUE,
    rhs=rhs,
    see=lambda x, u, p: [3.6 * x[1], x[0]],
    intensities=(0.0, GUST, SLOPE),
    sensors=SENSORS,
    start=lambda rng: [0.5 * rng.standard_normal(), 25.0 + 0.3 * rng.standard_normal(), 0.0],
    inputs=inputs,
)


def dynamics(a: Any, u: Any, t: Any, dt: Any, p: Any) -> Any:
    """z = (position, slope)."""
    v = a[:, 0]

    def acceleration(v: Any) -> Any:
        return (1000.0 * u[0] - p.k * v * abs(v) - p.F0) / p.m

    k1 = acceleration(v)
    k2 = acceleration(v + dt / 2 * k1)
    k3 = acceleration(v + dt / 2 * k2)
    k4 = acceleration(v + dt * k3)
    ahead = v + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    moved = dt * v + dt**2 / 6 * (k1 + k2 + k3)
    f = [ahead, moved, 0.0]
    keep = math.exp(-dt / p.tau)
    mean = p.tau * (1.0 - keep)  # integral of a slope that fades
    A = [[0.0, mean], [1.0, p.tau * (dt - mean)], [0.0, keep]]
    g, s = p.q_gust**2, p.q_slope**2
    Q = [
        [g * dt + s * dt**3 / 3, g * dt**2 / 2 + s * dt**4 / 8, s * dt**2 / 2],
        [g * dt**2 / 2 + s * dt**4 / 8, g * dt**3 / 3 + s * dt**5 / 20, s * dt**3 / 6],
        [s * dt**2 / 2, s * dt**3 / 6, s * dt],
    ]
    return f, A, Q


def measurement(a: Any, u: Any, t: Any, p: Any) -> Any:
    """km/h and metres."""
    return (
        [3.6 * a[:, 0], 0.0],
        [[0.0, 0.0], [1.0, 0.0]],
        [[p.r_speed**2, 0.0], [0.0, p.r_place**2]],
    )


def initial(p: Any) -> Any:
    """Cruising past the start of the map."""
    return Gaussian([25.0], [[0.25]]), [0.0, 0.0], [[1.0, 0.0], [0.0, 0.001]]


def base(level: str) -> MixedModel:
    """As a vehicle engineer would write it."""
    speed, place = SENSORS[level]
    return model(
        name="vehicle",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        nonlinear={"speed": "m/s"},
        linear={"position": "m", "slope": "m/s^2"},
        inputs={"traction": "kN"},
        outputs={"speedometer": "km/h", "satellite": "m"},
        parameters=[
            Parameter("m", 1400.0, "kg", (100.0, 1e4)),
            Parameter("k", 0.5, "kg/m", (0.0, 10.0)),
            Parameter("F0", TRUE["F0"], "N", (0.0, 2e3)),
            Parameter("tau", TRUE["tau"], "s", (1.0, 1e3)),
            Parameter("q_gust", 1.2 * GUST, "m/s^1.5", (1e-5, 5.0)),
            Parameter("q_slope", 0.9 * SLOPE, "m/s^2.5", (1e-5, 5.0)),
            Parameter("r_speed", 0.9 * speed, "km/h", (1e-3, 50.0)),
            Parameter("r_place", 1.15 * place, "m", (1e-3, 100.0)),
        ],
        kinematic=("position",),
        reference={"speed": 0.0, "slope": 0.0},
    )


SYSTEM = System(
    PLANT,
    base,
    {
        "wheel": sensors.gain("gain:speedometer", 0, 0.0, 0.005),
        "load": faults.parameter_step("m", 0.1, 10.0),
        "lag": sensors.lag("lag:satellite", 1, DT, 0.1),
        "wind": faults.step("step:speed", 1, 3, 0.05),
        "jump": sensors.step("step:satellite", 1, 2.0),
        "traction": faults.input_saturation("input-saturation:traction", 0, 1.5, 0.3),
        "outliers": sensors.outliers("heavy-tails:speedometer", 0, 0.03),
        "telegraph": outside.telegraph(1, 3, 0.05),
    },
    known=("F0", "tau"),
    units=Units(
        {
            "speed": 3.6,
            "speedometer": 1.0 / 3.6,
            "position": 1e-3,
            "satellite": 1e-3,
            "slope": 10.0,
        },
        {"position": 100.0, "satellite": 100.0},
    ),
    noise=lambda level: {
        "q_gust": GUST,
        "q_slope": SLOPE,
        "r_speed": SENSORS[level][0],
        "r_place": SENSORS[level][1],
    },
)
