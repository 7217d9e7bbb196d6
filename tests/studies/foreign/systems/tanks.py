"""Two tanks in cascade, levels in centimetres; a gauge in each.

    h1' = pump u - k1 sqrt(h1)      h2' = k1 sqrt(h1) - k2 sqrt(h2)

The user's model is one Runge-Kutta step per sample, with arrays and ``np.diag``.
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

DT = 4.0
TRUE = {"pump": 0.12, "k1": 0.15, "k2": 0.14}
FLOW = 0.02  # cm per root second
SENSORS = {"ordinary": (0.2, 0.2), "fine": (0.004, 0.004)}


def rhs(x: Numbers, u: Numbers, p: Mapping[str, float]) -> list[float]:
    """Torricelli's law."""
    upper = p["k1"] * math.sqrt(max(x[0], 0.0))
    return [p["pump"] * u[0] - upper, upper - p["k2"] * math.sqrt(max(x[1], 0.0))]


def inputs(T: int, dt: float, rng: np.random.Generator) -> Array:
    """Pump voltages that keep the tanks between a quarter and full."""
    hold = rng.integers(5, 25, size=T)
    return np.repeat(rng.uniform(3.0, 7.0, size=T), hold)[:T, None]


PLANT = Plant(
    name="tanks",
    dt=DT,
    states=("upper", "lower"),
    inputs_named=("pump",),
    outputs=("gauge1", "gauge2"),
    p=TRUE,
    rhs=rhs,
    see=lambda x, u, p: [x[0], x[1]],
    intensities=(FLOW, FLOW),
    sensors=SENSORS,
    start=lambda rng: [16.0 + rng.standard_normal(), 18.0 + rng.standard_normal()],
    inputs=inputs,
)


def flows(h: Any, u: Any, th: Any) -> Any:
    """dh/dt, (M, 2)."""
    root = np.sqrt(np.maximum(h, 0.0))
    upper = th.k1 * root[:, 0]
    return np.column_stack([th.pump * u[0] - upper, upper - th.k2 * root[:, 1]])


def noise(dt: Any, th: Any) -> Any:
    """Of both levels alike."""
    return np.diag([th.q**2, th.q**2]) * dt


def dynamics(a: Any, u: Any, t: Any, dt: Any, th: Any) -> Any:
    """Runge-Kutta."""
    k1 = flows(a, u, th)
    k2 = flows(a + 0.5 * dt * k1, u, th)
    k3 = flows(a + 0.5 * dt * k2, u, th)
    k4 = flows(a + dt * k3, u, th)
    return a + dt * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0, np.zeros((2, 0)), noise(dt, th)


def euler(a: Any, u: Any, t: Any, dt: Any, th: Any) -> Any:
    """Euler's rule."""
    return a + dt * flows(a, u, th), np.zeros((2, 0)), noise(dt, th)


def measurement(a: Any, u: Any, t: Any, th: Any) -> Any:
    """Both levels."""
    return a, np.zeros((2, 0)), np.diag([th.r**2, th.r**2])


def initial(th: Any) -> Any:
    """Somewhere below the rim."""
    return Gaussian([16.0, 18.0], 4.0 * np.eye(2)), np.zeros(0), np.zeros((0, 0))


def _base(level: str, name: str, step: Any, exact: bool) -> MixedModel:
    return model(
        continuous=exact,
        name=name,
        dynamics=step,
        measurement=measurement,
        initial=initial,
        nonlinear={"upper": "cm", "lower": "cm"},
        inputs={"pump": "V"},
        outputs={"gauge1": "cm", "gauge2": "cm"},
        parameters=[
            Parameter("pump", 0.13, "cm/s/V", (1e-3, 2.0)),
            Parameter("k1", 0.14, "cm^0.5/s", (1e-3, 2.0)),
            Parameter("k2", 0.15, "cm^0.5/s", (1e-3, 2.0)),
            Parameter("q", 0.8 * FLOW, "cm/s^0.5", (1e-6, 1.0)),
            Parameter("r", 1.2 * SENSORS[level][0], "cm", (1e-5, 5.0)),
        ],
        reference={"upper": 0.0, "lower": 0.0},
    )


def base(level: str) -> MixedModel:
    """Runge-Kutta."""
    return _base(level, "tanks", dynamics, exact=True)


def euler_base(level: str) -> MixedModel:
    """Euler."""
    return _base(level, "tanks-euler", euler, exact=False)


def noise_of(level: str) -> dict[str, float]:
    """The true parameters of the noise."""
    return {"q": FLOW, "r": SENSORS[level][0]}


FAULTS = {
    "leak": faults.step("step:lower", 1, 2, 0.02),
    "parameter-step": faults.parameter_step("k1", 0.02),
    "input-offset": faults.input_offset("input-offset:pump", 0, 0.2),
    "bias": sensors.bias("bias:gauge2", 1, 0.3),
    "clip": sensors.clip("saturation-sensor:gauge1", 0, 26.0, 2.0, 12.0),
    "outliers": sensors.outliers("heavy-tails:gauge1", 0, 0.03),
    "coloured": sensors.coloured("colored:gauge2", 1, 8.0, SENSORS["ordinary"][1], 0.5),
    "notch": outside.trickle(1, 2, 1.5, 18.0, 4.0, 0.02),
    "play": sensors.play("play:gauge2", 1, 0.3),
}
UNITS = Units(
    {"upper": 10.0, "lower": 1e-2, "gauge1": 10.0, "gauge2": 1e-2, "pump": 1e3},
    time=1.0 / 60.0,
)
SYSTEM = System(PLANT, base, FAULTS, (), UNITS, noise_of)
