"""A small model that tests of the design use, in whatever units."""

from __future__ import annotations

import numpy as np

from engine.statespace.model import Gaussian, MixedModel, Parameter

VARIANCE = {  # of a noise parameter, and the parameter of a standard deviation
    "deviation": (lambda p: p**2, lambda s: s),
    "variance": (lambda p: p, lambda s: s**2),
    "logarithm": (np.exp, lambda s: 2.0 * np.log(s)),
}


def drive(length=1.0, volt=1.0, second=1.0, q=0.05, r=0.05, noise="deviation", first=0.1):
    """v' = k u - b v with process noise; so many units ``length`` make a metre, ``volt`` a volt, ...

    ``noise`` is what its parameters q and r are of it; ``first`` the deviation of the first state, in m/s.
    """
    variance, parameter = VARIANCE[noise]

    def dynamics(a, u, t, dt, th):
        ahead = a[:, 0] + dt * (th.k * u[0] - th.b * a[:, 0])
        return [ahead], np.zeros((1, 0)), [[dt * variance(th.q)]]

    speed = length / second
    least = parameter(1e-9) if noise == "logarithm" else 0.0
    return MixedModel(
        name="drive",
        dynamics=dynamics,
        measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[variance(th.r)]]),
        initial=lambda th: (Gaussian([0.0], [[(first * speed) ** 2]]), [], np.zeros((0, 0))),
        nonlinear={"velocity": "m/s"},
        inputs={"voltage": "V"},
        outputs={"tacho": "m/s"},
        reference={"velocity": 0.0, "voltage": 0.0},
        parameters=[
            Parameter("k", 0.5 * speed / second / volt, "m/s^2/V", (0.0, np.inf)),
            Parameter("b", 1.0 / second, "1/s", (0.0, np.inf)),
            Parameter("q", parameter(q * speed / second**0.5), "m/s^1.5", (least, np.inf)),
            Parameter("r", parameter(r * speed), "m/s", (least, np.inf)),
        ],
    )


BOUNDS = {"inputs": {"voltage": [-6.0, 6.0]}, "dt": 0.1}
CAUSES = {"drag:velocity": 0.25, "coulomb:velocity": 0.5}
