"""``structure``: two storeys on springs and dampers, the first one driven; two vibration modes.

    x1'' = -k1 x1 - c v1 + k2 (x2 - x1) + c (v2 - v1) + gain u + noise
    x2'' = -k2 (x2 - x1) - c (v2 - v1) + noise

Stiffness, damping and force are per unit of mass. The displacement of the first storey counts as
nonlinear, as its columns are what yields first; both displacements are measured. The input is held
over the step and the core, with its noise, is discretised exactly for whatever dt is.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.models.linear_core import LinearCore
from engine.statespace.model import Array, Gaussian, MixedModel, Parameter

C = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
START = Gaussian([0.0], [[0.1**2]])  # m: records begin near rest
Z1 = np.zeros(3)
P1 = np.diag([0.1**2, 1.0, 1.0])  # m^2, m^2/s^2, m^2/s^2


def _build(values: Array) -> tuple[Array, Array, Array]:
    """The continuous core in (x1, x2, v1, v2)."""
    k1, k2, c, sigma_v, _ = np.moveaxis(values, -1, 0)
    F, G, Qc = (np.zeros((*k1.shape, 4, n)) for n in (4, 1, 4))
    F[..., 0, 2] = F[..., 1, 3] = 1.0
    F[..., 2, 0], F[..., 2, 1] = -(k1 + k2), k2
    F[..., 2, 2], F[..., 2, 3] = -2.0 * c, c
    F[..., 3, 0], F[..., 3, 1] = k2, -k2
    F[..., 3, 2], F[..., 3, 3] = c, -c
    G[..., 2, 0] = 1.0
    Qc[..., 2, 2] = Qc[..., 3, 3] = sigma_v**2
    return F, G, Qc


CORE = LinearCore(_build)


def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
    """One step of the exact discretisation."""
    A, B, Q = CORE(theta.k1, theta.k2, theta.c, theta.sigma_v, dt)
    x1, push = a[:, 0], theta.gain * u[0]
    f = [A[..., i, 0] * x1 + B[..., i, 0] * push for i in range(4)]
    return f, A[..., 1:], Q


def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
    """y_1 = x1 + e_1, y_2 = x2 + e_2."""
    r = theta.sigma_y**2
    return [a[:, 0], 0.0], C, [[r, 0.0], [0.0, r]]


def initial(theta: Any) -> tuple[Gaussian, Any, Any]:
    """Near rest."""
    return START, Z1, P1


MODEL = MixedModel(
    name="structure",
    description=(
        "Two storeys on springs and dampers, a force on the first one; both displacements are "
        "measured. All per unit of mass, the storeys' masses being equal."
    ),
    nonlinear={"x1": "m"},
    linear={"x2": "m", "v1": "m/s", "v2": "m/s"},
    kinematic=("x1", "x2"),
    inputs={"force": "N"},
    outputs={"y1": "m", "y2": "m"},
    reference=dict.fromkeys(("x1", "x2", "force", "y1", "y2"), 0.0),  # at rest
    parameters=[
        Parameter("k1", 60.0, "1/s^2", (1e-3, 1e8), "stiffness of the first storey"),
        Parameter("k2", 40.0, "1/s^2", (1e-3, 1e8), "stiffness between the storeys"),
        Parameter("c", 0.3, "1/s", (0.0, 1e4), "damping of each storey"),
        Parameter("gain", 10.0, "1/kg", (-1e6, 1e6), "acceleration per force"),
        Parameter("sigma_v", 0.2, "m/s^1.5", (1e-6, 1e4), "random acceleration, intensity"),
        Parameter("sigma_y", 0.01, "m", (1e-5, 1.0), "standard deviation of the measurements"),
    ],
    continuous=True,
    dynamics=dynamics,
    measurement=measurement,
    initial=initial,
    equations=(
        "x1'' = -k1 x1 - c v1 + k2 (x2 - x1) + c (v2 - v1) + gain u + sigma_v w_1",
        "x2'' = -k2 (x2 - x1) - c (v2 - v1) + sigma_v w_2",
        "y_1 = x1 + e_1,  y_2 = x2 + e_2,  e ~ N(0, sigma_y^2 I)",
    ),
)
