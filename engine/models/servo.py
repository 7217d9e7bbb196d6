"""``servo``: a drive with friction that moves a mass; velocity is nonlinear, the rest is linear.

    M v' = gtau u - Fv v - Fc sign(v) - offset - d      q' = v      d' = noise      y = q + e

Input, offset and Coulomb friction are held over the step; the linear core in x = (v, q, d), with
its noise, is then discretised exactly for whatever dt is (van Loan), so Q_az != 0.

Coulomb friction within a step is a projection: with g the velocity that the step would end at
without it, friction takes away at most what it can, and what is needed to stop where that is
less. So friction stops the motion and never reverses it, there is no chatter around v = 0 and no
width to choose; as dt goes to 0 this is Coulomb's law. What stops is decided from v and u alone,
since x must stay linear in the load force d: against d a standing drive creeps with d dt / M.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.models.linear_core import LinearCore
from engine.statespace.model import Array, Gaussian, MixedModel, Parameter

C = np.array([[1.0, 0.0]])
START = Gaussian([0.0], [[0.01**2]])  # m/s: records begin near rest
Z1 = np.zeros(2)  # the load force departs from the offset, so it starts at zero exactly
P1 = np.diag([1.0, 0.0])  # m^2, N^2


def _build(values: Array) -> tuple[Array, Array, Array]:
    """The continuous core in (v, q, d), driven by a force."""
    M, Fv, sigma_v, sigma_load, _ = np.moveaxis(values, -1, 0)
    F, G, Qc = (np.zeros((*M.shape, 3, n)) for n in (3, 1, 3))
    F[..., 0, 0], F[..., 0, 2], F[..., 1, 0] = -Fv / M, -1.0 / M, 1.0
    G[..., 0, 0] = 1.0 / M
    Qc[..., 0, 0], Qc[..., 2, 2] = sigma_v**2, sigma_load**2
    return F, G, Qc


CORE = LinearCore(_build)


def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
    """Over one step: g = phi v + psi F / M, F = gtau u - offset, then friction, then d."""
    M, Fv, Fc, offset, gtau, sigma_v, sigma_load, _ = theta
    core, drive, Q = CORE(M, Fv, sigma_v, sigma_load, dt)
    phi, psi = core[..., 0, 0], core[..., 1, 0]
    push, shift = drive[..., 0, 0], drive[..., 1, 0]
    v = a[:, 0]
    force = gtau * u[0] - offset
    friction = np.clip((phi * v + push * force) / push, -Fc, Fc)
    f = [phi * v + push * (force - friction), psi * v + shift * (force - friction), 0.0]
    return f, core[..., 1:], Q


def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
    """Position, y = q + e; the floor of e's standard deviation is the lower bound of sigma_y."""
    return [0.0], C, [[theta.sigma_y**2]]


def initial(theta: Any) -> tuple[Gaussian, Any, Any]:
    """v_1 near rest, q_1 ~ N(0, 1 m^2), d_1 = 0."""
    return START, Z1, P1


MODEL = MixedModel(
    name="servo",
    description=(
        "Drive with viscous and Coulomb friction, a constant offset force and a slow load force; "
        "position is measured. Only the ratios of M, Fv, Fc, offset and gtau are in the data: "
        "keep gtau (or M) at its known value."
    ),
    nonlinear={"velocity": "m/s"},
    linear={"position": "m", "load": "N"},
    kinematic=("position",),
    inputs={"drive": "V"},
    outputs={"y": "m"},
    reference=dict.fromkeys(("load", "drive"), 0.0),  # a position has none
    parameters=[
        Parameter("M", 95.0, "kg", (1e-3, 1e5), "moving mass"),
        Parameter("Fv", 203.0, "N s/m", (0.0, 1e6), "viscous friction"),
        Parameter("Fc", 20.0, "N", (0.0, 1e5), "Coulomb friction"),
        Parameter("offset", -3.0, "N", (-1e5, 1e5), "constant force against positive motion"),
        Parameter("gtau", 35.15, "N/V", (1e-3, 1e5), "force per input; known, keep it fixed"),
        Parameter("sigma_v", 5e-3, "m/s^1.5", (1e-9, 1e2), "random acceleration, intensity"),
        Parameter("sigma_load", 0.1, "N/s^0.5", (0.0, 1e4), "drift of the load force, intensity"),
        Parameter("sigma_y", 1e-4, "m", (1e-6, 1.0), "standard deviation of the measurement"),
    ],
    dynamics=dynamics,
    measurement=measurement,
    initial=initial,
    equations=(
        "M v' = gtau u - Fv v - Fc sign(v) - offset - d + sigma_v M w_1",
        "q' = v,  d' = sigma_load w_2,  y = q + e,  e ~ N(0, sigma_y^2)",
    ),
)
