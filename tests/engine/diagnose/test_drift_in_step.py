"""A parameter of differential equations drifts within a step, too."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import engine
from engine.diagnose import extend

COOLER = engine.continuous(
    name="cooler",
    drift=lambda a, u, t, theta: ([theta.k * u[0]], [[-theta.k]]),
    diffusion=lambda a, u, t, theta: [[1e-10]],
    measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[1e-8]]),
    initial=lambda theta: (None, [0.0], [[1e-4]]),
    linear={"warmth": "degF"},
    inputs={"around": "degF"},
    outputs={"y": "degF"},
    parameters=[engine.Parameter("k", 0.4, "1/min", (0.0, 10.0))],
)


def test_a_drift_is_that_of_the_middle_of_a_step():
    """Taken at its beginning it made the parameter half a step's drift too small, several standard errors."""
    rng = np.random.default_rng(1)
    around, dt = np.repeat(rng.uniform(0.0, 10.0, 20), 5), 0.5
    x = [0.0]
    for i, here in enumerate(around[:-1]):
        rates = lambda t, x, i=i, here=here: (0.6 - 0.008 * (i * dt + t)) * (here - x)  # noqa: E731
        x.append(solve_ivp(rates, (0.0, dt), [x[-1]], rtol=1e-10, atol=1e-12).y[0, -1])
    series = engine.Series(x, u=around, dt=dt, time_unit="min")
    drifting = extend(COOLER, ["parameter-drift:k"])
    begun = {"k": 0.4, "parameter_drift_k": -0.3, "parameter_drift_k_middle": 25.0}
    start = {**begun, "parameter_drift_k_per": 50.0}
    found = engine.fit_simulation(drifting, series, start, free=["k", "parameter_drift_k"]).theta
    assert found["k"] == pytest.approx(0.4, abs=2e-4)  # 2e-3 is half a step's drift
    assert found["parameter_drift_k"] == pytest.approx(-0.4, abs=2e-3)
