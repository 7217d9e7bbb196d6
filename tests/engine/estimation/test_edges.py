"""Next to where a model cannot be had, searches go around it and end beside it."""

import math

import numpy as np
import pytest

import engine
from engine.errors import ModelError
from engine.estimation.edges import Edges
from engine.estimation.quasi_ml import derivatives, log_likelihoods, quasi_ml
from engine.estimation.start import WarmStart
from engine.statespace.shapes import as_matrix, as_rows

READ = np.random.default_rng(0).normal(size=200)  # nothing but noise: the walk's q is at its least
STILL = engine.Series(READ, dt=1.0)
START = {"q": 0.5, "r": 1.0}


def by_logarithm(q):
    return math.exp(2.0 * math.log(q))


def by_root(q):
    return math.sqrt(q - 1e-4)


def by_factor(q):
    L = np.linalg.cholesky(np.array([[q, 0.0], [0.0, 1.0]]))
    return (L @ L.T)[0, 0]


def by_division(q):
    return 1.0 / (1.0 / q)


def cut_off(q):
    return q + 0.0 * math.sqrt(q - 0.1)


def told_by_nan(q):
    return q**2 if q > 0.0 else math.nan


def walk(variance, first=lambda theta: 1.0, default=0.1):
    """A walk whose author writes its variance so that there is none at q = 0."""
    return engine.MixedModel(
        name="walk",
        dynamics=lambda a, u, t, dt, theta: ([0.0], [[1.0]], [[variance(theta.q)]]),
        measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r**2]]),
        initial=lambda theta: (None, [0.0], [[first(theta)]]),
        linear={"place": "m"},
        outputs={"y": "m"},
        parameters=[
            engine.Parameter("q", default, "m", (0.0, 100.0)),
            engine.Parameter("r", 1.0, "m", (1e-6, 100.0)),
        ],
    )


EACH = (by_logarithm, by_root, by_factor, by_division, told_by_nan)
HIGHEST = quasi_ml(walk(lambda q: q), STILL, START).log_likelihood


@pytest.mark.parametrize("variance", EACH)
def test_a_search_ends_next_to_where_the_model_cannot_be_had(variance):
    found = quasi_ml(walk(variance), STILL, START)
    assert found.converged
    assert found.log_likelihood == pytest.approx(HIGHEST, abs=0.01)


def test_no_likelihood_is_there():
    thetas = np.array([[0.0, 1.0], [0.5, 1.0], [1e-5, 1.0]])
    values = log_likelihoods(walk(by_root), [STILL], thetas)
    assert np.isneginf(values[[0, 2]]).all()
    assert np.isfinite(values[1])
    assert np.isneginf(log_likelihoods(walk(by_root), [STILL], thetas[:1])).all()


@pytest.mark.parametrize("where", ["dynamics", "initial"])
def test_next_to_it_the_slope_is_that_of_the_other_side(where):
    of = {
        "dynamics": (cut_off, lambda theta: 1.0),
        "initial": (abs, lambda theta: cut_off(theta.q)),
    }
    model, theta = walk(*of[where]), np.array([0.1 + 1e-8, 1.0])
    value, g, H = derivatives(model, [STILL], theta, np.array([0, 1]))
    beside = log_likelihoods(model, [STILL], theta + np.array([[0.0, 0.0], [1e-5, 0.0]]))
    assert value == pytest.approx(beside[0])
    assert g[0] == pytest.approx(np.diff(beside)[0] / 1e-5, rel=1e-2)
    assert (np.diag(H) > 0.0).all()


@pytest.mark.long
def test_a_search_for_a_start_goes_around_it():
    model = walk(by_logarithm)
    search = WarmStart(model, [STILL], model.free_indices(None))
    search(model.theta(START))
    assert not search.note
    assert search.apart[0].log_likelihood == pytest.approx(HIGHEST, abs=0.01)


def test_a_start_where_it_cannot_be_had_is_told():
    with pytest.raises(ModelError, match=r"dynamics raised ValueError: .*domain error.*at t = 0"):
        quasi_ml(walk(by_logarithm), STILL, {"q": 0.0})


def test_a_function_that_is_wrong_is_told():
    def wrong(q):
        return q if q > 0.4 else unknown  # noqa: F821

    with pytest.raises(ModelError, match="NameError"):
        quasi_ml(walk(wrong), STILL, START)


@pytest.mark.long
@pytest.mark.parametrize("method", ["quasi-newton", "em"])
@pytest.mark.parametrize("variance", [by_logarithm, by_root])
def test_an_estimation_ends_next_to_it(variance, method):
    found = engine.rbps_em(walk(variance), STILL, START, n_particles=20, method=method)
    assert found.outcome is engine.Outcome.CONVERGED
    here = log_likelihoods(walk(variance), [STILL], np.asarray(found.theta)[None])
    assert here[0] == pytest.approx(HIGHEST, abs=0.02)


@pytest.mark.long
@pytest.mark.parametrize("m_step", ["scoring", "bfgs"])
def test_an_m_step_goes_around_it(m_step):
    found = engine.rts_em(walk(by_root), STILL, START, n_iterations=30, method="em", m_step=m_step)
    assert found.outcome.success
    assert found.theta["q"] > 1e-4
    assert (np.diff(found.log_likelihood) > -1e-6).all()


def test_errors_are_those_with_what_is_next_to_it_held():
    errors = engine.standard_errors(walk(by_logarithm), {"q": 1e-6, "r": 0.9636}, STILL)
    assert errors.names == ("r",)
    assert errors.settled


@pytest.mark.long
def test_errors_next_to_it_are_from_the_other_side():
    model, theta = walk(cut_off), {"q": 0.1001}
    series = engine.simulate(model, theta, 200, np.random.default_rng(3), dt=1.0).series
    best = quasi_ml(walk(abs), series, theta).theta.asdict()
    errors, everywhere = (
        engine.standard_errors(one, {**best, **theta}, series) for one in (model, walk(abs))
    )
    assert errors.values == pytest.approx(everywhere.values, rel=0.2)


def test_an_edge_is_led_closer_as_long_as_that_is_worth_it():
    edges = Edges(np.array([0.0, 0.0]), np.array([2.0, 2.0]))

    def likelihoods(x):
        return np.where(x[:, 0] > 0.1, 0.0, -np.inf)

    x = np.array([1.0, 1.0])
    assert edges.learnt(x, np.array([-3.0, -0.5]), likelihoods)
    assert 0.1 < edges.lower[0] < 1.0
    assert edges.lower[1] == 0.0
    x[0] = before = edges.lower[0]
    assert not edges.closer(x, np.array([-1e-4, 0.0]), 1e-3)
    assert edges.closer(x, np.array([-1.0, 0.0]), 1e-3)
    assert edges.lower[0] < before
    assert not edges.learnt(x, np.array([0.5, 0.5]), likelihoods)


def test_an_estimate_next_to_it_says_so_with_the_error_of_the_function_once():
    found = engine.rts_em(walk(by_root), STILL, {"q": 1e-4 + 1e-6, "r": 0.96}, n_iterations=5)
    said = "The estimate is next to where the model cannot be had, at q = "
    assert found.message.count(said) == found.message.count("math domain error") == 1


def test_nothing_is_said_of_a_variance_without_a_declared_bound():
    model = engine.MixedModel(
        name="walk",
        dynamics=lambda a, u, t, dt, theta: ([0.0], [[1.0]], [[theta.q]]),
        measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[1.0]]),
        initial=lambda theta: (None, [0.0], [[1.0]]),
        linear={"place": "m"},
        outputs={"y": "m"},
        parameters=[engine.Parameter("q", 0.1, "m^2")],
    )
    found = engine.rts_em(model, STILL)
    assert found.theta["q"] < 1e-3
    assert "cannot be had" not in found.message


@pytest.mark.filterwarnings("error")  # NumPy drops an imaginary part with a warning
@pytest.mark.parametrize("as_array", [True, False])
def test_a_root_of_a_negative_number_is_no_model(as_array):
    """Python's ``theta.q ** 0.5`` is complex below zero, where it is asked whether a variance may be."""

    def dynamics(a, u, t, dt, theta):
        spread = theta.q**0.5
        return [0.0], [[1.0]], np.array([[spread]]) ** 2 if as_array else [[spread**2]]

    model = engine.MixedModel(
        name="walk",
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[1.0]]),
        initial=lambda theta: (None, [0.0], [[1.0]]),
        linear={"place": "m"},
        outputs={"y": "m"},
        parameters=[engine.Parameter("q", 0.1, "m^2")],
    )
    assert 0.0 <= quasi_ml(model, STILL).theta["q"] < 1e-3
    with pytest.raises(ModelError, match=r"dynamics.*complex"):
        quasi_ml(model, STILL, {"q": -1.0})


@pytest.mark.parametrize("row", [1j, np.array([1j, 0.0])])
def test_what_is_complex_is_told_with_its_place(row):
    for call in (as_rows, lambda value, M, n, where: as_matrix([value], M, 1, n, where)):
        with pytest.raises(ModelError, match="dynamics: f is complex") as told:
            call([row], 2, 1, "dynamics: f")
        assert told.value.numeric
