"""``oscillator``: a mass on a linear spring with damping; position is measured, velocity is linear.

    x'' = -omega^2 x - 2 zeta omega x' + gain omega^2 u + noise      y = x + e

The input is held over the step; the core in (x, x') with its noise is discretised exactly for
whatever dt is (van Loan), so Q_az != 0. ``gain`` is the position per input at rest.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.models.linear_core import LinearCore
from engine.statespace.model import Array, Gaussian, MixedModel, Parameter

C = np.zeros((1, 1))
Z1 = np.zeros(1)


def _build(values: Array) -> tuple[Array, Array, Array]:
    """The continuous core in (x, x'); its input is a position at rest."""
    omega, zeta, sigma, _ = np.moveaxis(values, -1, 0)
    F, G, Qc = (np.zeros((*omega.shape, 2, n)) for n in (2, 1, 2))
    F[..., 0, 1] = 1.0
    F[..., 1, 0], F[..., 1, 1] = -(omega**2), -2.0 * zeta * omega
    G[..., 1, 0] = omega**2
    Qc[..., 1, 1] = sigma**2
    return F, G, Qc


CORE = LinearCore(_build)


def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
    """One step of the exact discretisation."""
    omega, zeta, gain, sigma, _ = theta
    A, B, Q = CORE(omega, zeta, sigma, dt)
    x, push = a[:, 0], gain * u[0]
    f = [A[..., 0, 0] * x + B[..., 0, 0] * push, A[..., 1, 0] * x + B[..., 1, 0] * push]
    return f, A[..., 1:], Q


def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
    """Position, y = x + e; the floor of e's standard deviation is the lower bound of sigma_y."""
    return [a[:, 0]], C, [[theta.sigma_y**2]]


def initial(theta: Any) -> tuple[Gaussian, Any, Any]:
    """x_1 ~ N(0, 1), x_1' ~ N(0, omega^2): anywhere on a swing of size one."""
    return Gaussian([0.0], [[1.0]]), Z1, [[theta.omega**2]]


MODEL = MixedModel(
    name="oscillator",
    description=(
        "Mass on a linear spring with damping, driven by an input; its position is measured. In "
        "units in which the position is of the order of one."
    ),
    nonlinear={"position": "1"},
    linear={"velocity": "1/s"},
    kinematic=("position",),
    inputs={"drive": "1"},
    outputs={"y": "1"},
    reference=dict.fromkeys(("position", "drive", "y"), 0.0),  # at rest
    parameters=[
        Parameter("omega", 6.0, "rad/s", (1e-3, 1e4), "natural frequency"),
        Parameter("zeta", 0.05, "1", (0.0, 5.0), "damping ratio"),
        Parameter("gain", 1.0, "1", (-1e3, 1e3), "position per input at rest"),
        Parameter("sigma_v", 0.1, "1/s^1.5", (1e-6, 1e5), "random acceleration, intensity"),
        Parameter("sigma_y", 0.01, "1", (2e-4, 10.0), "standard deviation of the measurement"),
    ],
    continuous=True,
    dynamics=dynamics,
    measurement=measurement,
    initial=initial,
    equations=(
        "x'' = -omega^2 x - 2 zeta omega x' + gain omega^2 u + sigma_v w",
        "y = x + e,  e ~ N(0, sigma_y^2)",
    ),
)
