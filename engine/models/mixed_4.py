"""``mixed-4``: the fourth-order mixed system of paper, eq. (35), report, eqs. (72)-(73)."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.statespace.model import Array, Gaussian, MixedModel, Parameter

Q = 0.01 * np.eye(4)
R = 0.1 * np.eye(2)
C = np.array([[0.0, 0.0, 0.0], [1.0, -1.0, 1.0]])


def dynamics(a: Array, u: Array, t: float, dt: float, theta: Any) -> tuple[Any, Any, Any]:
    """Paper, eqs. (35a)-(35b)."""
    th1, th2, th3, th4, th5 = theta
    f = [th1 * np.arctan(a[:, 0]), 0.0, 0.0, 0.0]
    A = [
        [th2, 0.0, 0.0],
        [1.0, th3, 0.0],
        [0.0, th4 * np.cos(th5), -th4 * np.sin(th5)],
        [0.0, th4 * np.sin(th5), th4 * np.cos(th5)],
    ]
    return f, A, Q


def measurement(a: Array, u: Array, t: float, theta: Any) -> tuple[Any, Any, Any]:
    """Paper, eq. (35c): y_1 = 0.1 a|a|, y_2 = z_1 - z_2 + z_3."""
    h = [0.1 * a[:, 0] * np.abs(a[:, 0]), 0.0]
    return h, C, R


def initial(theta: Any) -> tuple[Gaussian, Any, Any]:
    """a_1 ~ N(0, 1), z_1 = 0 exactly (report, eq. (73))."""
    return Gaussian([0.0], [[1.0]]), np.zeros(3), np.zeros((3, 3))


MODEL = MixedModel(
    name="mixed-4",
    description="Fourth-order mixed system of paper, eq. (35): an oscillator drives a nonlinear state.",
    nonlinear={"a": "1"},
    linear={"z1": "1", "z2": "1", "z3": "1"},
    outputs={"y1": "1", "y2": "1"},
    reference=dict.fromkeys(("a", "z1", "z2", "z3", "y1", "y2"), 0.0),
    parameters=[
        Parameter("theta_1", 1.0, "1", (-5.0, 5.0), "gain of arctan a"),
        Parameter("theta_2", 1.0, "1", (-10.0, 10.0), "coupling of z_1 into a"),
        Parameter("theta_3", 0.3, "1", (-5.0, 5.0), "coupling of z_2 into z_1"),
        Parameter("theta_4", 0.968, "1", (0.0, 1.2), "pole radius of (z_2, z_3)"),
        Parameter("theta_5", 0.315, "rad", (-np.pi, np.pi), "pole angle of (z_2, z_3)"),
    ],
    dynamics=dynamics,
    measurement=measurement,
    initial=initial,
    equations=(
        "a' = theta_1 arctan a + theta_2 z_1 + w_a",
        "z_1' = z_1 + theta_3 z_2 + w_1",
        "z_2' = theta_4 cos(theta_5) z_2 - theta_4 sin(theta_5) z_3 + w_2",
        "z_3' = theta_4 sin(theta_5) z_2 + theta_4 cos(theta_5) z_3 + w_3",
        "y_1 = 0.1 a |a| + e_1,  y_2 = z_1 - z_2 + z_3 + e_2,  w ~ N(0, 0.01 I), e ~ N(0, 0.1 I)",
    ),
)
