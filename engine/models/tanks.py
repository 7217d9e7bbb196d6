"""``tanks``: two tanks in cascade by Bernoulli's law; the level of the lower one is measured.

    x_1' = -k1 sqrt(x_1) + k4 u + d      x_2' = k1 sqrt(x_1) - k3 sqrt(x_2)      y = x_2 + e

u is the pump's voltage; levels are in the sensor's volts. The outflow of the upper tank is the
inflow of the lower one with the same coefficient: the scale of the upper level is not in the data,
so k2 = k1. d is a slow unmeasured inflow, a random walk that starts at zero (what is constant
in it cannot be told from k4 u at once). The upper bound of sigma_inflow is what makes it slow: a
faster one takes over whatever the equations get wrong (on the cascaded-tanks benchmark with
sigma_inflow = 4e-3 the likelihood is higher by 20, and the model no longer simulates: 3 V off).

The levels' own flow over dt is one midpoint step; it wants dt short beside 2 sqrt(x) / k (about
80 s at the defaults; at dt = 4 s it is off by less than 2e-3 of the step). d and the noise go
through the integrator d -> x_1 (van Loan in closed form), so Q_az != 0; that a little of them
drains again within the step, dt k / (2 sqrt(x)) of it, is left out, so A and Q are common to all
particles.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.statespace.model import Array, Gaussian, MixedModel, Parameter

C = np.zeros((1, 1))
START = Gaussian([6.0, 5.0], np.diag([4.0, 2.5]) ** 2)  # V: anywhere in the tanks
Z1 = np.zeros(1)
P1 = np.zeros((1, 1))


def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
    """Midpoint step of Bernoulli's law; an empty tank has no outflow."""
    k1, k3, k4, sigma_level, sigma_inflow, _ = theta
    pump = k4 * u[0]
    upper, lower = k1 * root(a[:, 0]), k3 * root(a[:, 1])
    middle = a[:, 0] + 0.5 * dt * (pump - upper), a[:, 1] + 0.5 * dt * (upper - lower)
    upper, lower = k1 * root(middle[0]), k3 * root(middle[1])
    f = [a[:, 0] + dt * (pump - upper), a[:, 1] + dt * (upper - lower), 0.0]
    A = [[dt], [0.0], [1.0]]
    level, inflow = sigma_level**2 * dt, sigma_inflow**2 * dt
    Q = [
        [level + inflow * dt**2 / 3.0, 0.0, inflow * dt / 2.0],
        [0.0, level, 0.0],
        [inflow * dt / 2.0, 0.0, inflow],
    ]
    return f, A, Q


def root(level: Array) -> Array:
    """sqrt(level), zero below zero."""
    return np.sqrt(np.maximum(level, 0.0))


def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
    """Lower level, y = x_2 + e."""
    return [a[:, 1]], C, [[theta.sigma_y**2]]


def initial(theta: Any) -> tuple[Gaussian, Any, Any]:
    """Levels anywhere in the tank; no unmeasured inflow yet."""
    return START, Z1, P1


MODEL = MixedModel(
    name="tanks",
    description="Two tanks in cascade by Bernoulli's law; the level of the lower one is measured.",
    nonlinear={"upper": "V", "lower": "V"},
    linear={"inflow": "V/s"},
    inputs={"pump": "V"},
    outputs={"level": "V"},
    reference=dict.fromkeys(("upper", "lower", "inflow", "pump", "level"), 0.0),  # empty, off
    parameters=[
        Parameter("k1", 0.05, "V^0.5/s", (1e-4, 1.0), "outflow of the upper tank into the lower"),
        Parameter("k3", 0.05, "V^0.5/s", (1e-4, 1.0), "outflow of the lower tank"),
        Parameter("k4", 0.04, "1/s", (1e-4, 1.0), "inflow per pump voltage"),
        Parameter("sigma_level", 0.03, "V/s^0.5", (1e-4, 1.0), "noise of the levels, intensity"),
        Parameter("sigma_inflow", 1e-4, "V/s^1.5", (0.0, 2e-4), "drift of the inflow, intensity"),
        Parameter("sigma_y", 0.02, "V", (5e-3, 5.0), "standard deviation of the measurement"),
    ],
    continuous=True,
    dynamics=dynamics,
    measurement=measurement,
    initial=initial,
    equations=(
        "x_1' = -k1 sqrt(x_1) + k4 u + d + sigma_level w_1",
        "x_2' = k1 sqrt(x_1) - k3 sqrt(x_2) + sigma_level w_2",
        "d' = sigma_inflow w_3,  y = x_2 + e,  e ~ N(0, sigma_y^2)",
    ),
)
