"""A sensor that clips at both ends, while the middle of its record is far from the middle between them."""

import numpy as np
import pytest

import engine
from engine.diagnose import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.refits import starts
from engine.diagnose.search.pipeline import find_causes
from engine.estimation.quasi_ml import quasi_ml
from engine.filters.neighbours import Visited
from tests.engine.diagnose import clipped

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


NONE = np.zeros((1, 0))
TANK = engine.MixedModel(
    name="tank",
    dynamics=lambda a, u, t, dt, th: (
        [a[:, 0] + dt * (th.share * u[0] - u[1]) / th.area],
        NONE,
        [[th.q * dt]],
    ),
    measurement=lambda a, u, t, th: ([a[:, 0]], NONE, [[th.r]]),
    initial=lambda th: (engine.Gaussian([3.0], [[1.0]]), [], np.zeros((0, 0))),
    nonlinear={"level": "m"},
    linear={},
    inputs={"inflow": "m3/h", "demand": "m3/h"},
    outputs={"gauge": "m"},
    parameters=[
        engine.Parameter("share", 1.0, "1", (0.5, 2.0)),
        engine.Parameter("area", 50.0, "m2", (5.0, 500.0)),
        engine.Parameter("q", 1e-5, "m^2/h", (0.0, 1.0)),
        engine.Parameter("r", 1e-4, "m^2", (1e-10, 1.0)),
    ],
)


def gauged(seed, n=560, dt=0.25):
    """A tank that is filled between two levels, and a float that rests at 3.6 m."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) * dt
    demand = 30.0 + 15.0 * np.sin(2.0 * np.pi * t / 24.0)
    demand += np.interp(np.arange(n), np.arange(0, n + 8, 8), rng.uniform(-5, 5, n // 8 + 1))
    level, inflow, fills = np.full(n, 3.0), np.empty(n), True
    for k in range(n):
        fills = level[k] < 2.5 or (fills and level[k] < 3.8)
        inflow[k] = 55.0 if fills else 12.0
        if k + 1 < n:
            level[k + 1] = level[k] + dt * (1.05 * inflow[k] - demand[k]) / 48.0
            level[k + 1] += np.sqrt(1e-5 * dt) * rng.standard_normal()
    y = np.minimum(level + 0.01 * rng.standard_normal(n), 3.6)
    return engine.Series(y, np.column_stack([inflow, demand]), dt=dt, time_unit="h")


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_lowest_reading_is_no_second_limit(seed):
    found = find_causes(TANK, gauged(seed), effects=["saturation-sensor"], seed=1)
    assert [one.effect.name for one in found.search.named] == ["saturation-sensor:gauge"]
    theta = found.search.final.theta
    assert theta["saturation_sensor_gauge_side"] == 1.0
    assert theta["saturation_sensor_gauge_limit"] == pytest.approx(3.6, abs=0.01)


def test_the_search_of_a_clip_begins_with_all_that_is_beyond_the_extreme_reading(monkeypatch):
    """A nearly noise-free filter follows what clips, whose first-order size is a small part of it."""
    series = clipped.series()
    fit = quasi_ml(clipped.MODEL, series)
    setting = setting_for(clipped.MODEL, series, np.asarray(fit.theta))
    effect = make_effect("saturation-sensor:y", setting)
    tried = []

    def values(model, given, thetas, visited=None):
        tried.extend(thetas.tolist())
        return np.arange(len(thetas), dtype=float)

    monkeypatch.setattr(starts, "log_likelihoods", values)
    model, n = effect.apply(clipped.MODEL), len(fit.theta)
    start = np.array([*fit.theta, 0.02, *(p.default for p in effect.parameters[1:])])
    places = starts.places(effect, start, n)
    starts.best_start(model, series, places, start, n, None, Visited())
    at_ends = {(one[n], one[n + 1], one[n + 2]) for one in tried}
    assert {(1.0, series.y.max(), 1.0), (1.0, series.y.min(), -1.0)} <= at_ends
