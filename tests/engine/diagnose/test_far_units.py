"""Effects of a nonlinear plant are tried in any unit: none is lost as its size is far from 1."""

import numpy as np
import pytest

import engine
from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.free_run.answer import best_runs
from engine.diagnose.free_run.missing_function import _Push
from engine.diagnose.free_run_fits.columns import columns, run_of
from engine.diagnose.screening.score_columns import effect_columns
from engine.filters.sigma_point import moment_path
from tests.engine.other_units import Units
from tests.engine.plain_models import tank

KINDS = ["drag", "cubic", "quadratic", "force"]
VESSEL = engine.continuous(
    name="vessel",
    drift=lambda a, u, t, th: (
        [th.pump * u[0] - th.outlet * np.sqrt(np.maximum(a[:, 0], 0.0))],
        np.zeros((1, 0)),
    ),
    diffusion=lambda a, u, t, th: [[1e-3]],
    measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[1e-3]]),
    initial=lambda th: (engine.Gaussian([3.0], [[0.2]]), [], np.zeros((0, 0))),
    nonlinear={"level": "m"},
    inputs={"pump": "V"},
    outputs={"y": "m"},
    parameters=tank().parameters,
)


def told(power):
    """The vessel with levels in 2^-power m, its record, and what effects are made for."""
    u = np.repeat(np.random.default_rng(1).uniform(1.0, 3.5, 12), 10)
    series = engine.simulate(VESSEL, None, 120, np.random.default_rng(1), u=u, dt=1.0).series
    unit = np.exp2([power])
    units = Units(unit, unit, np.ones(1), 1.0, np.exp2([power, 0.5 * power]))
    model, series = units.model(VESSEL), units.series(series)
    return model, series, setting_for(model, series, np.asarray(model.theta()))


def screened(power):
    """The score of each effect, as a number of standard deviations."""
    model, series, setting = told(power)
    theta = np.asarray(model.theta())
    path = moment_path(model, theta, series)
    found = {
        e.name: effect_columns(e, model, theta, series, path) for e in all_effects(setting, KINDS)
    }
    return {name: [c.s.sum() / np.linalg.norm(c.v) for _, c in own] for name, own in found.items()}


def in_the_run(power):
    """How much of the free run's error each effect is like, and a force that grows with time."""
    model, series, setting = told(power)
    fit = best_runs(model, [series], [model.theta()], model.parameter_names, 1, lambda *told: None)
    found = {c.effect.name: c.g for c in columns(fit, all_effects(setting, KINDS))}
    runs = [run_of(model, np.asarray(fit.theta), series, fit.x1[0])]
    push = _Push(fit, setting, "level", runs)
    found["ramp"] = push.columns([np.linspace(0.0, 1.0, len(series))[:, None]])[:, 0]
    return {
        name: g @ fit.e / np.linalg.norm(g) / np.linalg.norm(fit.e) for name, g in found.items()
    }


@pytest.mark.long
@pytest.mark.parametrize("power", [-30.0, 10.0, 20.0])
@pytest.mark.parametrize("asked", [screened, in_the_run])
def test_effects_are_seen_alike_in_any_unit(asked, power):
    """A vessel pushed by the first size that came to mind ran away, and the effect was left out."""
    here, there = asked(0.0), asked(power)
    assert {"drag:level", "cubic:level", "quadratic:level", "force:level"} <= set(here)
    assert set(there) == set(here)
    for name, value in here.items():
        assert there[name] == pytest.approx(value, abs=1e-3), name
