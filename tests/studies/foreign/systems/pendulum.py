"""A driven pendulum, in degrees; an encoder reads the angle.

    angle' = rate      rate' = -w^2 (180 / pi) sin(pi / 180 angle) - c rate + k torque

The user's model is one Runge-Kutta step per sample, written with a helper function and plain conditions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from engine.statespace.model import Gaussian, MixedModel, Parameter
from tests.studies.foreign import faults, outside, sensors
from tests.studies.foreign.plant import Array, Numbers, Plant
from tests.studies.foreign.written import System, Units, model

DT = 0.05
TRUE = {"w2": 20.0, "c": 0.5, "k": 400.0}
KICK = 12.0  # deg/s per root second
SENSORS = {"ordinary": (1.0,), "fine": (0.03,)}
RADIAN = 180.0 / math.pi


def rhs(x: Numbers, u: Numbers, p: Mapping[str, float]) -> list[float]:
    """Newton's law."""
    angle, rate = x
    return [rate, -p["w2"] * RADIAN * math.sin(angle / RADIAN) - p["c"] * rate + p["k"] * u[0]]


def inputs(T: int, dt: float, rng: np.random.Generator) -> Array:
    """Steps of torque of random length."""
    hold = rng.integers(4, 25, size=T)
    return np.repeat(rng.uniform(-1.0, 1.0, size=T), hold)[:T, None]


PLANT = Plant(
    name="pendulum",
    dt=DT,
    states=("angle", "rate"),
    inputs_named=("torque",),
    outputs=("encoder",),
    p=TRUE,
    rhs=rhs,
    see=lambda x, u, p: [x[0]],
    intensities=(0.0, KICK),
    sensors=SENSORS,
    start=lambda rng: [10.0 * rng.standard_normal(), 20.0 * rng.standard_normal()],
    inputs=inputs,
)


def rk4(f: Callable[[Any], Any], x: Any, h: Any) -> Any:
    """The usual one."""
    k1 = f(x)
    k2 = f(x + h / 2 * k1)
    k3 = f(x + h / 2 * k2)
    k4 = f(x + h * k3)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def motion(torque: Any, th: Any) -> Callable[[Any], Any]:
    """dx/dt for rows x."""

    def f(x: Any) -> Any:
        pull = th.w2 * RADIAN * np.sin(x[:, 0] / RADIAN)
        if th.c > 0:  # an ideal bearing has none
            pull = pull + th.c * x[:, 1]
        return np.stack([x[:, 1], th.k * torque - pull], axis=1)

    return f


def dynamics(a: Any, u: Any, t: Any, dt: Any, th: Any) -> Any:
    """One Runge-Kutta step; the white force's integral over the step is exact to its order."""
    q = th.q**2
    Q = q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    return rk4(motion(u[0], th), a, dt), np.zeros((2, 0)), Q


def euler(a: Any, u: Any, t: Any, dt: Any, th: Any) -> Any:
    """The same by Euler's rule, velocity first."""
    rate = a[:, 1] + dt * motion(u[0], th)(a)[:, 1]
    angle = a[:, 0] + dt * rate
    return [angle, rate], np.zeros((2, 0)), np.diag([1e-8, th.q**2 * dt])


def measurement(a: Any, u: Any, t: Any, th: Any) -> Any:
    """The angle."""
    return a[:, :1], np.zeros((1, 0)), np.array([[th.r]]) ** 2


def initial(th: Any) -> Any:
    """Hanging, more or less."""
    return Gaussian([0.0, 0.0], np.diag([400.0, 1600.0])), np.zeros(0), np.zeros((0, 0))


def _base(level: str, name: str, step: Any, exact: bool) -> MixedModel:
    return model(
        continuous=exact,
        name=name,
        dynamics=step,
        measurement=measurement,
        initial=initial,
        nonlinear={"angle": "deg", "rate": "deg/s"},
        inputs={"torque": "N m"},
        outputs={"encoder": "deg"},
        parameters=[
            Parameter("w2", 22.0, "1/s^2", (1.0, 200.0)),
            Parameter("c", 0.42, "1/s", (0.0, 20.0)),
            Parameter("k", 380.0, "deg/s^2/(N m)", (1.0, 1e4)),
            Parameter("q", 10.0, "deg/s^1.5", (0.01, 1e3)),
            Parameter("r", 1.15 * SENSORS[level][0], "deg", (1e-4, 50.0)),
        ],
        kinematic=("angle",),
        reference={"angle": 0.0, "rate": 0.0},
    )


def base(level: str) -> MixedModel:
    """Runge-Kutta."""
    return _base(level, "pendulum", dynamics, exact=True)


def euler_base(level: str) -> MixedModel:
    """Euler."""
    return _base(level, "pendulum-euler", euler, exact=False)


def noise_of(level: str) -> dict[str, float]:
    """The true parameters of the noise."""
    return {"q": KICK, "r": SENSORS[level][0]}


FAULTS = {
    "drag": faults.force("drag:rate", 1, 2, lambda t, x, u, own: -x[1] * abs(x[1]), 2e-3),
    "coulomb": faults.force(
        "coulomb:rate", 1, 2, lambda t, x, u, own: -faults.sign(x[1], 100.0), 20.0
    ),
    "cubic": faults.force("cubic:angle->rate", 1, 2, lambda t, x, u, own: x[0] ** 3, 1e-4),
    "bias": sensors.bias("bias:encoder", 0, 1.0),
    "dead-zone": faults.input_dead_zone("input-deadzone:torque", 0, 0.05),
    "hum": sensors.harmonic("harmonic:encoder", 0, 0.5),
    "root": outside.root_friction(1, 2, 100.0, 20.0),
    "chirp": outside.chirp(1, 2, 500, DT, 20.0),
}
UNITS = Units(
    {"angle": 1.0 / RADIAN, "rate": 1.0 / RADIAN, "encoder": 1e3 / RADIAN, "torque": 100.0}
)
SYSTEM = System(PLANT, base, FAULTS, (), UNITS, noise_of)
