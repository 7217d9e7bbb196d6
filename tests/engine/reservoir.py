"""A store that rain fills and that runs out faster the fuller it is: no model of ours, stepped by Euler."""

import numpy as np

import engine
from engine import Parameter

K, Q, POWER, SUBSTEPS = 0.02, 0.5, 1.5, 20  # the store S mm lets K S^POWER mm/d go


def outflow(store, k):
    return k * np.maximum(store, 0.0) ** POWER


RESERVOIR = engine.continuous(
    name="reservoir",
    drift=lambda a, u, t, theta: ([u[0] - outflow(a[:, 0], theta.k)], None),
    diffusion=lambda a, u, t, theta: [[theta.q]],
    measurement=lambda a, u, t, theta: ([outflow(a[:, 0], theta.k)], None, [[theta.r]]),
    initial=lambda theta: (engine.Gaussian([30.0], [[25.0]]), [], np.zeros((0, 0))),
    nonlinear={"store": "mm"},
    inputs={"rain": "mm/d"},
    outputs={"flow": "mm/d"},
    parameters=[
        Parameter("k", 0.03, "1", (1e-4, 1.0)),
        Parameter("q", 1.0, "mm^2/d", (1e-6, 100.0)),
        Parameter("r", 0.1, "(mm/d)^2", (1e-10, 100.0)),
    ],
)


def record(seed, days, r, caught=1.0):
    """Daily readings with noise of variance r, where ``caught`` times the recorded rain falls."""
    rng = np.random.default_rng(seed)
    rain = np.where(rng.random(days) < 0.3, rng.gamma(0.8, 12.0, days), 0.0)
    store, dt, flow = 30.0, 1.0 / SUBSTEPS, np.empty(days)
    for day in range(days):
        flow[day] = outflow(store, K)
        for _ in range(SUBSTEPS):
            store += dt * (caught * rain[day] - outflow(store, K))
            store += np.sqrt(Q * dt) * rng.standard_normal()
    y = flow + np.sqrt(r) * rng.standard_normal(days)
    return engine.Series(y, u=rain, t=np.arange(days, dtype=float), time_unit="d")
