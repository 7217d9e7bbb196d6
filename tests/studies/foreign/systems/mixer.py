"""Two stirred tanks in a row, salt in grams per litre; a probe in the second and a poor one in the first.

    V1 c1' = F (c0 - c1)      V2 c2' = F (c1 - c2) - k V2 c2      flow F and feed c0 are recorded

The user's model is exact for held inputs: linear in (c1, c2), its matrices functions of the flow.
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
TRUE = {"V1": 200.0, "V2": 320.0, "k": 1e-3}
SALT = 0.02  # g/L per root second, of either tank
SENSORS = {"ordinary": (0.6, 0.3), "fine": (0.02, 6e-3)}


def rhs(x: Numbers, u: Numbers, p: Mapping[str, float]) -> list[float]:
    """Salt balances."""
    flow, feed = u
    return [
        flow / p["V1"] * (feed - x[0]),
        flow / p["V2"] * (x[0] - x[1]) - p["k"] * x[1],
    ]


def inputs(T: int, dt: float, rng: np.random.Generator) -> Array:
    """Flows of one to three litres a second, feeds of 25 to 45 g/L."""
    holds = [rng.integers(4, 20, size=T), rng.integers(6, 30, size=T)]
    flow = np.repeat(rng.uniform(1.0, 3.0, size=T), holds[0])[:T]
    feed = np.repeat(rng.uniform(25.0, 45.0, size=T), holds[1])[:T]
    return np.column_stack([flow, feed])


PLANT = Plant(
    name="mixer",
    dt=DT,
    states=("first", "second"),
    inputs_named=("flow", "feed"),
    outputs=("probe1", "probe2"),
    p=TRUE,
    rhs=rhs,
    see=lambda x, u, p: [x[0], x[1]],
    intensities=(SALT, SALT),
    sensors=SENSORS,
    start=lambda rng: [35.0 + rng.standard_normal(), 30.0 + rng.standard_normal()],
    inputs=inputs,
)


def dynamics(a: Any, u: Any, t: Any, dt: Any, th: Any) -> Any:
    """Triangular, so its exponential is written out."""
    fast = u[0] / th.V1
    slow = u[0] / th.V2 + th.k
    e1, e2 = math.exp(-fast * dt), math.exp(-slow * dt)
    across = u[0] / th.V2 * dt * e1
    if abs(fast - slow) > 1e-9:
        across = u[0] / th.V2 * (e2 - e1) / (fast - slow)
    A = np.array([[e1, 0.0], [across, e2]])
    # the steady state for these inputs is where the step leads
    rest = np.array([u[1], u[0] / th.V2 / slow * u[1]])
    q = th.q**2 * dt
    Q = np.array([[q * e1, 0.5 * q * across], [0.5 * q * across, q * e2]])
    return rest - A @ rest, A, Q


def measurement(a: Any, u: Any, t: Any, th: Any) -> Any:
    """Two probes."""
    R = np.zeros((2, 2))
    R[0, 0] = th.r1**2
    R[1, 1] = th.r2**2
    return [0.0, 0.0], np.eye(2), R


def initial(th: Any) -> Any:
    """Filled with what is usual."""
    return Gaussian([], np.zeros((0, 0))), [35.0, 30.0], np.eye(2)


def base(level: str) -> MixedModel:
    """As a process engineer would write it."""
    first, second = SENSORS[level]
    return model(
        name="mixer",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        linear={"first": "g/L", "second": "g/L"},
        inputs={"flow": "L/s", "feed": "g/L"},
        outputs={"probe1": "g/L", "probe2": "g/L"},
        parameters=[
            Parameter("V1", 185.0, "L", (10.0, 1e4)),
            Parameter("V2", 350.0, "L", (10.0, 1e4)),
            Parameter("k", 1.15e-3, "1/s", (1e-6, 0.1)),
            Parameter("q", 0.85 * SALT, "g/L/s^0.5", (1e-5, 1.0)),
            Parameter("r1", 1.1 * first, "g/L", (1e-4, 10.0)),
            Parameter("r2", 0.9 * second, "g/L", (1e-4, 10.0)),
        ],
        reference={"first": 0.0, "second": 0.0},
    )


SYSTEM = System(
    PLANT,
    base,
    {
        "bias": sensors.bias("bias:probe2", 1, 0.3),
        "lag": sensors.lag("lag:probe2", 1, DT, 3.0),
        "drift": sensors.drift("drift:probe1", 0, 2e-4),
        "feed": faults.input_offset("input-offset:feed", 1, 0.5),
        "leak": faults.step("step:second", 1, 2, 0.01),
        "delay": faults.input_delay("delay:feed", 1, 10, 0.3),
        "clip": sensors.clip("saturation-sensor:probe1", 0, 46.0, 5.0, 16.0),
        "enzyme": outside.saturating(1, 2, 5.0, 0.02),
    },
    known=(),
    units=Units(
        {"first": 1e3, "second": 1e-3, "probe1": 1e3, "probe2": 1e-3, "feed": 1e3, "flow": 3.6},
        time=1.0 / 60.0,
    ),
    noise=lambda level: {"q": SALT, "r1": SENSORS[level][0], "r2": SENSORS[level][1]},
)
