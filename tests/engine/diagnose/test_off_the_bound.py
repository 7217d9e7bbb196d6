"""A mass that grows, of which only the ratio to a force shows, and that may be so large: its size is told."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

import engine
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.kinds.parameters import stopped_share
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.refits.stopped import off_the_bound
from engine.estimation.quasi_ml import quasi_ml
from engine.estimation.tied_edges import off_tied_edges
from tests.engine.estimation.test_tied_edges import cart

GROWN = 1.25  # the mass of the second half beside that of the first


def record(seed: int) -> engine.Series:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-10.0, 10.0, 20), 10)
    v, y = 0.0, np.zeros(200)
    for t in range(200):
        y[t] = v + 0.1 * rng.standard_normal()
        mass = 1.4 * (GROWN if t >= 100 else 1.0)
        v += 0.1 * (0.3 * u[t] - 0.7 * v) / mass + 0.01 * rng.standard_normal()
    return engine.Series(y[:, None], u=u, dt=0.1)


@pytest.mark.long
@pytest.mark.parametrize(("unit", "seed"), [(1.0, 1), (1e-3, 2)])
def test_a_step_that_its_bound_cuts_is_told_where_no_bound_does(unit, seed):
    model, series = cart(unit), record(seed)
    effect = make_effect("parameter-step:mass", setting_for(model, series, model.theta()))
    extended = effect.apply(model)
    base = off_tied_edges(quasi_ml(model, series), series, model.theta())
    high = {"gain": 0.57, "drag": 1.33, "mass": 2.66 / unit}
    step = {"parameter_step_mass": 1.5 / unit, "parameter_step_mass_time": 10.0}
    free = [*base.free, "parameter_step_mass"]
    climb = partial(quasi_ml, extended, series, free=free)
    found = climb({**base.theta.asdict(), **high, **step})
    assert stopped_share(effect, extended, found.theta, series) > 0.0
    assert found.standard_errors[-1] == np.inf

    told = off_the_bound(base, found, effect, series, climb)
    assert stopped_share(effect, extended, told.theta, series) == 0.0
    assert told.log_likelihood >= found.log_likelihood - 0.5
    assert told.free == found.free
    share = told.theta["parameter_step_mass"] / told.theta["mass"]
    assert share == pytest.approx(GROWN - 1.0, abs=0.1)
    known = told.holding(["mass"])
    assert np.isfinite(known.standard_errors).all()
    assert off_the_bound(base, told, effect, series, climb) is told


@pytest.mark.long
def test_one_that_the_data_put_beyond_a_bound_stays_there():
    model, series = cart(limit=1.5), record(1)
    effect = make_effect("parameter-step:mass", setting_for(model, series, model.theta()))
    extended = effect.apply(model)
    free = ["drag", "mass", "q", "r"]
    known = {"gain": 0.3}
    base = quasi_ml(model, series, known, free)
    start = {**known, "parameter_step_mass": 0.5, "parameter_step_mass_time": 10.0}
    climb = partial(quasi_ml, extended, series, free=[*free, "parameter_step_mass"])
    found = climb({**base.theta.asdict(), **start})
    assert stopped_share(effect, extended, found.theta, series) > 0.0
    assert off_the_bound(base, found, effect, series, climb) is found
