"""Two solutions that explain the data alike: one is estimated, the other is told."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from tests.engine.plain_models import absorption


@pytest.fixture(scope="module")
def measured():
    truth = {"ka": 0.35, "ke": 1.2, "V": 12.0}
    return engine.simulate(absorption(), truth, 40, np.random.default_rng(0), dt=0.5).series


@pytest.fixture(scope="module")
def fit(measured):
    return engine.rbps_em(absorption(), measured, seed=1)


@pytest.mark.long
def test_the_maximum_with_the_rates_in_each_others_place_is_told(fit):
    said = fit.message
    ka, ke, V = fit.theta
    assert "another maximum" in said
    there = said.split("another maximum, at ")[1].split(", whose")[0]
    other = dict(part.split(" = ") for part in there.split(", "))
    numbers = [float(other[name]) for name in ("ka", "ke", "V")]
    np.testing.assert_allclose(numbers, [ke, ka, V * ke / ka], rtol=0.05)
    assert "the same by the moment filter" in said or "lower by" in said or "higher by" in said


@pytest.mark.long
def test_a_run_that_went_on_says_the_same(measured, fit):
    part = engine.rbps_em(absorption(), measured, seed=1, callback=lambda it: it.k == 3)
    again = engine.rbps_em(absorption(), measured, seed=1, resume=part)
    np.testing.assert_array_equal(again.theta, fit.theta)
    assert again.message == fit.message


def test_bounds_that_leave_out_the_other_end_the_remark(measured, fit):
    ka, ke, _ = fit.theta
    between = 0.5 * (ka + ke)
    model = absorption()
    taken, cleared, volume = model.parameters
    faster, slower = (between, 10.0), (0.01, between)
    if ka < ke:
        faster, slower = slower, faster
    bounds = [
        replace(taken, bounds=faster, default=ka),
        replace(cleared, bounds=slower, default=ke),
        volume,
    ]
    bounded = engine.rbps_em(replace(model, parameters=bounds), measured, seed=1)
    np.testing.assert_allclose(bounded.theta[:2], [ka, ke], rtol=0.01)
    assert "another maximum" not in bounded.message


@pytest.mark.long
def test_a_model_with_one_maximum_has_no_remark():
    model = engine.get_model("local-level")
    series = engine.simulate(model, None, 200, np.random.default_rng(3)).series
    assert "another maximum" not in engine.rbps_em(model, series, n_iterations=5, seed=1).message


@pytest.mark.long
def test_points_of_one_ridge_are_not_told_twice():
    """Gain and offset of an input that acts through their product alone: the ridge was "another maximum"."""
    model = engine.MixedModel(
        name="product",
        dynamics=lambda a, u, t, dt, th: ([0.0], [[0.7]], [[0.1]]),
        measurement=lambda a, u, t, th: ([th.gain * th.share * u[0]], [[1.0]], [[th.r]]),
        initial=lambda th: (None, [0.0], [[1.0]]),
        linear={"x": ""},
        inputs={"u": ""},
        outputs={"y": ""},
        parameters=[
            engine.Parameter("gain", 1.0, "", (0.0, 100.0)),
            engine.Parameter("share", 1.0, "", (0.0, 100.0)),
            engine.Parameter("r", 0.1, "", (1e-9, 10.0)),
        ],
    )
    u = np.random.default_rng(0).standard_normal(100)
    truth = {"gain": 2.0, "share": 3.0, "r": 0.3}
    series = engine.simulate(model, truth, 100, np.random.default_rng(3), u=u).series
    said = engine.rbps_em(model, series, seed=0).message
    assert "Only determined together, keep one of them fixed: gain, share." in said
    assert "another maximum" not in said
