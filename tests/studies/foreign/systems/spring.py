"""A mass on an air spring that rests at 50 millimetres; a laser reads the position.

    x' = v      v' = -w^2 (x - 50) - c v + k u

The user's model is exact: the damped oscillator's step in closed form.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from engine.statespace.model import Gaussian, MixedModel, Parameter
from tests.studies.foreign import faults, sensors
from tests.studies.foreign.plant import Array, Numbers, Plant
from tests.studies.foreign.written import System, Units, model

DT = 0.01
REST = 50.0  # mm
TRUE = {"w2": 900.0, "c": 8.0, "k": 60.0}
KICK = 60.0  # mm/s per root second
SENSORS = {"ordinary": (0.4,), "fine": (8e-3,)}


def rhs(x: Numbers, u: Numbers, p: Mapping[str, float]) -> list[float]:
    """Newton's law."""
    return [x[1], -p["w2"] * (x[0] - REST) - p["c"] * x[1] + p["k"] * u[0]]


def inputs(T: int, dt: float, rng: np.random.Generator) -> Array:
    """Forces in newtons, held for a while."""
    hold = rng.integers(5, 30, size=T)
    return np.repeat(rng.uniform(-120.0, 120.0, size=T), hold)[:T, None]


PLANT = Plant(
    name="spring",
    dt=DT,
    states=("position", "velocity"),
    inputs_named=("force",),
    outputs=("laser",),
    p=TRUE,
    rhs=rhs,
    see=lambda x, u, p: [x[0]],
    intensities=(0.0, KICK),
    sensors=SENSORS,
    start=lambda rng: [REST + rng.standard_normal(), 20.0 * rng.standard_normal()],
    inputs=inputs,
)


def dynamics(a: Any, u: Any, t: Any, dt: Any, th: Any) -> Any:
    """Rotation and decay, written out."""
    w2, c, k, q, _ = th
    w = np.sqrt(w2 - c * c / 4)

    def step(h: Any) -> tuple[Any, Any, Any, Any]:
        e = np.exp(-c * h / 2)
        s, co = e * np.sin(w * h) / w, e * np.cos(w * h)
        return co + c / 2 * s, s, -w2 * s, co - c / 2 * s

    a11, a12, a21, a22 = step(dt)
    pushed = k * u[0] / w2  # where the force would hold the mass
    f = [(1 - a11) * (REST + pushed), -a21 * (REST + pushed)]
    b12, b22 = step(dt / 2)[1::2]
    q2 = q * q * dt / 6
    Q = [
        [q2 * (4 * b12 * b12 + a12 * a12), q2 * (4 * b12 * b22 + a12 * a22)],
        [q2 * (4 * b12 * b22 + a12 * a22), q2 * (1 + 4 * b22 * b22 + a22 * a22)],
    ]
    return f, [[a11, a12], [a21, a22]], Q


def measurement(a: Any, u: Any, t: Any, th: Any) -> Any:
    """The laser."""
    return [0.0], [[1.0, 0.0]], [[th.r**2]]


def initial(th: Any) -> Any:
    """At rest."""
    return Gaussian([], np.zeros((0, 0))), [REST, 0.0], [[1.0, 0.0], [0.0, 400.0]]


def base(level: str) -> MixedModel:
    """As a mechanical engineer would write it."""
    return model(
        name="spring",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        linear={"position": "mm", "velocity": "mm/s"},
        inputs={"force": "N"},
        outputs={"laser": "mm"},
        parameters=[
            Parameter("w2", 990.0, "1/s^2", (10.0, 1e5)),
            Parameter("c", 7.0, "1/s", (0.01, 60.0)),
            Parameter("k", 66.0, "mm/s^2/N", (0.1, 1e4)),
            Parameter("q", 0.9 * KICK, "mm/s^1.5", (1e-3, 1e5)),
            Parameter("r", 1.15 * SENSORS[level][0], "mm", (1e-5, 50.0)),
        ],
        kinematic=("position",),
        reference={"position": REST, "velocity": 0.0, "laser": 0.0},
    )


SYSTEM = System(
    PLANT,
    base,
    {
        "cubic": faults.force(
            "cubic:position->velocity", 1, 2, lambda t, x, u, own: (x[0] - REST) ** 3, -2.0
        ),
        "drag": faults.force("drag:velocity", 1, 2, lambda t, x, u, own: -x[1] * abs(x[1]), 0.02),
        "coulomb": faults.force(
            "coulomb:velocity", 1, 2, lambda t, x, u, own: -faults.sign(x[1], 150.0), 300.0
        ),
        "hysteresis": faults.hysteresis("hysteresis:velocity", 1, 1, 2, 5.0, -100.0),
        "pole": faults.pole("pole:velocity", 1, 1, 2, 0.08, -10.0),
        "clip": sensors.clip("saturation-sensor:laser", 0, 62.0, 4.0, 11.0),
        "play": sensors.play("play:laser", 0, 0.5),
    },
    known=(),
    units=Units(
        {"position": 1e-3, "velocity": 1e-3, "laser": 1e3, "force": 1e-3},
        {"position": -REST * 1e-3, "laser": -REST * 1e3},
        1e3,
    ),
    noise=lambda level: {"q": KICK, "r": SENSORS[level][0]},
)
