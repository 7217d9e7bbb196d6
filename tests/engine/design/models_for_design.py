"""A small model that tests of the design use, in whatever units."""

from __future__ import annotations

import numpy as np

from engine.statespace.model import Gaussian, MixedModel, Parameter


def drive(length=1.0, volt=1.0, second=1.0, q=0.05, r=0.05):
    """v' = k u - b v with process noise; so many units ``length`` make a metre, ``volt`` a volt, ..."""

    def dynamics(a, u, t, dt, th):
        return [a[:, 0] + dt * (th.k * u[0] - th.b * a[:, 0])], np.zeros((1, 0)), [[dt * th.q**2]]

    speed = length / second
    return MixedModel(
        name="drive",
        dynamics=dynamics,
        measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[th.r**2]]),
        initial=lambda th: (Gaussian([0.0], [[(0.1 * speed) ** 2]]), [], np.zeros((0, 0))),
        nonlinear={"velocity": "m/s"},
        inputs={"voltage": "V"},
        outputs={"tacho": "m/s"},
        reference={"velocity": 0.0, "voltage": 0.0},
        parameters=[
            Parameter("k", 0.5 * speed / second / volt, "m/s^2/V", (0.0, np.inf)),
            Parameter("b", 1.0 / second, "1/s", (0.0, np.inf)),
            Parameter("q", q * speed / second**0.5, "m/s^1.5", (0.0, np.inf)),
            Parameter("r", r * speed, "m/s", (1e-9, np.inf)),
        ],
    )


BOUNDS = {"inputs": {"voltage": [-6.0, 6.0]}, "dt": 0.1}
CAUSES = {"drag:velocity": 0.25, "coulomb:velocity": 0.5}
