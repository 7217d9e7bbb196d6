"""``linear-2``: a linear second-order system; paper, eq. (34), report, eqs. (70)-(71)."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.statespace.model import Array, Gaussian, MixedModel, Parameter

Q = 0.1 * np.eye(2)
R = 0.1 * np.eye(1)
C = np.zeros((1, 1))


def dynamics(a: Array, u: Array, t: float, dt: float, theta: Any) -> tuple[Any, Any, Any]:
    """A' = a + theta z + w_a,  z' = z + w_z."""
    f = [a[:, 0], 0.0]
    A = [[theta.theta], [1.0]]
    return f, A, Q


def measurement(a: Array, u: Array, t: float, theta: Any) -> tuple[Any, Any, Any]:
    """y = a + e."""
    return a, C, R


def initial(theta: Any) -> tuple[Gaussian, Any, Any]:
    """a_1 ~ N(0, 1), z_1 ~ N(1, 1)."""
    return Gaussian([0.0], [[1.0]]), np.array([1.0]), np.eye(1)


MODEL = MixedModel(
    name="linear-2",
    description="Linear second-order system of paper, eq. (34): an integrated random walk.",
    nonlinear={"a": "1"},
    linear={"z": "1"},
    outputs={"y": "1"},
    reference=dict.fromkeys(("a", "z", "y"), 0.0),
    parameters=[Parameter("theta", 0.1, "1", (-2.0, 2.0), "coupling of z into a")],
    dynamics=dynamics,
    measurement=measurement,
    initial=initial,
    equations=(
        "a' = a + theta z + w_a",
        "z' = z + w_z,  w ~ N(0, 0.1 I)",
        "y = a + e,  e ~ N(0, 0.1)",
    ),
)
