"""``oscillator``: a mass on a linear spring with damping; position is measured, velocity is linear.

    x'' = -omega^2 x - 2 zeta omega x' + gain omega^2 u + noise      y = x + e

The input is held over the step; the core in (x, x') with its noise is discretised exactly for
whatever dt is (van Loan), so Q_az != 0. ``gain`` is the position per input at rest.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from engine.discretize import discretize
from engine.model import Array, Gaussian, MixedModel, Parameter

C = np.zeros((1, 1))
Z1 = np.zeros(1)


def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
    """One step of the exact discretisation."""
    omega, zeta, gain, sigma, _ = theta
    A, B, Q = linear_core(omega, zeta, sigma, dt)
    x, push = a[:, 0], gain * u[0]
    f = [A[..., 0, 0] * x + B[..., 0, 0] * push, A[..., 1, 0] * x + B[..., 1, 0] * push]
    return f, A[..., 1:], Q


def linear_core(omega: Any, zeta: Any, sigma: Any, dt: Any) -> tuple[Array, ...]:
    """A (2, 2), B (2, 1), Q (2, 2) of position and velocity, or (K, ., .) for K values."""
    values = (omega, zeta, sigma, dt)
    if all(np.ndim(value) == 0 for value in values):
        return _core(*(float(f"{value:.12g}") for value in values))
    rows = np.stack(np.broadcast_arrays(*values), axis=1).astype(float)
    return _cores(rows.tobytes())


@lru_cache(maxsize=4096)
def _core(*values: float) -> tuple[Array, ...]:
    return _discretized(np.array(values))


@lru_cache(maxsize=16)
def _cores(data: bytes) -> tuple[Array, ...]:
    """The same for rows (K, 4), each distinct one once."""
    rows = np.frombuffer(data).reshape(-1, 4)
    distinct, which = np.unique(rows, axis=0, return_inverse=True)
    matrices = _discretized(distinct)
    which = which.ravel()
    return tuple(matrix[0] if len(distinct) == 1 else matrix[which] for matrix in matrices)


def _discretized(values: Array) -> tuple[Array, ...]:
    """A, B, Q for values (..., 4)."""
    omega, zeta, sigma, dt = np.moveaxis(values, -1, 0)
    F, G, Qc = (np.zeros((*dt.shape, 2, n)) for n in (2, 1, 2))
    F[..., 0, 1] = 1.0
    F[..., 1, 0], F[..., 1, 1] = -(omega**2), -2.0 * zeta * omega
    G[..., 1, 0] = omega**2
    Qc[..., 1, 1] = sigma**2
    matrices = discretize(F, G, Qc, dt=dt)
    for matrix in matrices:
        matrix.setflags(write=False)  # they are shared between calls
    return matrices


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
    inputs={"drive": "1"},
    outputs={"y": "1"},
    parameters=[
        Parameter("omega", 6.0, "rad/s", (1e-3, 1e4), "natural frequency"),
        Parameter("zeta", 0.05, "1", (0.0, 5.0), "damping ratio"),
        Parameter("gain", 1.0, "1", (-1e3, 1e3), "position per input at rest"),
        Parameter("sigma_v", 0.1, "1/s^1.5", (1e-6, 1e5), "random acceleration, intensity"),
        Parameter("sigma_y", 0.01, "1", (2e-4, 10.0), "standard deviation of the measurement"),
    ],
    dynamics=dynamics,
    measurement=measurement,
    initial=initial,
    equations=(
        "x'' = -omega^2 x - 2 zeta omega x' + gain omega^2 u + sigma_v w",
        "y = x + e,  e ~ N(0, sigma_y^2)",
    ),
)
