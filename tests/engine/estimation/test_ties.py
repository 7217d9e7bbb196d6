"""Parameters that data only determine together have no standard errors of their own, and this is said."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

import engine
from engine import Gaussian, MixedModel, Parameter, Series
from engine.errors import ModelError, NotSettledWarning
from engine.estimation.quasi_ml import quasi_ml
from engine.ties import Ties, flat_directions, tied, ties_in_words, to_hold

SAID = "Only determined together, keep one of them fixed: b1, b2."
FEW = {"n_particles": 20, "n_trajectories": 20}


def first_order(dynamics, parameters, inputs=("u",), seen=lambda x, th: x):
    """x' by ``dynamics`` (x, u, th), which returns its mean and the variance of its noise."""

    def step(a, u, t, dt, th):
        mean, q = dynamics(a[:, 0], u, th)
        return [mean], np.zeros((1, 0)), [[q]]

    return MixedModel(
        name="first-order",
        dynamics=step,
        measurement=lambda a, u, t, th: ([seen(a[:, 0], th)], np.zeros((1, 0)), [[0.01]]),
        initial=lambda th: (Gaussian([0.0], [[1e-12]]), [], np.zeros((0, 0))),
        nonlinear={"x": ""},
        inputs=dict.fromkeys(inputs, ""),
        outputs={"y": ""},
        parameters=parameters,
    )


def record(model, T=120, seed=0, apart=1.0):
    """Simulated, driven by steps; a second input is the first and ``apart`` times others."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, (T // 10, len(model.inputs))), 10, axis=0)
    u[:, 1:] = u[:, :1] + apart * u[:, 1:]
    return engine.simulate(model, None, T, rng, u=u, dt=1.0).series


PRODUCT = first_order(
    lambda x, u, th: (th.p * x + th.b1 * th.b2 * u[0], th.q),
    [
        Parameter("p", 0.8, "", (-1.0, 1.0)),
        Parameter("b1", 0.8, "", (0.0, 5.0)),
        Parameter("b2", 0.5, "", (0.0, 5.0)),
        Parameter("q", 0.0025, "", (1e-6, 1.0)),
    ],
)
ALONE = ["p", "b1", "q"]
SERIES = record(PRODUCT)

# c x is seen: another unit of x is another c, b and q, though no function has only their product
UNIT = first_order(
    lambda x, u, th: (0.8 * x + th.b * u[0], th.q),
    [
        Parameter(name, value, "", (1e-6, 9.0))
        for name, value in (("b", 0.5), ("c", 0.8), ("q", 0.01))
    ],
    seen=lambda x, th: np.tanh(th.c * x),
)

# what the readings vary by, which does not correlate with them
VOLATILITY = MixedModel(
    name="volatility",
    dynamics=lambda a, u, t, dt, th: (
        [th.mu + th.phi * (a[:, 0] - th.mu)],
        np.zeros((1, 0)),
        [[0.06]],
    ),
    measurement=lambda a, u, t, th: ([0.0], np.zeros((1, 0)), np.exp(a[:, 0])[:, None, None]),
    initial=lambda th: (Gaussian([th.mu], [[0.06 / (1.0 - th.phi**2)]]), [], np.zeros((0, 0))),
    nonlinear={"h": ""},
    outputs={"y": ""},
    parameters=[Parameter("phi", 0.9, "", (-1.0, 1.0)), Parameter("mu", -1.0, "", (-9.0, 9.0))],
)


@pytest.fixture(scope="module")
def best():
    return quasi_ml(PRODUCT, SERIES)


# a seed whose draws leave the errors known well enough that nothing is said of it
CALM = {"replicates": 2, "seed": 1, **FEW}


@pytest.mark.long
@pytest.mark.parametrize("options", [{"exact": True}, FEW, CALM])
def test_factors_of_a_product_have_no_errors_of_their_own(options, best):
    found = engine.standard_errors(PRODUCT, best.theta, SERIES, **options)
    assert found.tied == ("b1", "b2")
    assert found.settled
    assert found.warning == SAID
    assert np.isinf(found.values[[1, 2]]).all()
    assert np.isinf(found.interval()[[1, 2]]).all()
    for text in (str(found), found._repr_html_()):
        assert text.count("tied to others") == 2
        assert SAID in text
    alone = engine.standard_errors(PRODUCT, best.theta, SERIES, ALONE, **options)
    assert (alone.tied, alone.warning) == ((), "")
    assert np.isfinite(alone.values[[0, 1, 3]]).all()
    np.testing.assert_allclose(found.values[[0, 3]], alone.values[[0, 3]], rtol=0.1)


def test_so_has_the_moment_filters_maximum(best):
    assert best.tied == ("b1", "b2")
    assert best.ties.in_words == SAID
    assert np.isinf(best.standard_errors).tolist() == [False, True, True, False]


@pytest.mark.long
def test_likelihood_ratio_intervals_are_refused(best):
    with pytest.raises(ModelError, match=SAID):
        engine.likelihood_intervals(PRODUCT, best.theta, SERIES, exact=True)


@pytest.mark.long
@pytest.mark.parametrize("method", [pytest.param("em", marks=pytest.mark.slow), "quasi-newton"])
def test_estimations_say_so(method):
    few = {"method": method, "n_iterations": 3}
    assert SAID in engine.rts_em(PRODUCT, SERIES, **few).message
    assert SAID in engine.rbps_em(PRODUCT, SERIES, n_particles=20, **few).message
    assert "together" not in engine.rts_em(PRODUCT, SERIES, free=ALONE, **few).message


@pytest.mark.slow
def test_the_unit_of_a_hidden_state_is_found_with_particles():
    series = record(UNIT)
    with warnings.catch_warnings():  # the moment filter's maximum is not theirs
        warnings.simplefilter("ignore", NotSettledWarning)
        found = engine.standard_errors(UNIT, quasi_ml(UNIT, series).theta, series)
    assert found.tied == ("b", "c", "q")


@pytest.mark.slow
def test_what_only_particles_see_is_not_refused():
    """To the moment filter the readings' variance is one number, to which both parameters contribute."""
    series = engine.simulate(VOLATILITY, None, 200, np.random.default_rng(1)).series
    assert quasi_ml(VOLATILITY, series, max_iterations=0).tied == ("phi", "mu")
    with warnings.catch_warnings():  # theta is not its maximum
        warnings.simplefilter("ignore", NotSettledWarning)
        found = engine.standard_errors(VOLATILITY, None, series, n_particles=50)
    assert found.tied == ()
    assert np.isfinite(found.values).all()


NEAR = first_order(
    lambda x, u, th: (th.p * x + th.b1 * u[0] + th.b2 * u[1], 0.0025),
    [Parameter("p", 0.8, "", (-1.0, 1.0)), Parameter("b1", 0.5), Parameter("b2", 0.3)],
    inputs=("u", "v"),
)


@pytest.mark.long
@pytest.mark.parametrize(
    ("apart", "correlation"),
    [
        pytest.param(0.1, 0.98, marks=pytest.mark.slow),
        pytest.param(0.02, 0.999, marks=pytest.mark.slow),
        (1e-3, 0.999998),
    ],
)
def test_strongly_correlated_parameters_keep_their_errors(apart, correlation):
    """Two inputs that are nearly one: the errors are large, and right."""
    series = record(NEAR, 300, apart=apart)
    best = quasi_ml(NEAR, series)
    found = engine.standard_errors(NEAR, best.theta, series, exact=True)
    C = np.linalg.inv(best.information)
    assert -C[1, 2] / np.sqrt(C[1, 1] * C[2, 2]) > correlation
    assert (found.tied, best.tied) == ((), ())
    np.testing.assert_allclose(found.values, np.sqrt(np.diag(C)), rtol=0.02)
    np.testing.assert_allclose(best.standard_errors, np.sqrt(np.diag(C)), rtol=0.02)


@pytest.mark.long
def test_inputs_that_are_one_are_tied():
    series = record(NEAR, apart=0.0)
    best = quasi_ml(NEAR, series)
    assert engine.standard_errors(NEAR, best.theta, series, exact=True).warning == SAID


def test_particles_keep_them_too():
    series = record(NEAR, 300, apart=0.05)
    best = quasi_ml(NEAR, series)
    found = engine.standard_errors(NEAR, best.theta, series, **FEW)
    assert found.tied == ()
    np.testing.assert_allclose(found.values, best.standard_errors, rtol=0.25)


@pytest.mark.parametrize("units", [1.0, 1e-8, 1e8])
def test_directions_are_free_of_units(units):
    """Rank 3 of 5: the sum of the first three, and nothing of the last, in any units."""
    A = np.random.default_rng(0).normal(size=(20, 3)) @ np.array(
        [[1.0, 1.0, 1.0, 0.0, 0.0], [0.0, 1.0, 2.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0, 0.0]]
    )
    A[:, 0] *= units
    flat = flat_directions(A.T @ A)
    assert flat.shape == (5, 2)
    assert tied(flat).tolist() == [True, True, True, False, True]
    assert ties_in_words("abcde", flat) == (
        "Only determined together, keep one of them fixed: a, b, c. "
        "Not determined by these data, keep fixed: e."
    )
    held = to_hold(flat)
    assert len(held) == 2
    assert 4 in held
    left = np.delete(np.arange(5), held)
    assert not flat_directions((A.T @ A)[np.ix_(left, left)]).size


def test_a_series_without_input_determines_no_gain():
    quiet = Series(SERIES.y, np.zeros(len(SERIES)), dt=1.0)
    assert quasi_ml(PRODUCT, quiet, max_iterations=1).ties.in_words == (
        "Not determined by these data, keep fixed: b1, b2."
    )


@pytest.mark.long
@pytest.mark.parametrize("exact", [True, False])
def test_where_no_free_parameter_is_determined_none_has_an_error(exact):
    """Complete data hold much of a state that no reading shows, these hold nothing."""
    unseen = MixedModel(
        name="unseen",
        dynamics=lambda a, u, t, dt, th: (
            [0.0, 0.0],
            np.array([[0.8, 0.0], [0.0, th.k2]]),
            np.diag([0.1, th.q2]),
        ),
        measurement=lambda a, u, t, th: ([0.0], [[1.0, 0.0]], [[0.1]]),
        initial=lambda th: (Gaussian([], np.zeros((0, 0))), [0.0, 0.0], np.eye(2)),
        linear={"seen": "", "unseen": ""},
        outputs={"y": ""},
        parameters=[Parameter("k2", 0.5, "", (-1.0, 1.0)), Parameter("q2", 0.2, "", (1e-3, 5.0))],
    )
    series = Series(np.random.default_rng(0).normal(size=60), dt=1.0)
    for free in (["k2"], ["k2", "q2"]):
        found = engine.standard_errors(unseen, None, series, free, n_particles=30, exact=exact)
        assert found.tied == tuple(free)
        assert np.isinf(found.values[: len(free)]).all()
        assert found.warning.endswith(
            f"Not determined by these data, keep fixed: {', '.join(free)}."
        )


def test_a_parameter_that_is_weakly_known_is_tied_as_well():
    """Three that only occur as ratios: the one of which little is known by itself moves as freely."""
    J = np.random.default_rng(0).standard_normal((50, 2)) * [1.0, 1e-2]
    rows = np.column_stack([J[:, 0], J[:, 1] - J[:, 0], -J[:, 1]])  # of x / y and y / z, at ones
    directions = flat_directions(rows.T @ rows)
    assert 0.003 < np.abs(directions[2]).min() < 0.05
    assert tied(directions).tolist() == [True, True, True]


@pytest.mark.long
def test_errors_that_rest_on_a_bound_say_so():
    """b1 ended at its bound, and b2 had an error of its own, as if the bound were known to be right."""
    start = {**PRODUCT.theta().asdict(), "b1": 5.0, "b2": 0.08}
    theta = quasi_ml(PRODUCT, SERIES, start, ["p", "b2", "q"]).theta
    found = engine.standard_errors(PRODUCT, theta, SERIES, exact=True)
    assert "only determine b2 together with b1, at the bound" in str(found)
    alone = engine.standard_errors(PRODUCT, theta, SERIES, free=["p", "b2", "q"], exact=True)
    assert "together" not in str(alone)


@pytest.mark.long
@pytest.mark.parametrize("unit", [1.0, 1e6])
def test_a_parameter_that_the_record_hardly_tells_is_said_to_be(unit):
    """A second input that hardly moves: any gain within its bounds does, in any unit of it."""
    model = first_order(
        lambda x, u, th: (0.8 * x + th.b * u[0] + th.c / unit * u[1], 1e-3),
        [Parameter("b", 0.5, "", (0.0, 5.0)), Parameter("c", 0.5 * unit, "", (0.0, unit))],
        ("u", "v"),
    )
    rng = np.random.default_rng(2)
    u = np.repeat(rng.uniform(-1.0, 1.0, (12, 2)), 10, axis=0) * [1.0, 0.002]
    series = engine.simulate(model, None, 120, rng, u=u, dt=1.0).series
    said = "These data hardly tell c: its standard error is larger than what the bounds allow."
    assert said in engine.fit_simulation(model, series).message
    assert "Stopped by a bound" not in engine.fit_simulation(model, series).message
    held = quasi_ml(model, series, {"c": 0.5 * unit}, ["b"])
    errors = engine.standard_errors(model, held.theta, series, exact=True)
    assert said in errors.warning
    assert np.isfinite(errors.values).all()


@pytest.mark.parametrize(
    ("sides", "held"),
    [
        ({"b1": 1}, {}),  # b2 makes up for it
        ({"b1": 1, "b2": -1}, {}),  # both may be inside, the product is the same
        ({"b1": 1, "b2": 1}, {"b1": 1, "b2": 1}),  # data ask for a larger product
        ({"c": 1, "b2": 1}, {"c": 1}),  # determined by itself
        ({"idle": -1}, {"idle": -1}),  # data say nothing of it, and nothing makes up for it
    ],
)
def test_a_bound_does_not_hold_what_others_make_up_for(sides, held):
    apart = np.array([[1.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, np.sqrt(2.0)]]).T / np.sqrt(2.0)
    names = ("b1", "b2", "c", "idle")
    mixed = apart @ np.array([[0.6, -0.8], [0.8, 0.6]])  # eigenvectors of one value are any such
    assert Ties(names, apart).held(sides) == Ties(names, mixed).held(sides) == held
    assert Ties().held(sides) == sides


@pytest.mark.long
def test_the_value_of_a_tied_parameter_at_its_bound_is_not_the_bounds():
    parameters = [
        replace(p, bounds=(0.0, 0.8)) if p.name == "b1" else p for p in PRODUCT.parameters
    ]
    bounded = PRODUCT.with_parameters(parameters)
    fitted = engine.fit_simulation(bounded, SERIES, {"b2": 0.4}, ["p", "b1", "b2"], n_starts=1)
    assert "Only determined together" in fitted.message
    assert "Stopped by a bound" not in fitted.message
    alone = engine.fit_simulation(bounded, SERIES, {"b2": 0.4}, ["p", "b1"], n_starts=1)
    assert "Stopped by a bound: b1" in alone.message
    em = engine.rbps_em(bounded, SERIES, {"b2": 0.3, "b1": 0.79}, ["b1", "b2"], 10, 4, seed=1)
    assert bounded.at_bounds(em.theta, ["b1"]) == ("b1",)
    assert "Stopped by a bound" not in em.message
