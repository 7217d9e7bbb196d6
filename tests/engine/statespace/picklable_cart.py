"""A continuous model whose functions can be pickled, as a module's own are."""

import numpy as np

import engine


def drift(a, u, t, theta):
    return [-theta.c * a[:, 0] ** 3, u[0]], [[1.0], [-0.1]]


def diffusion(a, u, t, theta):
    return np.diag([0.0, 1e-3])


def measurement(a, u, t, theta):
    return [a[:, 0]], [[0.0]], [[1e-4]]


def initial(theta):
    return engine.Gaussian([0.0], [[1.0]]), [0.0], [[1.0]]


cart = engine.continuous(
    name="cart",
    drift=drift,
    diffusion=diffusion,
    measurement=measurement,
    initial=initial,
    nonlinear={"position": "m"},
    linear={"velocity": "m/s"},
    inputs={"force": "N"},
    outputs={"y": "m"},
    parameters=[engine.Parameter("c", 1.0, "1/(m^2 s)", (0.0, 20.0))],
)
