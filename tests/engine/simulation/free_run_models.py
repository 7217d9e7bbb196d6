"""Small models whose free runs are easy, stiff, chaotic or unstable."""

from __future__ import annotations

import numpy as np

from engine.statespace.model import Gaussian, MixedModel, Parameter

NONE = np.zeros(0), np.zeros((0, 0))


def small_model(name, states, first, f, parameters, inputs=()):
    """x' = f(x, u, dt, theta) without linear states; the first state is measured."""
    n = len(states)
    return MixedModel(
        name=name,
        dynamics=lambda a, u, t, dt, th: (
            f(a.T, u, dt, th),
            np.zeros((n, 0)),
            1e-4 * np.eye(n),
        ),
        measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[0.01]]),
        initial=lambda th: (Gaussian(first, 0.01 * np.eye(n)), *NONE),
        nonlinear=dict.fromkeys(states, "1"),
        inputs=dict.fromkeys(inputs, "1"),
        outputs={"y": "1"},
        parameters=[Parameter(k, value) for k, value in parameters.items()],
    )


def pendulum():
    """Damped, driven by u: converges."""

    def f(x, u, dt, th):
        return [
            x[0] + dt * x[1],
            x[1] + dt * (0.2 * u[0] - th.k * np.sin(x[0]) - th.d * x[1]),
        ]

    return small_model(
        "pendulum", ("angle", "rate"), [0.1, 0.0], f, {"k": 2.0, "d": 0.8}, ("moment",)
    )


def van_der_pol(mu=5.0):
    """Relaxation oscillations."""

    def f(x, u, dt, th):
        return [x[0] + dt * x[1], x[1] + dt * (th.mu * (1.0 - x[0] ** 2) * x[1] - x[0] + u[0])]

    return small_model("van-der-pol", ("x", "v"), [2.0, 0.0], f, {"mu": mu}, ("force",))


def lorenz():
    """Chaos in three states."""

    def f(x, u, dt, th):
        a, b, c = x
        return [
            a + dt * 10.0 * (b - a),
            b + dt * (a * (th.r - c) - b),
            c + dt * (a * b - 8.0 / 3.0 * c),
        ]

    return small_model("lorenz", ("a", "b", "c"), [1.0, 1.0, 20.0], f, {"r": 28.0})


def logistic(r=3.9):
    """Chaos in one state, errors doubled at every step."""
    return small_model(
        "logistic", ("x",), [0.3], lambda x, u, dt, th: [th.r * x[0] * (1.0 - x[0])], {"r": r}
    )


def unstable(k):
    """Grows by the factor k a step, slightly nonlinear."""
    return small_model(
        "unstable",
        ("x",),
        [0.3],
        lambda x, u, dt, th: [th.k * x[0] + 0.01 * np.sin(x[0])],
        {"k": k},
    )
