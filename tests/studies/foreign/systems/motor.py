"""A DC motor that drives a load, its speed in revolutions per minute; ammeter and tachometer.

    L i' = v - R i - k W      J W' = k i - b W - m      m' = 0 + noise      W in rad/s, m the load's torque

The user's model is linear, with a Taylor series of the matrix exponential and Simpson's rule for the noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from engine.statespace.model import Gaussian, MixedModel, Parameter
from tests.studies.foreign import faults, outside, sensors
from tests.studies.foreign.plant import SUBSTEPS, Array, Numbers, Plant
from tests.studies.foreign.written import System, Units, model

DT = 2e-3
RPM = 60.0 / (2.0 * np.pi)
TRUE = {"R": 1.0, "L": 8e-3, "k": 0.05, "J": 6e-5, "b": 4e-5}
LOAD = 0.02  # N m per root second
SPEED = 10.0  # rpm per root second
SENSORS = {"ordinary": (0.25, 40.0), "fine": (5e-3, 1.0)}


def rhs(x: Numbers, u: Numbers, p: Mapping[str, float]) -> list[float]:
    """Kirchhoff and Newton."""
    i, rpm, load = x
    W = rpm / RPM
    return [
        (u[0] - p["R"] * i - p["k"] * W) / p["L"],
        RPM * (p["k"] * i - p["b"] * W - load) / p["J"],
        0.0,
    ]


def inputs(T: int, dt: float, rng: np.random.Generator) -> Array:
    """Voltages of either sign."""
    hold = rng.integers(10, 50, size=T)
    return np.repeat(rng.uniform(-24.0, 24.0, size=T), hold)[:T, None]


PLANT = Plant(
    name="motor",
    dt=DT,
    states=("current", "speed", "load"),
    inputs_named=("voltage",),
    outputs=("ammeter", "tachometer"),
    p=TRUE,
    rhs=rhs,
    see=lambda x, u, p: [x[0], x[1]],
    intensities=(0.0, SPEED, LOAD),
    sensors=SENSORS,
    start=lambda rng: [0.3 * rng.standard_normal(), 50.0 * rng.standard_normal(), 0.02],
    inputs=inputs,
)


@lru_cache(maxsize=4096)
def matrices(
    R: float, L: float, k: float, J: float, b: float, q_speed: float, q_load: float, dt: float
) -> tuple[Any, Any, Any]:
    """A = exp(F dt) to the fifth order, the voltage's column of its integral; Q by Simpson's rule."""
    F = np.array(
        [
            [-R / L, -k / L / RPM, 0.0],
            [RPM * k / J, -b / J, -RPM / J],
            [0.0, 0.0, 0.0],
        ]
    )

    def series(h: float) -> tuple[Any, Any]:
        Phi, integral, term = np.eye(3), h * np.eye(3), np.eye(3)
        for n in range(1, 6):
            term = term @ F * (h / n)
            Phi = Phi + term
            integral = integral + term * (h / (n + 1))
        return Phi, integral

    A, integral = series(dt)
    half, _ = series(dt / 2)
    Qc = np.diag([0.0, q_speed**2, q_load**2])
    Q = dt / 6 * (Qc + 4 * half @ Qc @ half.T + A @ Qc @ A.T)
    return A, integral[:, 0] / L, Q


def dynamics(a: Any, u: Any, t: Any, dt: Any, th: Any) -> Any:
    """Exact to the fifth order of the step."""
    A, b, Q = matrices(th.R, th.L, th.k, th.J, th.b, th.q_speed, th.q_load, dt)
    return b * u[0], A, Q


def measurement(a: Any, u: Any, t: Any, th: Any) -> Any:
    """Both meters."""
    return np.zeros(2), np.eye(3)[:2], np.diag([th.r_amps**2, th.r_rpm**2])


def initial(th: Any) -> Any:
    """At rest."""
    return Gaussian([], np.zeros((0, 0))), np.array([0, 0, 0.02]), np.diag([0.25, 3600.0, 1e-4])


def base(level: str) -> MixedModel:
    """As a drives engineer would write it."""
    amps, rpm = SENSORS[level]
    return model(
        name="motor",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        linear={"current": "A", "speed": "rpm", "load": "N m"},
        inputs={"voltage": "V"},
        outputs={"ammeter": "A", "tachometer": "rpm"},
        parameters=[
            Parameter("R", 1.1, "ohm", (0.01, 50.0)),
            Parameter("L", TRUE["L"], "H", (1e-4, 1.0)),
            Parameter("k", 0.053, "N m/A", (1e-3, 1.0)),
            Parameter("J", 5.2e-5, "kg m^2", (1e-6, 1e-2)),
            Parameter("b", 5e-5, "N m s", (0.0, 1e-2)),
            Parameter("q_speed", 12.0, "rpm/s^0.5", (0.01, 1e4)),
            Parameter("q_load", 0.9 * LOAD, "N m/s^0.5", (1e-6, 1.0)),
            Parameter("r_amps", 1.2 * amps, "A", (1e-5, 10.0)),
            Parameter("r_rpm", 0.85 * rpm, "rpm", (1e-3, 1e3)),
        ],
        reference={"current": 0.0, "speed": 0.0},
    )


SYSTEM = System(
    PLANT,
    base,
    {
        "drag": faults.force("drag:speed", 1, 3, lambda t, x, u, own: -x[1] * abs(x[1]), 1e-3),
        "coulomb": faults.force(
            "coulomb:speed", 1, 3, lambda t, x, u, own: -faults.sign(x[1], 1500.0), 1000.0
        ),
        "dead-zone": faults.input_dead_zone("input-deadzone:voltage", 0, 0.3),
        "gain": sensors.gain("gain:ammeter", 0, 0.0, 0.03),
        "clip": sensors.clip("saturation-sensor:ammeter", 0, 30.0, 4.0, 29.0),
        "delay": faults.input_delay("delay:voltage", 0, SUBSTEPS, 0.1),
        "outliers": sensors.outliers("heavy-tails:tachometer", 1, 0.03),
        "product": outside.product(0, 1, 1, 3, (0.0, 0.0), 1e-2),
    },
    known=("L",),
    units=Units(
        {"speed": 2 * np.pi / 60.0, "tachometer": 1.0 / 60.0, "current": 1e3, "ammeter": 1e3},
        time=1e3,
    ),
    noise=lambda level: {
        "q_speed": SPEED,
        "q_load": LOAD,
        "r_amps": SENSORS[level][0],
        "r_rpm": SENSORS[level][1],
    },
)
