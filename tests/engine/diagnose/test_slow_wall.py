"""A lag of many samples shows as a plain damping, and is refitted where that leads."""

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

import engine
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.refits.refitting import refit_best
from engine.diagnose.screening.screening import screen_effects
from engine.estimation.quasi_ml import quasi_ml

ROOM = engine.continuous(
    name="room",
    drift=lambda a, u, t, theta: ([theta.g * u[0] + theta.k * u[1]], [[-theta.k]]),
    diffusion=lambda a, u, t, theta: [[theta.q]],
    measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r]]),
    initial=lambda theta: (None, [18.0], [[9.0]]),
    linear={"T": "degC"},
    inputs={"heat": "kW", "outside": "degC"},
    outputs={"y": "degC"},
    parameters=[
        engine.Parameter("g", 0.02, "degC/min/kW", (0.0, 1.0)),
        engine.Parameter("k", 0.02, "1/min", (0.0, 1.0)),
        engine.Parameter("q", 1e-3, "degC^2/min", (1e-8, 1.0)),
        engine.Parameter("r", 0.01, "degC^2", (1e-4, 4.0)),
    ],
)


@pytest.mark.long
def test_a_slow_wall_is_refitted_where_it_looks_like_damping(monkeypatch):
    """Its screen, with time constants of 30 samples at most, was behind a dozen others, and it gains most."""
    n, dt, fine = 600, 5.0, 10
    rng = np.random.default_rng(3)
    t = dt * np.arange(n)
    heat = np.repeat(rng.uniform(0.0, 20.0, n // 20), 20)
    outside = 8.0 + 5.0 * np.sin(2.0 * np.pi * t / 1440.0)
    T, wall, y = 18.0, 17.0, []
    for k in range(n):
        y.append(T + 0.05 * rng.standard_normal())
        for _ in range(fine):
            rate = 0.024 * heat[k] - 0.012 * (T - outside[k]) - 0.012 * (T - wall)
            wall += dt / fine * (T - wall) / 650.0
            T += dt / fine * rate + 0.01 * np.sqrt(dt / fine) * rng.standard_normal()
    series = engine.Series(y, u=np.column_stack([heat, outside]), dt=dt, time_unit="min")
    fit = quasi_ml(ROOM, series)
    setting = setting_for(ROOM, series, np.asarray(fit.theta))
    kinds = ["extra-input", "quadratic", "linear", "pole", "force"]
    seen = screen_effects(fit, series, setting, kinds, 0.05, 1, lambda *_: None)
    scores = [replace(s, statistic=1.0) if s.effect.kind == "pole" else s for s in seen.scores]
    seen = replace(seen, scores=tuple(scores))
    monkeypatch.setattr(import_module("engine.diagnose.refits.refitting"), "REFITS", 3)
    found = refit_best(fit, series, seen, setting, [], lambda *_: None)
    assert found.refits[0].effect.name == "pole:T"
    assert found.refits[0].fit.theta["pole_T_time"] == pytest.approx(650.0, rel=0.3)
    damping = next(r for r in found.refits if r.effect.name == "linear:T")
    assert found.refits[0].gain > damping.gain + 50.0
