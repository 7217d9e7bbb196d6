"""Small models on which the tests compare the engine with exact answers."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine import Gaussian, MixedModel, Parameter, Series
from engine.statespace.model import Array

ROOT_Q = 0.3 * np.array(
    [[1.0, 0, 0, 0], [0.3, 0.8, 0, 0], [0.5, -0.2, 0.9, 0], [-0.4, 0.3, 0.2, 0.7]]
)
F = np.array([[0.8, 0.1], [0.0, 0.7], [0.2, 0.0], [0.0, -0.1]])  # of a
A = np.array([[0.5, 0.2], [0.1, -0.4], [0.9, 0.2], [-0.1, 0.8]])
B = np.array([0.5, 0.0, -0.3, 0.2])  # of u
H = np.array([[1.0, 0.0], [0.2, 0.7]])
C = np.array([[0.5, -0.2], [0.0, 1.0]])
R = np.array([[0.3, 0.1], [0.1, 0.4]])
Z1 = np.array([[0.5], [1.0]])  # P_1 = Z1 Z1' is singular


def linear_mixed(na: int = 2, nz: int = 2, particle_shaped: bool = False) -> MixedModel:
    """Linear Gaussian with A_a != 0, Q_az != 0, singular P_1, inputs and time-varying matrices.

    With fewer than 2 + 2 states the first ones are kept; ``particle_shaped`` matrices have a
    particle axis although all particles share their values.
    """
    states = [*range(na), *range(2, 2 + nz)]

    def spread(matrix: Array, a: Array) -> Array:
        return np.repeat(matrix[None], len(a), axis=0) if particle_shaped else matrix

    def dynamics(a: Array, u: Array, t: float, dt: float, theta: Any) -> tuple[Any, Any, Any]:
        f = a @ F[np.ix_(states, range(na))].T + B[states] * u[0]
        slope = A[np.ix_(states, range(nz))] * (1.0 + 0.3 * np.sin(0.7 * t))
        Q = dt * (ROOT_Q @ ROOT_Q.T)[np.ix_(states, states)]
        return f, spread(slope, a), spread(Q, a)

    def measurement(a: Array, u: Array, t: float, theta: Any) -> tuple[Any, Any, Any]:
        h = a @ H[:, :na].T + 0.1 * u[0]
        return h, spread(C[:, :nz] * (1.0 + 0.2 * np.cos(t)), a), spread(R, a)

    def initial(theta: Any) -> tuple[Gaussian, Any, Any]:
        P1 = (Z1 @ Z1.T)[:nz, :nz]
        return (
            Gaussian([1.0, -0.5][:na], np.array([[1.0, 0.3], [0.3, 0.5]])[:na, :na]),
            [1.0, 0.0][:nz],
            P1,
        )

    return MixedModel(
        name="linear-mixed",
        nonlinear={f"a{i + 1}": "1" for i in range(na)},
        linear={f"z{i + 1}": "1" for i in range(nz)},
        inputs={"u": "1"},
        outputs={"y1": "1", "y2": "1"},
        parameters=[],
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
    )


def draw(model: MixedModel, u: Array, t: Array, rng: np.random.Generator) -> Array:
    """y (T, ny) drawn step by step with plain NumPy."""
    theta = model.record(model.theta())
    start = model.start(theta)
    a = start.density.sample(rng, 1)
    z, P1 = start.linear(a)
    if model.nz:
        z = z + rng.multivariate_normal(np.zeros(model.nz), P1)
    y = np.empty((len(t), model.ny))
    for k in range(len(t)):
        h, C, R = model.observation(a, u[k], t[k], theta)
        C, R = C.reshape(model.ny, model.nz), R.reshape(model.ny, model.ny)
        y[k] = rng.multivariate_normal((h + z @ C.T)[0], R)
        if k + 1 < len(t):
            f, A, Q = model.transition(a, u[k], t[k], t[k + 1] - t[k], theta)
            A, Q = A.reshape(model.nx, model.nz), Q.reshape(model.nx, model.nx)
            x = f + z @ A.T + rng.multivariate_normal(np.zeros(model.nx), Q)
            a, z = x[:, : model.na], x[:, model.na :]
    return y


def awkward_series(model: MixedModel, T: int = 20, seed: int = 4) -> Series:
    """Irregular time stamps, an input, a whole row and single channels missing."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.5, 1.5, T))
    u = rng.standard_normal((T, model.nu))
    y = draw(model, u, t, rng)
    y[T // 3] = np.nan
    y[T // 2, 0] = np.nan
    y[T // 2 + 1, -1] = np.nan
    return Series(y, u, t=t)


def theta_everywhere(particle_shaped: bool = True) -> MixedModel:
    """Nonlinear in a, theta in a_1, z_1, P_1, f, A, Q, h, C and R."""

    def dynamics(a: Array, u: Array, t: float, dt: float, theta: Any) -> tuple[Any, Any, Any]:
        x = a[:, 0]
        f = [theta.f * np.arctan(x), 0.3 * x, 0.1 + 0.0 * x]
        g = np.cos(x) if particle_shaped else 1.0
        slope = [[theta.A, 0.3], [0.8, 0.2 * g], [-0.1, 0.5 * theta.A * g]]
        q = theta.Q * (1.0 + 0.2 * g)
        Q = [[q, 0.1 * theta.Q, 0.0], [0.1 * theta.Q, 0.4, 0.05], [0.0, 0.05, 0.3]]
        return f, slope, Q

    def measurement(a: Array, u: Array, t: float, theta: Any) -> tuple[Any, Any, Any]:
        x = a[:, 0]
        g = np.sin(x) if particle_shaped else 0.5
        return (
            [theta.h * x + 0.1 * x**2, 0.0],
            [[0.2, theta.C], [1.0, 0.1 * g]],
            [[theta.R * (1.0 + 0.3 * g), 0.05], [0.05, 0.4]],
        )

    def initial(theta: Any) -> tuple[Gaussian, Any, Any]:
        return (
            Gaussian([theta.m1], [[theta.v1]]),
            lambda a: [theta.z1 + 0.3 * a[:, 0], 0.2],
            np.array([[theta.p1, 0.1], [0.1, 0.5]]),
        )

    values = {"f": 0.9, "A": 0.5, "Q": 0.3, "h": 0.8, "C": 0.6, "R": 0.2}
    values |= {"m1": 0.4, "v1": 0.7, "z1": -0.2, "p1": 0.6}
    return MixedModel(
        name="theta-everywhere",
        nonlinear={"a": "1"},
        linear={"z1": "1", "z2": "1"},
        outputs={"y1": "1", "y2": "1"},
        parameters=[
            Parameter(name, value, bounds=(0.01 if name in "QRv1p1" else -5.0, 5.0))
            for name, value in values.items()
        ],
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
    )


def partly_noise_free() -> MixedModel:
    """A velocity a = (v, s) whose position s moves without noise, and a known linear state."""

    def dynamics(a: Array, u: Array, t: float, dt: float, theta: Any) -> tuple[Any, Any, Any]:
        f = [theta.k * a[:, 0], a[:, 1] + 0.5 * a[:, 0], 0.0]
        return f, [[0.5], [0.0], [0.9]], np.diag([0.1, 0.0, 0.05])

    def measurement(a: Array, u: Array, t: float, theta: Any) -> tuple[Any, Any, Any]:
        return [a[:, 1]], [[0.0]], [[0.1]]

    def initial(theta: Any) -> tuple[Gaussian, Any, Any]:
        return Gaussian([0.0, 0.0], np.diag([1.0, 1.0])), [0.5], [[0.0]]

    return MixedModel(
        name="partly-noise-free",
        nonlinear={"v": "m/s", "s": "m"},
        linear={"z": "1"},
        outputs={"y": "m"},
        parameters=[Parameter("k", 0.8, bounds=(0.0, 1.0))],
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
    )


def random_walk(variance: float = 0.1) -> MixedModel:
    """A scalar random walk as a nonlinear state, measured; its level parameter is an offset of y."""

    def dynamics(a: Array, u: Array, t: float, dt: float, theta: Any) -> tuple[Any, Any, Any]:
        return a, np.zeros((1, 0)), [[variance]]

    def measurement(a: Array, u: Array, t: float, theta: Any) -> tuple[Any, Any, Any]:
        return [a[:, 0] + theta.c], np.zeros((1, 0)), [[theta.r]]

    def initial(theta: Any) -> tuple[Gaussian, Any, Any]:
        return Gaussian([0.0], [[1.0]]), [], np.zeros((0, 0))

    return MixedModel(
        name="random-walk",
        nonlinear={"a": "1"},
        outputs={"y": "1"},
        parameters=[Parameter("c", 0.0, bounds=(-1.0, 1.0)), Parameter("r", 0.2, bounds=(0.01, 5))],
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
    )
