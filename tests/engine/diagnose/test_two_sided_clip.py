"""A sensor that clips at both ends, while the middle of its record is far from the middle between them."""

import numpy as np
import pytest

import engine
from engine.diagnose.search.pipeline import find_causes

AMPLIFIER = engine.continuous(
    name="amplifier",
    drift=lambda a, u, t, theta: ([u[0] / theta.tau], [[-1.0 / theta.tau]]),
    diffusion=lambda a, u, t, theta: [[theta.q]],
    measurement=lambda a, u, t, theta: (
        [0.0, 0.0],
        [[1.0], [-theta.G]],
        np.diag([1.6e-5, theta.ro]),
    ),
    initial=lambda theta: (None, [0.0], [[0.01]]),
    nonlinear={},
    linear={"x": "V"},
    inputs={"vin": "V"},
    outputs={"vx": "V", "vout": "V"},
    parameters=[
        engine.Parameter("tau", 1.0, "ms", (0.05, 20.0)),
        engine.Parameter("G", 9.4, "1", (1.0, 100.0)),
        engine.Parameter("q", 1e-7, "V^2/ms", (1e-10, 1.0)),
        engine.Parameter("ro", 9e-4, "V^2", (1e-8, 1.0)),
    ],
)


@pytest.mark.long
def test_both_limits_are_found_where_the_record_is_mostly_near_one_of_them():
    """Mirrored about the record's median the other limit is out of reach, and rectification stood in for it."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(-0.9, 1.0, 20), 15)
    whole = engine.simulate(AMPLIFIER, {}, 300, rng, u=u, dt=0.1).series
    series = whole.replace(y=np.column_stack([whole.y[:, 0], np.clip(whole.y[:, 1], -5.0, 5.0)]))
    kinds = ["saturation-sensor", "rectification"]
    found = find_causes(AMPLIFIER, series, effects=kinds, seed=1)
    assert [one.effect.name for one in found.search.named] == ["saturation-sensor:vout"]
    theta = found.search.final.theta
    assert theta["saturation_sensor_vout_side"] == 0.0
    zero = theta["saturation_sensor_vout_zero"]
    half = abs(theta["saturation_sensor_vout_limit"] - zero)
    assert np.allclose([zero - half, zero + half], [-5.0, 5.0], atol=0.05)
