"""A heated room and its wall, in degrees Celsius; the thermometer hangs in the air.

    Ca T' = (W - T) / R1 + (Tout - T) / R2 + P      Cw W' = (T - W) / R1 + (Tout - W) / R3

The user's model is the exact discretisation by SciPy's matrix exponential, one parameter vector at a time.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.linalg import expm

from engine.statespace.model import Gaussian, MixedModel, Parameter
from tests.studies.foreign import faults, outside, sensors
from tests.studies.foreign.plant import SUBSTEPS, Array, Numbers, Plant
from tests.studies.foreign.written import System, Units, model

DT = 300.0
TRUE = {"Ca": 4e5, "Cw": 6e6, "R1": 4e-3, "R2": 2e-2, "R3": 3e-2}
AIR, WALL = 2e-3, 3e-4  # K per root second
SENSORS = {"ordinary": (0.08,), "fine": (2e-3,)}


def rhs(x: Numbers, u: Numbers, p: Mapping[str, float]) -> list[float]:
    """Two heat balances."""
    T, W = x
    heater, outdoor = u
    return [
        ((W - T) / p["R1"] + (outdoor - T) / p["R2"] + heater) / p["Ca"],
        ((T - W) / p["R1"] + (outdoor - W) / p["R3"]) / p["Cw"],
    ]


def inputs(T: int, dt: float, rng: np.random.Generator) -> Array:
    """A heater with three powers; a day's course outdoors, with weather."""
    hold = rng.integers(6, 30, size=T)
    heater = np.repeat(rng.choice([0.0, 700.0, 1500.0], size=T), hold)[:T]
    t = dt * np.arange(T)
    weather = np.cumsum(0.05 * rng.standard_normal(T))
    return np.column_stack([heater, 6.0 - 4.0 * np.cos(2.0 * np.pi * t / 86400.0) + weather])


PLANT = Plant(
    name="room",
    dt=DT,
    states=("air", "wall"),
    inputs_named=("heater", "outdoor"),
    outputs=("thermometer",),
    p=TRUE,
    rhs=rhs,
    see=lambda x, u, p: [x[0]],
    intensities=(AIR, WALL),
    sensors=SENSORS,
    start=lambda rng: [19.0 + 0.5 * rng.standard_normal(), 17.5 + 0.5 * rng.standard_normal()],
    inputs=inputs,
)


@lru_cache(maxsize=4096)
def discrete(Ca: float, Cw: float, R1: float, R2: float, R3: float, q: float, dt: float) -> Any:
    """A, B and Q over a step (van Loan 1978)."""
    F = np.array(
        [
            [-(1 / R1 + 1 / R2) / Ca, 1 / R1 / Ca],
            [1 / R1 / Cw, -(1 / R1 + 1 / R3) / Cw],
        ]
    )
    G = np.array([[1 / Ca, 1 / R2 / Ca], [0.0, 1 / R3 / Cw]])
    whole = expm(np.block([[F, G], [np.zeros((2, 4))]]) * dt)
    noise = np.diag([q**2, WALL**2])
    loan = expm(np.block([[-F, noise], [np.zeros((2, 2)), F.T]]) * dt)
    A = whole[:2, :2]
    Q = A @ loan[:2, 2:]
    return A, whole[:2, 2:], 0.5 * (Q + Q.T)


def dynamics(a: Any, u: Any, t: Any, dt: Any, th: Any) -> Any:
    """Exact for inputs that are held."""
    A, B, Q = discrete(th.Ca, th.Cw, th.R1, th.R2, th.R3, th.q, dt)
    return B @ u, A, Q


def measurement(a: Any, u: Any, t: Any, th: Any) -> Any:
    """The air's temperature."""
    return [0.0], [[1.0, 0.0]], [[th.r**2]]


def initial(th: Any) -> Any:
    """Some 19 degrees indoors."""
    return Gaussian([], np.zeros((0, 0))), [19.0, 17.5], np.diag([1.0, 1.0])


def base(level: str) -> MixedModel:
    """As a heating engineer would write it."""
    return model(
        name="room",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        linear={"air": "degC", "wall": "degC"},
        inputs={"heater": "W", "outdoor": "degC"},
        outputs={"thermometer": "degC"},
        parameters=[
            Parameter("Ca", 4.6e5, "J/K", (1e4, 1e7)),
            Parameter("Cw", TRUE["Cw"], "J/K", (1e5, 1e8)),
            Parameter("R1", 3.6e-3, "K/W", (1e-4, 1.0)),
            Parameter("R2", 2.3e-2, "K/W", (1e-4, 1.0)),
            Parameter("R3", TRUE["R3"], "K/W", (1e-4, 1.0)),
            Parameter("q", 1.2 * AIR, "K/s^0.5", (1e-6, 1.0)),
            Parameter("r", 0.9 * SENSORS[level][0], "K", (1e-5, 5.0)),
        ],
    )


SYSTEM = System(
    PLANT,
    base,
    {
        "step": faults.step("step:air", 0, 2, 5e-5),
        "input-offset": faults.input_offset("input-offset:heater", 0, 50.0),
        "delay": faults.input_delay("delay:heater", 0, SUBSTEPS, 0.2),
        "lag": sensors.lag("lag:thermometer", 0, DT, 60.0),
        "outliers": sensors.outliers("heavy-tails:thermometer", 0, 0.03),
        "sun": faults.harmonic("harmonic:air", 0, 2, 5e-5),
        "telegraph": outside.telegraph(0, 2, 5e-5),
    },
    known=("Cw", "R3"),
    units=Units(
        {"air": 1.8, "wall": 1.8, "outdoor": 1.8, "thermometer": 1.8, "heater": 1e-3},
        {"air": 32.0, "wall": 32.0, "outdoor": 32.0, "thermometer": 32.0},
        1.0 / 60.0,
    ),
    noise=lambda level: {"q": AIR, "r": SENSORS[level][0]},
)
