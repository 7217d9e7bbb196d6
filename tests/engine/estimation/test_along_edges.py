"""A maximum beyond an edge that several parameters have together: estimates slide along it.

The damped oscillator in closed form, with the root of w^2 - c^2 / 4, on data of an overdamped one.
"""

import math

import numpy as np
import pytest
from scipy.optimize import minimize

import engine
from engine.diagnose import diagnose
from engine.errors import ModelError
from engine.estimation.along_edges import Edge, Place
from engine.estimation.quasi_ml import log_likelihoods, quasi_ml
from engine.simulation.free_run import run_rows

DT = 0.01


def oscillator(lib):
    """By NumPy, whose root of a negative number is NaN, or by the math module, which raises."""

    def dynamics(a, u, t, dt, th):
        w = lib.sqrt(th.w2 - th.c**2 / 4)
        e = lib.exp(-th.c * dt / 2)
        s, co = e * lib.sin(w * dt) / w, e * lib.cos(w * dt)
        A = [[co + th.c / 2 * s, s], [-th.w2 * s, co - th.c / 2 * s]]
        rest, q = th.k * u[0] / th.w2, th.q**2 * dt
        f = [(1 - A[0][0]) * rest, -A[1][0] * rest]
        return f, A, [[q * dt * dt / 3, q * dt / 2], [q * dt / 2, q]]

    return engine.MixedModel(
        name="oscillator",
        dynamics=dynamics,
        measurement=lambda a, u, t, th: ([0.0], [[1.0, 0.0]], [[th.r**2]]),
        initial=lambda th: (None, [0.0, 0.0], [[1.0, 0.0], [0.0, 400.0]]),
        linear={"x": "mm", "v": "mm/s"},
        inputs={"force": "N"},
        outputs={"y": "mm"},
        parameters=[
            engine.Parameter("w2", 990.0, "1/s^2", (10.0, 1e5)),
            engine.Parameter("c", 30.0, "1/s", (0.01, 200.0)),
            engine.Parameter("k", 66.0, "mm/s^2/N", (0.1, 1e4)),
            engine.Parameter("q", 20.0, "mm/s^1.5", (1e-3, 1e5)),
            engine.Parameter("r", 0.3, "mm", (1e-5, 50.0)),
        ],
    )


def overdamped(T=400, fine=20):
    """x'' = -900 x - 66 x' + 60 u + noise, by small steps."""
    rng, x, v, y, u = np.random.default_rng(0), 0.0, 0.0, [], []
    for t in range(T):
        u.append(rng.uniform(-120.0, 120.0) if t % 20 == 0 else u[-1])
        y.append(x + 0.2 * rng.standard_normal())
        for _ in range(fine):
            h = DT / fine
            kick = 20.0 * math.sqrt(h) * rng.standard_normal()
            x, v = x + h * v, v + h * (-900.0 * x - 66.0 * v + 60.0 * u[-1]) + kick
    return engine.Series(y, u=u, dt=DT)


RECORD = overdamped()
MODELS = {"nan": oscillator(np), "raises": oscillator(math)}


def tank():
    """A level whose root has no number below zero, where a later row may be: at its start all is well."""

    def dynamics(a, u, t, dt, th):
        x = a[:, :1]
        return x + dt * (u[0] - th.k * np.sqrt(x)), np.zeros((1, 0)), [[1e-12]]

    return engine.MixedModel(
        name="tank",
        dynamics=dynamics,
        measurement=lambda a, u, t, th: (a, np.zeros((1, 0)), [[th.r**2]]),
        initial=lambda th: (engine.Gaussian([1.0], [[1e-8]]), [], np.zeros((0, 0))),
        nonlinear={"h": "m"},
        inputs={"flow": "m/s"},
        outputs={"y": "m"},
        parameters=[
            engine.Parameter("k", 0.3, "1", (0.0, 5.0)),
            engine.Parameter("r", 0.05, "m", (1e-4, 5.0)),
        ],
    )


def drained(T=200, k=1.0, dt=0.05):
    """It runs dry at the end, and its sensor reads too little."""
    rng, x, y = np.random.default_rng(1), 1.0, []
    u = np.where(np.arange(T) < 150, 0.5, 0.0)
    for flow in u:
        y.append(x - 0.15 + 0.02 * rng.standard_normal())
        x = max(x + dt * (flow - k * math.sqrt(x)), 0.0)
    return engine.Series(y, u=u, dt=dt)


@pytest.mark.long
def test_at_the_edge_where_a_filter_is_lost_later_a_search_has_ended():
    model, record = tank(), drained()
    with np.errstate(all="ignore"):
        found = quasi_ml(model, record)
        beyond = [[found.theta["k"] * more, found.theta["r"]] for more in (0.999, 1.0, 1.001)]
        less, here, more = log_likelihoods(model, [record], np.array(beyond))
    assert more == -np.inf
    assert less < here
    assert found.converged


def test_a_climb_that_gains_next_to_nothing_ends():
    """At a kink slopes promise what no step gains."""
    asked = []

    def at(x):
        asked.append(x)
        return Place(x, 1e-9 * float(x[0]), np.ones(1), np.eye(1))

    wide = np.array([1e3])
    edge = Edge(-wide, wide, np.ones(1), lambda x: True, lambda each: 1e-9 * each[:, 0], at)
    place, converged = edge.climbed(at(np.zeros(1)), 0.01, True, 40)
    assert len(asked) < 5
    assert converged
    assert place.value > 0.0


def highest():
    """The largest likelihood next to the edge, by another search in what is left beside c."""

    def negative(p):
        c, k, q, r = np.exp(p)
        theta = np.array([[c * c / 4 * (1.0 + 1e-7), c, k, q, r]])
        return -log_likelihoods(MODELS["nan"], [RECORD], theta)[0]

    start = np.log([56.0, 52.0, 12.0, 0.2])
    options = {"xatol": 1e-5, "fatol": 1e-5, "maxiter": 2000}
    return -minimize(negative, start, method="Nelder-Mead", options=options).fun


@pytest.fixture(scope="module")
def most():
    return highest()


@pytest.mark.long
@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
@pytest.mark.parametrize(
    "start", [{}, {"c": 10.0, "w2": 500.0}, {"c": 60.0, "w2": 2000.0, "q": 5.0}]
)
def test_the_estimate_is_the_highest_place_along_the_edge(model, start, most):
    found = quasi_ml(model, RECORD, start)
    assert found.log_likelihood == pytest.approx(most, abs=0.02)
    assert found.converged


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_em_begins_there_and_says_where_it_ends(model, most):
    with np.errstate(all="ignore"):
        found = engine.rbps_em(model, RECORD, seed=1, n_iterations=10)
    assert found.log_likelihood[-1] == pytest.approx(most, abs=0.02)
    assert "next to where the model cannot be had" in found.message


@pytest.mark.long
def test_runs_at_parameters_without_a_model_are_lost_and_others_are_not():
    thetas = np.array([[900.0, c, 60.0, 20.0, 0.2] for c in (20.0, 80.0, 40.0)])
    for model in MODELS.values():
        with np.errstate(all="ignore"):
            y, _ = run_rows(model, thetas, RECORD, np.zeros((3, 2)))
            nowhere, _ = run_rows(model, thetas[1:2], RECORD, np.zeros((1, 2)))
        assert np.isfinite(y[:, [0, 2]]).all()
        assert np.isnan(y[1:, 1]).all()
        assert np.isnan(nowhere[1:]).all()


@pytest.mark.long
def test_a_simulation_is_fitted_though_trials_of_it_fail():
    with np.errstate(all="ignore"):
        ends = [engine.fit_simulation(model, RECORD) for model in MODELS.values()]
    for end in ends:
        assert end.theta["w2"] == pytest.approx(end.theta["c"] ** 2 / 4, rel=1e-3)
        assert end.rmse == pytest.approx(0.203, abs=0.002)


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_a_smoother_says_that_the_model_cannot_be_had_and_not_that_it_is_not_linear(model):
    with np.errstate(all="ignore"):
        engine.kalman_smoother(model, None, RECORD)
        with pytest.raises(ModelError, match=r"not finite|math domain error") as told:
            engine.kalman_smoother(model, {"w2": 900.0, "c": 66.0}, RECORD)
    assert told.value.numeric


@pytest.mark.slow
def test_a_diagnosis_there_sees_the_same_whether_the_model_is_nan_or_raises():
    pages = [diagnose(model, RECORD, seed=1, processes=1) for model in MODELS.values()]
    seen = [{s.effect.name: s.p_value for s in page.rounds[0].screen.scores} for page in pages]
    # the same effects, at places whose likelihoods differ by a hundredth, with which middling p-values move
    assert seen[0] == pytest.approx(seen[1], abs=0.1)
    for page in pages:
        assert page.verdict.value == "nothing"
        assert "next to where the model cannot be had" in str(page)
