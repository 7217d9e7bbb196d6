"""``servo``: a drive with friction that moves a mass; velocity is nonlinear, the rest is linear.

    M v' = gtau u - Fv v - Fc sign(v) - offset - d      q' = v      d' = noise      y = q + e

Input, offset and Coulomb friction are held over the step; the linear core in x = (v, q, d), with
its noise, is then discretised exactly for whatever dt is (van Loan), so Q_az != 0.

Under a constant force the motion has a closed form until the drive comes to rest; from there on friction
holds it, or it goes the other way. So one step per sample is exact, however often the drive turns: friction
that acted on the speed before the step (or after it) is wrong by an error of first order wherever it stops.
What stops is decided from v and u alone, since x must stay linear in the load force d: against d a
standing drive creeps with d dt / M.
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
SLOW = 1e-4  # of rate times time: below it series, which do not cancel


def _build(values: Array) -> tuple[Array, Array, Array]:
    """The continuous core in (v, q, d), driven by a force."""
    M, Fv, sigma_v, sigma_load, _ = np.moveaxis(values, -1, 0)
    F, G, Qc = (np.zeros((*M.shape, 3, n)) for n in (3, 1, 3))
    F[..., 0, 0], F[..., 0, 2], F[..., 1, 0] = -Fv / M, -1.0 / M, 1.0
    G[..., 0, 0] = 1.0 / M
    Qc[..., 0, 0], Qc[..., 2, 2] = sigma_v**2, sigma_load**2
    return F, G, Qc


CORE = LinearCore(_build)


def motion(v: Any, acceleration: Any, rate: Any, time: Any) -> tuple[Any, Any]:
    """Speed after, and way within, ``time`` of v' = acceleration - rate v; without damping a parabola."""
    x = rate * time
    slow = np.abs(x) < SLOW
    one = np.where(slow, 1.0 - x / 2.0 + x**2 / 6.0, -np.expm1(-x) / np.where(slow, 1.0, x))
    two = np.where(slow, 0.5 - x / 6.0 + x**2 / 24.0, (1.0 - one) / np.where(slow, 1.0, x))
    lost = time * one
    return v + (acceleration - rate * v) * lost, v * lost + acceleration * time**2 * two


def standstill(v: Any, acceleration: Any, rate: Any) -> Any:
    """The time after which v' = acceleration - rate v, which slows v, has brought it to rest."""
    x = -v * rate / acceleration
    slow = x < SLOW
    share = np.where(slow, 1.0 - x / 2.0 + x**2 / 3.0, np.log1p(x) / np.where(slow, 1.0, x))
    return -v / acceleration * share


def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
    """Over one step: against friction until v = 0, then from rest under what is left of the force; then d."""
    M, Fv, Fc, offset, gtau, sigma_v, sigma_load, _ = theta
    core, _, Q = CORE(M, Fv, sigma_v, sigma_load, dt)
    v, force, rate = a[:, 0], gtau * u[0] - offset, Fv / M
    direction = np.where(v == 0.0, np.sign(force), np.sign(v))
    slowed = (force - Fc * direction) / M
    speed, way = motion(v, slowed, rate, dt)
    rests = direction * speed < 0.0
    until = np.where(
        rests, standstill(np.where(rests, v, 0.0), np.where(rests, slowed, 1.0), rate), dt
    )
    _, before = motion(v, slowed, rate, until)
    left = np.sign(force) * np.maximum(np.abs(force) - Fc, 0.0) / M
    regained, after = motion(0.0, left, rate, dt - until)
    f = [np.where(rests, regained, speed), np.where(rests, before + after, way), 0.0]
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
