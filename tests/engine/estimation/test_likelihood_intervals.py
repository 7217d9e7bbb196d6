"""Intervals by the likelihood ratio, against exact profile likelihoods."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import chi2

import engine
from engine.estimation.quasi_ml import quasi_ml
from engine.estimation.uncertainty.likelihood import ends
from tests.studies import scalar_linear

FALL = 0.5 * chi2.ppf(0.95, 1)


@pytest.fixture(scope="module")
def linear():
    model = engine.get_model("linear-2")
    series = engine.simulate(model, None, 200, np.random.default_rng(3)).series
    return model, series, quasi_ml(model, series, {"theta": 0.15})


def exact_ends(model, series, top, low, high):
    def above(theta):
        return engine.kalman_smoother(model, {"theta": theta}, series).log_likelihood - top + FALL

    return [brentq(above, low, top_at, xtol=1e-6) for low, top_at in (low, high)]


@pytest.mark.long
def test_exact_interval_is_where_the_likelihood_has_fallen(linear):
    model, series, best = linear
    at = best.theta["theta"]
    found = engine.likelihood_intervals(model, best.theta, series, exact=True)
    expected = exact_ends(model, series, best.log_likelihood, (0.0, at), (at + 0.3, at))
    width = expected[1] - expected[0]
    np.testing.assert_allclose(found.values[0], expected, atol=0.01 * width)
    assert (found.errors == 0.0).all()
    assert found.maximum[0] == pytest.approx(at, abs=0.01 * width)


@pytest.mark.slow
def test_interval_is_not_moved_by_an_estimate_short_of_the_maximum(linear):
    model, series, best = linear
    arrived = engine.likelihood_intervals(model, best.theta, series, exact=True)
    estimated = engine.rts_em(model, series, free=["theta"])
    of_result = engine.likelihood_intervals(model, estimated, series, exact=True)
    np.testing.assert_allclose(of_result.values, arrived.values, atol=1e-3)
    short = engine.likelihood_intervals(
        model, {"theta": best.theta["theta"] + 0.02}, series, exact=True
    )
    width = np.ptp(arrived.values[0])
    np.testing.assert_allclose(short.values[0], arrived.values[0], atol=0.02 * width)
    assert short.maximum[0] == pytest.approx(arrived.maximum[0], abs=0.02 * width)


@pytest.mark.slow
def test_particles_give_the_exact_interval_within_their_stated_error(linear):
    model, series, best = linear
    exact = engine.likelihood_intervals(model, best.theta, series, exact=True)
    found = engine.likelihood_intervals(model, best.theta, series, seed=5)
    assert (found.errors[0] > 0.0).all()
    width = np.ptp(exact.values[0])
    off = np.abs(found.values[0] - exact.values[0])
    assert (off < 5.0 * found.errors[0] + 0.02 * width).all()
    assert off.max() < 0.08 * width


ALL = list(scalar_linear.MODEL.parameter_names)


@pytest.mark.slow
@pytest.mark.parametrize("free", [ALL[:2], pytest.param(ALL, marks=pytest.mark.slow)])
def test_other_parameters_are_maximised_over(free):
    model = scalar_linear.MODEL
    series = engine.simulate(model, None, 150, np.random.default_rng(1)).series
    best = quasi_ml(model, series, free=free)
    told = []
    found = engine.likelihood_intervals(
        model, best.theta, series, free, exact=True, callback=told.append
    )
    assert told == free
    for name in free:
        others = [other for other in free if other != name]
        for end in found.values[model.index(name)]:
            theta = {**best.theta.asdict(), name: end}
            profile = quasi_ml(model, series, theta, others).log_likelihood
            assert profile - best.log_likelihood == pytest.approx(-FALL, abs=0.12)


@pytest.mark.long
def test_confidence_widens_and_wrong_ones_are_refused(linear):
    model, series, best = linear
    errors = engine.standard_errors(model, best.theta, series, exact=True)
    widths = [
        np.ptp(
            engine.likelihood_intervals(
                model, best.theta, series, level=level, errors=errors, exact=True
            ).values
        )
        for level in (0.68, 0.95)
    ]
    assert 1.7 < widths[1] / widths[0] < 2.5
    with pytest.raises(engine.OptionError, match="level"):
        engine.likelihood_intervals(model, best.theta, series, level=1.0, errors=errors)


def test_ends_of_a_parabola_and_of_a_curve_that_never_falls():
    at = np.linspace(-3.0, 3.0, 7)
    (low, high), top = ends(at, 0.5 - at, 0.0, 2.0, (-10.0, 10.0))
    assert (low, high, top) == pytest.approx((-1.5, 2.5, 0.5), abs=0.02)
    (low, high), _ = ends(at, np.minimum(0.5 - at, 0.0) - 1e-3, 0.0, 2.0, (-10.0, np.inf))
    assert low == -10.0
    assert high < 3.0


@pytest.mark.long
def test_a_parameter_that_is_held_has_no_interval():
    model = scalar_linear.MODEL
    series = engine.simulate(model, None, 60, np.random.default_rng(2)).series
    best = quasi_ml(model, series, free=["a"])
    found = engine.likelihood_intervals(model, best.theta, series, ["a"], exact=True)
    assert np.isfinite(found.values[0]).all()
    assert np.isnan(found.values[1:]).all()
    assert "95 % from" in found._repr_html_()
