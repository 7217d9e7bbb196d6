"""``growth``: the nonlinear, time-varying benchmark of Schon, Wills, Ninness (2011); poster.

The poster's own second example is lost; this is the standard one of its authors, with variances
that are estimated too. ``MODEL`` is a mixed model without linear states, ``GENERAL`` the same as a
general model, ``HEAVY`` has Student-t measurement noise, for a non-Gaussian problem.
The sign of x shows in the measurement only through the dynamics, so the smoothing density has two
humps at times.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from engine.statespace.densities import StudentT
from engine.statespace.general import NonlinearModel, as_general
from engine.statespace.model import Array, Gaussian, MixedModel, Parameter

EMPTY = np.zeros((1, 0))


def drift(x: Array, t: Any, theta: Any) -> Any:
    """a x + b x / (1 + x^2) + c cos(1.2 t), t in samples of 1 s."""
    return theta.a * x + theta.b * x / (1.0 + x * x) + theta.c * np.cos(1.2 * t)


def dynamics(x: Array, u: Array, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
    """X' = a x + b x / (1 + x^2) + c cos(1.2 t) + v, v ~ N(0, q)."""
    return [drift(x[:, 0], t, theta)], EMPTY, [[theta.q]]


def measurement(x: Array, u: Array, t: Any, theta: Any) -> tuple[Any, Any, Any]:
    """y = d x^2 + e, e ~ N(0, r)."""
    return [theta.d * x[:, 0] ** 2], EMPTY, [[theta.r]]


def initial(theta: Any) -> tuple[Gaussian, Any, Any]:
    """x_1 ~ N(0, 1)."""
    return Gaussian([0.0], [[1.0]]), np.zeros(0), np.zeros((0, 0))


PARAMETERS = [
    Parameter("a", 0.5, "1", (-2.0, 2.0), "linear gain"),
    Parameter("b", 25.0, "1", (-100.0, 100.0), "gain of x / (1 + x^2)"),
    Parameter("c", 8.0, "1", (-50.0, 50.0), "amplitude of the drive"),
    Parameter("d", 0.05, "1", (0.0, 1.0), "gain of the measurement"),
    Parameter("q", 0.1, "1", (1e-4, 100.0), "variance of the process noise"),
    Parameter("r", 0.1, "1", (1e-4, 100.0), "variance of the measurement noise"),
]

MODEL = MixedModel(
    name="growth",
    description="Nonlinear time-varying growth model of Schon, Wills, Ninness (2011).",
    nonlinear={"x": "1"},
    outputs={"y": "1"},
    parameters=PARAMETERS,
    dynamics=dynamics,
    measurement=measurement,
    initial=initial,
    equations=(
        "x' = a x + b x / (1 + x^2) + c cos(1.2 t) + v,  v ~ N(0, q)",
        "y = d x^2 + e,  e ~ N(0, r),  x_1 ~ N(0, 1)",
    ),
)

GENERAL = as_general(MODEL)


def _heavy_measurement(x: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any]:
    """y = d x^2 + e."""
    return [theta.d * x[:, 0] ** 2], None


HEAVY: NonlinearModel = replace(
    GENERAL,
    name="growth-heavy",
    description="The growth model with Student-t measurement noise.",
    measurement=_heavy_measurement,
    measurement_noise=lambda theta: StudentT([np.sqrt(theta.r)], theta.nu),
    parameters=[*PARAMETERS, Parameter("nu", 3.0, "1", (0.5, 200.0), "degrees of freedom of e")],
    equations=(MODEL.equations[0], "y = d x^2 + e,  e ~ sqrt(r) t_nu,  x_1 ~ N(0, 1)"),
)
