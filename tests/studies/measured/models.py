"""The models that an engineer would start from, where they are not registered.

``spring``, a linear mass-spring-damper:   m x'' = F - c x' - k x,   y = x + e
``cell``, charge and an ohmic resistance:  q' = I / (3600 Q),        V = ocv(q) + R0 I + e
``seasonal``, logs of monthly counts:      level' = level + w,       y = level + s_month + b p + e
"""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.models.linear_core import LinearCore
from engine.statespace.continuous import continuous
from engine.statespace.model import Array, Gaussian, MixedModel, Parameter

NONE = Gaussian([], np.zeros((0, 0)))
C = np.zeros((1, 1))


def _core(values: Array) -> tuple[Array, Array, Array]:
    """F, G, Qc of (x, x') driven by a force."""
    m, c, k, sigma, _ = np.moveaxis(values, -1, 0)
    F, G, Qc = (np.zeros((*m.shape, 2, n)) for n in (2, 1, 2))
    F[..., 0, 1] = 1.0
    F[..., 1, 0], F[..., 1, 1] = -k / m, -c / m
    G[..., 1, 0] = 1.0 / m
    Qc[..., 1, 1] = sigma**2
    return F, G, Qc


CORE = LinearCore(_core)


def _spring_dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
    A, B, Q = CORE(theta.m, theta.c, theta.k, theta.sigma_v, dt)
    x = a[:, 0]
    f = [A[..., 0, 0] * x + B[..., 0, 0] * u[0], A[..., 1, 0] * x + B[..., 1, 0] * u[0]]
    return f, A[..., 1:], Q


SPRING = MixedModel(
    name="spring",
    description="Mass on a linear spring with damping, driven by a force; its position is measured.",
    nonlinear={"position": "m"},
    linear={"velocity": "m/s"},
    kinematic=("position",),
    inputs={"force": "N"},
    outputs={"y": "m"},
    reference=dict.fromkeys(("position", "force", "y"), 0.0),  # at rest
    parameters=[
        Parameter("m", 2.0, "kg", (0.01, 100.0), "mass"),
        Parameter("c", 50.0, "N s/m", (0.0, 1e4), "damping"),
        Parameter("k", 8e4, "N/m", (1e2, 1e7), "stiffness"),
        Parameter("sigma_v", 0.01, "m/s^1.5", (1e-7, 1e2), "random acceleration, intensity"),
        Parameter("sigma_y", 1e-5, "m", (1e-7, 1e-2), "standard deviation of the measurement"),
    ],
    continuous=True,
    dynamics=_spring_dynamics,
    measurement=lambda a, u, t, theta: ([a[:, 0]], C, [[theta.sigma_y**2]]),
    initial=lambda theta: (Gaussian([0.0], [[1e-6]]), [0.0], [[0.04]]),  # 1 mm, 0.2 m/s
    equations=("m x'' = F - c x' - k x + sigma_v m w", "y = x + e,  e ~ N(0, sigma_y^2)"),
)

KNOTS = np.linspace(0.0, 1.0, 15)
FULL, EMPTY = 4.2, 3.4  # V, about
HOUR = 3600.0  # s
SLOW = 2e-5  # 1/s^0.5: 0.4 per cent over the record; faster, noise replaces the current
KNOT_NAMES = tuple(f"ocv_{k}" for k in range(len(KNOTS)))


def open_circuit(q: Array, theta: Any) -> Array:
    """The table's voltage at charges q (M,); straight on beyond its ends."""
    values = np.array([getattr(theta, name) for name in KNOT_NAMES])
    at = np.clip(np.searchsorted(KNOTS, q) - 1, 0, len(KNOTS) - 2)
    share = (q - KNOTS[at]) / (KNOTS[1] - KNOTS[0])
    if values.ndim == 1:
        return np.asarray(values[at] + share * (values[at + 1] - values[at]))
    rows = np.arange(len(q))  # parameters of their own in each row
    low, high = values[at, rows], values[at + 1, rows]
    return np.asarray(low + share * (high - low))


def _cell_drift(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any]:
    return [u[0] / (HOUR * theta.Q)], np.zeros((1, 0))


CELL = continuous(
    name="cell",
    description="Charge of a cell, its open-circuit voltage as a table, an ohmic resistance.",
    nonlinear={"charge": "1"},
    inputs={"current": "A"},
    outputs={"voltage": "V"},
    reference={"current": 0.0},
    parameters=[
        *(
            Parameter(
                name, EMPTY + (FULL - EMPTY) * q, "V", (2.0, 5.0), f"voltage at charge {q:.2f}"
            )
            for name, q in zip(KNOT_NAMES, KNOTS.tolist(), strict=True)
        ),
        Parameter("R0", 2e-3, "Ohm", (0.0, 0.1), "ohmic resistance"),
        Parameter("Q", 32.0, "A h", (1.0, 1e3), "capacity; known, keep it fixed"),
        Parameter("sigma_q", 1e-6, "1/s^0.5", (1e-10, SLOW), "drift of the charge, intensity"),
        Parameter("sigma_y", 5e-3, "V", (1e-4, 1.0), "standard deviation of the measurement"),
    ],
    drift=_cell_drift,
    jacobian=lambda a, u, t, theta: np.zeros((1, 1)),
    diffusion=lambda a, u, t, theta: [[theta.sigma_q**2]],
    measurement=lambda a, u, t, theta: (
        [open_circuit(a[:, 0], theta) + theta.R0 * u[0]],
        np.zeros((1, 0)),
        [[theta.sigma_y**2]],
    ),
    initial=lambda theta: (Gaussian([1.0], [[1e-6]]), [], np.zeros((0, 0))),  # full
    equations=(
        "q' = I / (3600 Q) + sigma_q w",
        "V = ocv(q) + R0 I + e,  e ~ N(0, sigma_y^2),  ocv a table of 15 knots",
    ),
)

MONTHS = tuple(f"s_{k}" for k in range(2, 13))


def season(t: Any, theta: Any) -> Any:
    """What the month of t, counted from a January, adds to January's level."""
    month = np.round(t).astype(int) % 12
    values = np.array([0.0 * theta.s_2, *(getattr(theta, name) for name in MONTHS)])
    return values[month] if values.ndim == 1 else values[month, np.arange(values.shape[1])]


SEASONAL = MixedModel(
    name="seasonal",
    description="Logs of monthly counts: a random walk, a season, a price.",
    linear={"level": "1"},
    inputs={"price": "1"},
    outputs={"drivers": "1"},
    reference=dict.fromkeys(("level", "drivers"), 0.0),
    parameters=[
        Parameter("q", 5e-4, "1", (0.0, 1.0), "variance of the level's step"),
        Parameter("r", 4e-3, "1", (1e-8, 1.0), "variance of the measurement"),
        Parameter("level", 7.0, "1", (-1e3, 1e3), "expected first level"),
        Parameter("b", -0.3, "1", (-10.0, 10.0), "of the price"),
        *(Parameter(name, 0.0, "1", (-5.0, 5.0), f"month {name[2:]}") for name in MONTHS),
    ],
    dynamics=lambda a, u, t, dt, theta: ([0.0], np.eye(1), [[theta.q]]),
    measurement=lambda a, u, t, theta: (
        [season(t, theta) + theta.b * u[0]],
        np.eye(1),
        [[theta.r]],
    ),
    initial=lambda theta: (NONE, [theta.level], [[theta.r]]),
    equations=("z' = z + w,  w ~ N(0, q)", "y = z + s_month + b p + e,  e ~ N(0, r)"),
)
