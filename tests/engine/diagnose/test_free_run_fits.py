"""Refits of the second criterion."""

import numpy as np
import pytest

from engine.data.series import Series
from engine.diagnose.free_run.windows import stretch
from engine.diagnose.free_run_fits.fitted import finished, fit_runs
from engine.diagnose.free_run_fits.folds import folds_of
from engine.models.registry import get_model
from engine.simulation.free_run import free_run


def test_a_refit_that_was_left_early_is_followed_to_its_end():
    model = get_model("oscillator")
    u = np.sign(np.sin(0.7 * np.arange(300.0)))
    told = {"omega": 6.0, "zeta": 0.05, "gain": 1.0}
    y = free_run(model, told, Series(np.full(300, np.nan), u, dt=0.05)).y
    record = Series(y, u, dt=0.05)
    start = model.theta({"omega": 4.0, "zeta": 0.4, "gain": 0.3})
    left = fit_runs(model, [record], start, ("omega", "zeta", "gain"), np.zeros((1, 2)), best=1e-12)
    assert not left.ended
    whole = finished(left)
    assert whole.ended
    assert whole.cost < 1e-3 * left.cost
    np.testing.assert_allclose([whole.theta[name] for name in told], list(told.values()), rtol=1e-3)
    assert finished(whole) is whole


@pytest.mark.filterwarnings("error")
def test_an_output_that_was_never_measured_is_no_trouble():
    """Neither to folds, which are those without it, nor to what says where a record moves most."""
    rng = np.random.default_rng(0)
    y = rng.standard_normal((400, 1))
    both = Series(np.hstack([y, np.full_like(y, np.nan)]), y, dt=0.1)
    alone = Series(y, y, dt=0.1)
    assert folds_of([both]).fold.tolist() == folds_of([alone]).fold.tolist()
    assert stretch(both, 100, 50) == stretch(alone, 100, 50)
