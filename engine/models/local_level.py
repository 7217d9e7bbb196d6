"""``local-level``: a random walk observed with noise (Harvey 1989), for the Nile flows."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.statespace.model import Array, Gaussian, MixedModel, Parameter

A = np.eye(1)
C = np.eye(1)


def dynamics(a: Array, u: Array, t: float, dt: float, theta: Any) -> tuple[Any, Any, Any]:
    """Z' = z + w, w ~ N(0, q)."""
    return [0.0], A, [[theta.q]]


def measurement(a: Array, u: Array, t: float, theta: Any) -> tuple[Any, Any, Any]:
    """y = z + e, e ~ N(0, r)."""
    return [0.0], C, [[theta.r]]


def initial(theta: Any) -> tuple[Gaussian, Any, Any]:
    """z_1 ~ N(level, r): as vague as one measurement."""
    return Gaussian([], np.zeros((0, 0))), [theta.level], [[theta.r]]


MODEL = MixedModel(
    name="local-level",
    description="Local level: a random walk observed with noise, as fitted to the Nile flows.",
    linear={"level": "1e8 m^3"},
    outputs={"flow": "1e8 m^3"},
    reference=dict.fromkeys(("level", "flow"), 0.0),
    parameters=[
        Parameter("q", 1469.0, "1e16 m^6", (0.0, 1e9), "variance of the level's step"),
        Parameter("r", 15100.0, "1e16 m^6", (1e-6, 1e9), "variance of the measurement"),
        Parameter("level", 1120.0, "1e8 m^3", (-1e6, 1e6), "expected first level"),
    ],
    dynamics=dynamics,
    measurement=measurement,
    initial=initial,
    equations=("z' = z + w,  w ~ N(0, q)", "y = z + e,  e ~ N(0, r),  z_1 ~ N(level, r)"),
)
