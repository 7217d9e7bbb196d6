"""Four small systems with what may be done to them: plain NumPy, one explicit step a sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from engine.statespace.model import Array, Gaussian, MixedModel, Parameter


@dataclass(frozen=True)
class System:
    """A model, its sample time in seconds, and the bounds of its inputs and states."""

    model: MixedModel
    dt: float
    inputs: Mapping[str, Any]
    states: Mapping[str, tuple[float | None, float | None]]


def _no_z(n: int) -> Array:
    return np.zeros((n, 0))


def _start(mean: list[float], sd: list[float]) -> Any:
    return Gaussian(mean, np.diag(sd) ** 2), [], np.zeros((0, 0))


def _drive() -> MixedModel:
    def dynamics(a: Array, u: Any, t: Any, dt: Any, th: Any) -> Any:
        v = a[:, 0]
        return [v + dt * (th.k * u[0] - th.b * v)], _no_z(1), [[dt * th.q**2]]

    return MixedModel(
        name="drive",
        dynamics=dynamics,
        measurement=lambda a, u, t, th: ([a[:, 0]], _no_z(1), [[th.r**2]]),
        initial=lambda th: _start([0.0], [0.05]),
        nonlinear={"velocity": "m/s"},
        inputs={"voltage": "V"},
        outputs={"tacho": "m/s"},
        reference={"velocity": 0.0, "voltage": 0.0},
        parameters=[
            Parameter("k", 0.5, "m/s^2/V", (0.01, 10.0)),
            Parameter("b", 1.0, "1/s", (0.0, 50.0)),
            Parameter("q", 0.02, "m/s^1.5", (1e-4, 1.0)),
            Parameter("r", 0.02, "m/s", (1e-3, 1.0)),
        ],
    )


def _spring() -> MixedModel:
    def dynamics(a: Array, u: Any, t: Any, dt: Any, th: Any) -> Any:
        x, v = a[:, 0], a[:, 1]
        force = th.g * u[0] - th.k * x - th.c * v
        v = v + dt * force
        return [x + dt * v, v], _no_z(2), [[1e-12, 0.0], [0.0, dt * th.q**2]]

    return MixedModel(
        name="spring",
        dynamics=dynamics,
        measurement=lambda a, u, t, th: ([a[:, 0]], _no_z(1), [[th.r**2]]),
        initial=lambda th: _start([0.0, 0.0], [0.02, 0.05]),
        nonlinear={"position": "m", "velocity": "m/s"},
        kinematic=("position",),
        inputs={"force": "N"},
        outputs={"reading": "m"},
        reference={"position": 0.0, "force": 0.0},
        parameters=[
            Parameter("k", 4.0, "1/s^2", (0.1, 100.0)),
            Parameter("c", 0.5, "1/s", (0.0, 20.0)),
            Parameter("g", 1.0, "m/s^2/N", (0.01, 100.0)),
            Parameter("q", 0.02, "m/s^1.5", (1e-4, 1.0)),
            Parameter("r", 0.02, "m", (1e-3, 1.0)),
        ],
    )


def _tank() -> MixedModel:
    def dynamics(a: Array, u: Any, t: Any, dt: Any, th: Any) -> Any:
        h = a[:, 0]
        flow = th.c * np.sqrt(np.maximum(h, 0.0))
        return [h + dt * (th.k * u[0] - flow)], _no_z(1), [[dt * th.q**2]]

    return MixedModel(
        name="tank",
        dynamics=dynamics,
        measurement=lambda a, u, t, th: ([a[:, 0]], _no_z(1), [[th.r**2]]),
        initial=lambda th: _start([4.0], [0.5]),
        nonlinear={"level": "m"},
        inputs={"pump": "V"},
        outputs={"gauge": "m"},
        reference={"level": 0.0, "pump": 0.0},
        parameters=[
            Parameter("k", 0.05, "m/s/V", (1e-3, 1.0)),
            Parameter("c", 0.1, "m^0.5/s", (1e-3, 2.0)),
            Parameter("q", 0.01, "m/s^0.5", (1e-4, 1.0)),
            Parameter("r", 0.05, "m", (1e-3, 1.0)),
        ],
    )


def _oven() -> MixedModel:
    def dynamics(a: Array, u: Any, t: Any, dt: Any, th: Any) -> Any:
        air = a[:, 0]
        f = [air + dt * (th.h * u[0] - (th.l + th.w) * air), dt * th.s * air]
        A = [[dt * th.w], [1.0 - dt * th.s]]
        return f, A, np.diag([1.0, 0.01]) * dt * th.q**2

    return MixedModel(
        name="oven",
        dynamics=dynamics,
        measurement=lambda a, u, t, th: ([a[:, 0]], [[0.0]], [[th.r**2]]),
        initial=lambda th: (Gaussian([0.0], [[1.0]]), [0.0], [[1.0]]),
        nonlinear={"air": "K"},
        linear={"wall": "K"},
        inputs={"heater": "kW"},
        outputs={"thermometer": "K"},
        reference={"air": 0.0, "wall": 0.0, "heater": 0.0},
        parameters=[
            Parameter("h", 0.5, "K/s/kW", (0.01, 20.0)),
            Parameter("l", 0.02, "1/s", (0.0, 1.0)),
            Parameter("w", 0.05, "1/s", (0.0, 1.0)),
            Parameter("s", 0.02, "1/s", (1e-3, 1.0)),
            Parameter("q", 0.05, "K/s^0.5", (1e-3, 5.0)),
            Parameter("r", 0.2, "K", (1e-2, 5.0)),
        ],
    )


SYSTEMS = {
    "drive": System(_drive(), 0.1, {"voltage": [-6.0, 6.0]}, {}),
    "spring": System(_spring(), 0.1, {"force": [-3.0, 3.0]}, {"position": (-1.5, 1.5)}),
    "tank": System(_tank(), 4.0, {"pump": [0.0, 8.0]}, {"level": (0.5, 12.0)}),
    "oven": System(
        _oven(), 2.0, {"heater": {"low": 0.0, "high": 10.0, "rate": 2.0}}, {"air": (None, 120.0)}
    ),
}
