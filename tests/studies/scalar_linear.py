"""``scalar-linear``: the poster's first example in our own words; exact EM is available for it.

The state counts as nonlinear, so that RBPS-EM and PS-EM treat it by particles. The measurement gain
is fixed at 1: a gain c and a variance q would enter the likelihood as c^2 q only.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.statespace.general import as_general
from engine.statespace.model import Array, Gaussian, MixedModel, Parameter

EMPTY = np.zeros((1, 0))


def dynamics(x: Array, u: Array, t: float, dt: float, theta: Any) -> tuple[Any, Any, Any]:
    """X' = a x + v, v ~ N(0, q)."""
    return [theta.a * x[:, 0]], EMPTY, [[theta.q]]


def measurement(x: Array, u: Array, t: float, theta: Any) -> tuple[Any, Any, Any]:
    """y = x + e, e ~ N(0, r)."""
    return [x[:, 0]], EMPTY, [[theta.r]]


def initial(theta: Any) -> tuple[Gaussian, Any, Any]:
    """x_1 ~ N(0, 1)."""
    return Gaussian([0.0], [[1.0]]), np.zeros(0), np.zeros((0, 0))


MODEL = MixedModel(
    name="scalar-linear",
    description="A scalar linear system, on which PS-EM is compared with exact EM.",
    nonlinear={"x": "1"},
    outputs={"y": "1"},
    reference=dict.fromkeys(("x", "y"), 0.0),
    parameters=[
        Parameter("a", 0.9, "1", (-1.5, 1.5), "pole"),
        Parameter("q", 0.1, "1", (1e-6, 100.0), "variance of the process noise"),
        Parameter("r", 0.1, "1", (1e-6, 100.0), "variance of the measurement noise"),
    ],
    dynamics=dynamics,
    measurement=measurement,
    initial=initial,
    equations=("x' = a x + v,  v ~ N(0, q)", "y = x + e,  e ~ N(0, r),  x_1 ~ N(0, 1)"),
)

GENERAL = as_general(MODEL)
