"""A lithium cell: state of charge in per cent, terminal voltage in millivolts.

    soc' = 100 I / (3600 C)      v' = (R1 I - v) / tau      V = ocv(soc) + v + R0 I

The user's model is exact for a held current, with ``math`` functions of the parameters; the voltmeter's
noise is known from its data sheet.
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

DT = 10.0
TRUE = {"C": 2.5, "R0": 20.0, "R1": 15.0, "tau": 60.0}  # A h, mOhm, mOhm, s
OCV = (0.0006, -0.12, 12.0, 3300.0)  # mV over per cent
CHARGE, SLOW = 2e-3, 0.15  # per cent and mV per root second
SENSORS = {"ordinary": (4.0,), "fine": (0.1,)}


def rhs(x: Numbers, u: Numbers, p: Mapping[str, float]) -> list[float]:
    """Charge and one RC pair."""
    return [u[0] / (36.0 * p["C"]), (p["R1"] * u[0] - x[1]) / p["tau"]]


def see(x: Numbers, u: Numbers, p: Mapping[str, float]) -> list[float]:
    """The terminal voltage."""
    s, v = x
    return [((OCV[0] * s + OCV[1]) * s + OCV[2]) * s + OCV[3] + v + p["R0"] * u[0]]


def inputs(T: int, dt: float, rng: np.random.Generator) -> Array:
    """Charging and discharging pulses."""
    hold = rng.integers(2, 15, size=T)
    return np.repeat(rng.uniform(-6.0, 6.5, size=T), hold)[:T, None]


PLANT = Plant(
    name="battery",
    dt=DT,
    states=("soc", "polarisation"),
    inputs_named=("amperes",),
    outputs=("terminal",),
    p=TRUE,
    rhs=rhs,
    see=see,
    intensities=(CHARGE, SLOW),
    sensors=SENSORS,
    start=lambda rng: [45.0 + rng.standard_normal(), 2.0 * rng.standard_normal()],
    inputs=inputs,
)


def dynamics(a: Any, u: Any, t: Any, dt: Any, theta: Any) -> Any:
    """Exact; the charge is nonlinear in the voltage, the polarisation linear."""
    keep = math.exp(-dt / theta.tau)
    f = [a[:, 0] + u[0] * dt / (36.0 * theta.C), theta.R1 * (1.0 - keep) * u[0]]
    A = [[0.0], [keep]]
    Q = np.diag([CHARGE**2 * dt, 0.5 * theta.q**2 * theta.tau * (1.0 - keep**2)])
    return f, A, Q


def measurement(a: Any, u: Any, t: Any, theta: Any) -> Any:
    """Voltmeter."""
    return [np.polyval(OCV, a[:, 0]) + theta.R0 * u[0]], [[1.0]], [[theta.r * theta.r]]


def initial(theta: Any) -> Any:
    """Rested, some 45 per cent charged."""
    return Gaussian(45.0, 4.0), [0.0], [[4.0]]


def base(level: str) -> MixedModel:
    """As a battery engineer would write it."""
    return model(
        name="battery",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        nonlinear={"soc": "%"},
        linear={"polarisation": "mV"},
        inputs={"amperes": "A"},
        outputs={"terminal": "mV"},
        parameters=[
            Parameter("C", TRUE["C"], "A h", (0.1, 50.0)),
            Parameter("R0", 18.0, "mOhm", (0.1, 500.0)),
            Parameter("R1", 17.0, "mOhm", (0.1, 500.0)),
            Parameter("tau", 70.0, "s", (2.0, 3000.0)),
            Parameter("q", 1.1 * SLOW, "mV/s^0.5", (1e-4, 50.0)),
            Parameter("r", SENSORS[level][0], "mV", (1e-4, 100.0)),
        ],
        reference={"soc": 0.0, "polarisation": 0.0},
    )


SYSTEM = System(
    PLANT,
    base,
    {
        "rounding": sensors.rounded("quantisation:terminal", 0, 10.0),
        "input-offset": faults.input_offset("input-offset:amperes", 0, 0.1),
        "ageing": faults.parameter_step("R0", 0.1, 5.0),
        "outliers": sensors.outliers("heavy-tails:terminal", 0, 0.03),
        "jump": sensors.step("step:terminal", 0, 5.0),
        "hum": sensors.harmonic("harmonic:terminal", 0, 3.0),
        "saturating": outside.saturating(1, 2, 40.0, 0.5),
    },
    known=("C", "r"),
    units=Units(
        {"soc": 0.01, "polarisation": 1e-3, "terminal": 1e-3, "amperes": 1e3}, time=1.0 / 3600.0
    ),
    noise=lambda level: {"q": SLOW, "r": SENSORS[level][0]},
)
