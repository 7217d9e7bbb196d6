"""A stirred tank with a warm reaction, in kelvin and moles per litre; thermometer and analyser.

    c' = d (1 - c) - k(T) c      T' = d (T0 - T) + h k(T) c - a (T - Tc)      k(T) = exp(g - E / T)

The user's model is one Runge-Kutta step per sample on a list of states.
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

DT = 3.0
E, T0 = 8750.0, 350.0
TRUE = {"d": 0.016, "g": 20.4, "h": 45.0, "a": 0.03}
CONC, HEAT = 1e-3, 0.05  # mol/L and K per root second
SENSORS = {"ordinary": (0.3, 0.01), "fine": (6e-3, 2e-4)}


def rhs(x: Numbers, u: Numbers, p: Mapping[str, float]) -> list[float]:
    """Balances of matter and heat."""
    c, T = x
    rate = math.exp(p["g"] - E / T) * c
    return [
        p["d"] * (1.0 - c) - rate,
        p["d"] * (T0 - T) + p["h"] * rate - p["a"] * (T - u[0]),
    ]


def inputs(T: int, dt: float, rng: np.random.Generator) -> Array:
    """Coolant temperatures."""
    hold = rng.integers(5, 25, size=T)
    return np.repeat(rng.uniform(335.0, 365.0, size=T), hold)[:T, None]


PLANT = Plant(
    name="reactor",
    dt=DT,
    states=("concentration", "temperature"),
    inputs_named=("coolant",),
    outputs=("thermometer", "analyser"),
    p=TRUE,
    rhs=rhs,
    see=lambda x, u, p: [x[1], x[0]],
    intensities=(CONC, HEAT),
    sensors=SENSORS,
    start=lambda rng: [0.5 + 0.03 * rng.standard_normal(), 355.0 + 2.0 * rng.standard_normal()],
    inputs=inputs,
)


def dynamics(a: Any, u: Any, t: Any, dt: Any, th: Any) -> Any:
    """Runge-Kutta, with a helper for sums of lists."""

    def slope(c: Any, T: Any) -> list[Any]:
        rate = np.exp(th.g - E / T) * c
        return [th.d * (1 - c) - rate, th.d * (T0 - T) + th.h * rate - th.a * (T - u[0])]

    def plus(x: list[Any], h: Any, k: list[Any]) -> list[Any]:
        return [xi + h * ki for xi, ki in zip(x, k, strict=True)]

    x = [a[:, 0], a[:, 1]]
    k1 = slope(*x)
    k2 = slope(*plus(x, dt / 2, k1))
    k3 = slope(*plus(x, dt / 2, k2))
    k4 = slope(*plus(x, dt, k3))
    total = [(p + 2 * q + 2 * r + s) / 6 for p, q, r, s in zip(k1, k2, k3, k4, strict=True)]
    return plus(x, dt, total), np.zeros((2, 0)), [[th.q_c**2 * dt, 0], [0, th.q_T**2 * dt]]


def measurement(a: Any, u: Any, t: Any, th: Any) -> Any:
    """Thermometer and analyser."""
    return [a[:, 1], a[:, 0]], np.zeros((2, 0)), [[th.r_T**2, 0], [0, th.r_c**2]]


def initial(th: Any) -> Any:
    """Running."""
    return Gaussian([0.5, 355.0], np.diag([0.003, 9.0])), np.zeros(0), np.zeros((0, 0))


def base(level: str) -> MixedModel:
    """As a chemical engineer would write it."""
    kelvin, moles = SENSORS[level]
    return model(
        name="reactor",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        nonlinear={"concentration": "mol/L", "temperature": "K"},
        inputs={"coolant": "K"},
        outputs={"thermometer": "K", "analyser": "mol/L"},
        parameters=[
            Parameter("d", 0.0168, "1/s", (1e-4, 1.0)),
            Parameter("g", 20.48, "1", (10.0, 30.0), "log of the rate's factor, in 1/s"),
            Parameter("h", 48.0, "K L/mol", (1.0, 1e3)),
            Parameter("a", 0.028, "1/s", (1e-4, 1.0)),
            Parameter("q_c", 1.1 * CONC, "mol/L/s^0.5", (1e-7, 1.0)),
            Parameter("q_T", 0.9 * HEAT, "K/s^0.5", (1e-5, 10.0)),
            Parameter("r_T", 1.1 * kelvin, "K", (1e-4, 50.0)),
            Parameter("r_c", 0.9 * moles, "mol/L", (1e-6, 1.0)),
        ],
        reference={"concentration": 0.0},
    )


SYSTEM = System(
    PLANT,
    base,
    {
        "catalyst": faults.parameter_drift("g", 1200.0, 0.03, 1.0),
        "coolant": faults.input_offset("input-offset:coolant", 0, 1.0),
        "lag": sensors.lag("lag:thermometer", 0, DT, 1.0),
        "analyser": sensors.gain("gain:analyser", 1, 0.0, 0.02),
        "step": faults.step("step:temperature", 1, 2, 0.05),
        "hum": sensors.harmonic("harmonic:thermometer", 0, 0.1),
        "outliers": sensors.outliers("heavy-tails:analyser", 1, 0.03),
        "product": outside.product(0, 1, 0, 2, (0.5, 355.0), 1e-3),
    },
    known=(),
    units=Units(
        {
            "temperature": 1.8,
            "coolant": 1.8,
            "thermometer": 1.0,
            "concentration": 1e3,
            "analyser": 1e3,
        },
        {"temperature": -459.67, "coolant": -459.67, "thermometer": -273.15},
        1.0 / 60.0,
    ),
    noise=lambda level: {
        "q_c": CONC,
        "q_T": HEAT,
        "r_T": SENSORS[level][0],
        "r_c": SENSORS[level][1],
    },
)
