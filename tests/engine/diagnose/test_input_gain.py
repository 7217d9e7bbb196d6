"""A gauge that reads an input wrongly: more rain falls on a catchment than is recorded."""

import numpy as np

import engine
from engine import Parameter

DAYS, SUBSTEPS, CAUGHT = (
    400,
    20,
    1.35,
)  # days, steps of the plant a day, rain that falls per recorded
K, POWER = 0.02, 1.5  # the store S mm lets K S^POWER mm/d go


def release(store):
    return K * np.maximum(store, 0.0) ** POWER


CATCHMENT = engine.continuous(
    name="catchment",
    drift=lambda a, u, t, theta: ([u[0] - theta.k * np.maximum(a[:, 0], 0.0) ** POWER], None),
    diffusion=lambda a, u, t, theta: [[theta.q]],
    measurement=lambda a, u, t, theta: (
        [theta.k * np.maximum(a[:, 0], 0.0) ** POWER],
        None,
        [[theta.r]],
    ),
    initial=lambda theta: (engine.Gaussian([30.0], [[25.0]]), [], np.zeros((0, 0))),
    nonlinear={"store": "mm"},
    inputs={"rain": "mm/d"},
    outputs={"flow": "mm/d"},
    parameters=[
        Parameter("k", 0.03, "1", (1e-4, 1.0)),
        Parameter("q", 1.0, "mm^2/d", (1e-6, 100.0)),
        Parameter("r", 0.1, "(mm/d)^2", (1e-6, 100.0)),
    ],
)


def record(seed, caught):
    """Readings of a catchment stepped by Euler's rule twenty times a day."""
    rng = np.random.default_rng(seed)
    rain = np.where(rng.random(DAYS) < 0.3, rng.gamma(0.8, 12.0, DAYS), 0.0)
    store, dt, flow = 30.0, 1.0 / SUBSTEPS, np.empty(DAYS)
    for day in range(DAYS):
        flow[day] = release(store)
        for _ in range(SUBSTEPS):
            store += dt * (caught * rain[day] - release(store))
            store += np.sqrt(0.5 * dt) * rng.standard_normal()
    y = flow + np.sqrt(0.02) * rng.standard_normal(DAYS)
    return engine.Series(y, u=rain, t=np.arange(DAYS, dtype=float), time_unit="d")


KINDS = [
    "input-gain",
    "input-offset",
    "path",
    "direct",
    "gain",
    "drag",
    "saturation",
    "linear",
    "bias",
]


def test_rain_that_is_more_than_recorded_is_a_gain_of_the_input():
    found = engine.diagnose(CATCHMENT, record(1, CAUGHT), effects=KINDS, seed=1)
    assert [cause.effect for cause in found.causes] == ["input-gain:rain"]
    assert abs(found.causes[0].parameters["input_gain_rain"] - (CAUGHT - 1.0)) < 0.08
    assert found.gain.adopt


def test_rain_that_is_what_was_recorded_is_left_alone():
    found = engine.diagnose(CATCHMENT, record(2, 1.0), effects=KINDS, seed=1)
    assert found.causes == ()
