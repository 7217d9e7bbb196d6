"""Readings whose noise grows with what they read, of a model all of whose states are linear."""

import numpy as np
import pytest

import engine
from engine.diagnose.search.pipeline import find_causes

PLASMA = engine.continuous(
    name="plasma",
    drift=lambda a, u, t, theta: ([u[0]], [[-theta.k]]),
    diffusion=lambda a, u, t, theta: [[1e-6]],
    measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r]]),
    initial=lambda theta: (None, [0.0], [[1e-4]]),
    linear={"level": "mg/L"},
    inputs={"dose": "mg/L/h"},
    outputs={"conc": "mg/L"},
    parameters=[
        engine.Parameter("k", 0.3, "1/h", (0.01, 5.0)),
        engine.Parameter("r", 0.02, "(mg/L)^2", (1e-6, 10.0)),
    ],
)


@pytest.mark.long
def test_noise_may_grow_with_a_linear_state_that_is_read():
    """An assay's error in percent of what it reads: there was no effect for it, and the answer was nothing."""
    rng = np.random.default_rng(2)
    u = np.repeat(rng.uniform(0.0, 6.0, 12), 15)
    clean = engine.simulate(PLASMA, {"r": 1e-6}, len(u), rng, u=u, dt=0.25).series
    level = clean.y[:, 0]
    y = level + 0.05 * np.exp(0.1 * level) * rng.standard_normal(len(u))
    kinds = ["variance:conc->level", "variance:conc->dose", "level:conc"]
    found = find_causes(PLASMA, clean.replace(y=y[:, None]), effects=kinds, seed=1)
    assert [one.effect.name for one in found.search.named] == ["variance:conc->level"]
    theta = found.search.final.theta
    growth = 0.5 * theta["variance_conc_level"] / theta["variance_conc_level_per"]
    assert 0.07 < growth < 0.13
