"""Parameters that move what has no noise: EM cannot, so the likelihood does; exact on linear models."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

import engine
from engine import Gaussian, MixedModel, Parameter
from engine.estimation.quasi_ml import quasi_ml
from engine.filters.kalman import kalman_smoother

TRUTH = {"z0": 3.0, "b": 0.1}


def level(nonlinear: bool) -> MixedModel:
    """A level without noise from a known start, b more each time, under an AR(1) disturbance.

    z0 enters p(a_1) or z_1 with variance 0; b a row of x whose Q is zero, and the output r too.
    """

    def dynamics(a, u, t, dt, theta):
        now = a[:, 0] if nonlinear else 0.0
        A = [[0.0], [0.95]] if nonlinear else [[1.0, 0.0], [0.0, 0.95]]
        return [now + theta.b, 0.0], A, [[0.0, 0.0], [0.0, theta.q]]

    def measurement(a, u, t, theta):
        return (
            ([a[:, 0]], [[1.0]], [[theta.r]]) if nonlinear else ([0.0], [[1.0, 1.0]], [[theta.r]])
        )

    def initial(theta):
        if nonlinear:
            return Gaussian([theta.z0], [[0.0]]), [0.0], [[0.1]]
        return Gaussian([], np.empty((0, 0))), [theta.z0, 0.0], [[0.0, 0.0], [0.0, 0.1]]

    return MixedModel(
        name="level",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        nonlinear={"level": "m"} if nonlinear else {},
        linear={"w": "m"} if nonlinear else {"level": "m", "w": "m"},
        outputs={"y": "m"},
        parameters=[
            Parameter("z0", 0.0, "m"),
            Parameter("b", 0.0, "m"),
            Parameter("q", 0.05, "m^2", (1e-6, 1.0)),
            Parameter("r", 0.1, "m^2", (1e-6, 5.0)),
        ],
    )


@pytest.fixture(
    scope="module", params=[False, pytest.param(True, marks=pytest.mark.slow)], ids=["z", "a"]
)
def case(request):
    model = level(request.param)
    series = engine.simulate(model, TRUTH, 80, np.random.default_rng(1)).series
    near = in_logs(quasi_ml(model, series).theta)
    exact = minimize(  # the maximum itself, by a method that knows nothing of this package's
        lambda x: -kalman_smoother(model, [*x[:2], *np.exp(x[2:])], series).log_likelihood,
        near,
        method="Nelder-Mead",
        options={
            "xatol": 1e-4,
            "fatol": 1e-7,
            "maxiter": 200,
            "initial_simplex": near + 0.05 * np.eye(5, 4),
        },
    )
    return model, series, exact.x, -exact.fun


def in_logs(theta):
    values = np.array(theta)
    return np.append(values[:2], np.log(values[2:]))


@pytest.mark.long
def test_exact_em_finds_the_exact_maximum(case):
    model, series, best, top = case
    start = {"q": np.exp(best[2])}  # held, as EM is slow in it; z0 and b leave from 0
    found = engine.rts_em(model, series, start, ["z0", "b", "r"], n_iterations=60, tolerance=None)
    assert found.not_estimated == ()
    assert "exact likelihood" in found.message
    assert "z0, b. They act where the model has no noise" in found.message
    assert np.all(np.diff(found.log_likelihood) > -1e-8)  # it never falls
    np.testing.assert_allclose(in_logs(found.theta), best, atol=2e-3)
    assert found.log_likelihood[-1] == pytest.approx(top, abs=1e-4)


@pytest.mark.slow
def test_particles_find_it_too(case):
    """Monte Carlo noise of the averaged iterates is below a tenth of a standard error here."""
    model, series, best, _ = case
    options = {"n_particles": 30, "n_iterations": 120, "warm_start": False}
    for how in ({"method": "em"}, {"tolerance": 1e-4}):
        found = engine.rbps_em(model, series, **options, **how)
        assert "moment filter's likelihood" in found.message
        np.testing.assert_allclose(in_logs(found.theta)[:2], best[:2], atol=0.01)
        np.testing.assert_allclose(in_logs(found.theta)[2:], best[2:], atol=0.05)
    assert "not estimated" not in found._repr_html_()


@pytest.mark.slow
def test_their_standard_errors_are_those_of_the_exact_likelihood(case):
    """Fisher's identity gives no score for them; differences of the exact likelihood do."""
    model, series, _, _ = case
    theta = quasi_ml(model, series, tolerance=1e-8).theta
    errors = engine.standard_errors(model, theta, series, exact=True)

    def gradient(x):
        out, h = [], 1e-4 * np.array([1.0, 0.1, theta["q"], theta["r"]])
        for step in np.diag(h):
            ends = [kalman_smoother(model, x + s * step, series).log_likelihood for s in (1, -1)]
            out.append((ends[0] - ends[1]) / (2.0 * step.sum()))
        return np.array(out)

    x, information = np.asarray(theta), []
    for step in np.diag(0.05 * errors.values):
        information.append((gradient(x - step) - gradient(x + step)) / (2.0 * step.sum()))
    exact = np.sqrt(np.diag(np.linalg.inv(np.array(information))))
    np.testing.assert_allclose(errors.values[:2], exact[:2], rtol=0.02)
    assert errors.settled


@pytest.mark.long
def test_resuming_gives_the_same_bits_and_the_same_words(case):
    model, series, _, _ = case
    options = {"n_particles": 10, "tolerance": None, "seed": 3, "warm_start": False}
    whole = engine.rbps_em(model, series, n_iterations=5, **options)
    part = engine.rbps_em(model, series, n_iterations=2, **options)
    for resume in (part, whole):
        again = engine.rbps_em(model, series, n_iterations=5, resume=resume, **options)
        np.testing.assert_array_equal(again.trace, whole.trace)
        assert again.message == whole.message
    seen = []

    def proposal(step):
        seen.append(tuple(step.theta))
        return engine.filters.proposals.adapted(step)

    engine.rbps_em(model, series, n_iterations=5, resume=whole, proposal=proposal, **options)
    if model.na:  # only the last iteration was looked at again, with what it began from
        assert set(seen) == {tuple(whole.trace[-2].tolist())}


def test_what_nothing_depends_on_is_named(case):
    model, series, _, _ = case
    idle = MixedModel(
        **{**vars_of(model), "parameters": [*model.parameters, Parameter("idle", 2.0)]}
    )
    found = engine.rts_em(idle, series, n_iterations=3)
    assert found.not_estimated == ("idle",)
    assert "Not estimated" in found.message
    assert "idle" in found.message
    assert "not estimated" in found._repr_html_()
    assert engine.rts_em(idle, series, free=["b", "q"], n_iterations=3).not_estimated == ()


def test_where_the_likelihood_cannot_be_had_it_is_said(case, monkeypatch):
    model, series, _, _ = case

    def lost(*_):
        raise engine.ModelError("lost")

    monkeypatch.setattr("engine.estimation.likelihood_step.quasi_ml", lost)
    found = engine.rbps_em(model, series, n_particles=10, n_iterations=2, warm_start=False)
    assert found.not_estimated == ("z0", "b")
    assert found.theta["z0"] == found.theta["b"] == 0.0
    assert "Not estimated" in found.message


@pytest.mark.slow
def test_a_variance_that_starts_at_zero_can_leave_it():
    """Q(theta, theta_k) keeps the rank of Q: EM alone would stay at zero for ever."""
    model = level(False)
    model = MixedModel(
        **{
            **vars_of(model),
            "parameters": [
                *model.parameters[:2],
                Parameter("q", 0.0, "m^2", (0.0, 1.0)),
                model.parameters[3],
            ],
        }
    )
    series = engine.simulate(model, {**TRUTH, "q": 0.05}, 120, np.random.default_rng(2)).series
    best = quasi_ml(model, series, {"q": 0.05}, tolerance=1e-6)
    slow = engine.rts_em(model, series, n_iterations=30, method="em")
    assert 0.3 * best.theta["q"] < slow.theta["q"] < 1.5 * best.theta["q"]  # on its way
    found = engine.rts_em(model, series)
    assert found.outcome.name == "CONVERGED"
    assert found.theta["q"] == pytest.approx(best.theta["q"], rel=0.1)


@pytest.mark.long
def test_a_parameter_in_a_noisy_and_in_a_noise_free_row():
    """Q would use the noisy row alone, and settle beside the maximum."""

    def dynamics(a, u, t, dt, theta):
        return [0.0, 0.0], [[1.0, theta.k], [0.0, theta.k]], [[0.0, 0.0], [0.0, 1.0]]

    def measurement(a, u, t, theta):
        return [0.0], [[1.0, 0.0]], [[1.0]]

    def initial(theta):
        return Gaussian([], np.empty((0, 0))), [0.0, 0.0], np.eye(2)

    model = MixedModel(
        name="both", dynamics=dynamics, measurement=measurement, initial=initial,
        linear={"s": "m", "v": "m"}, outputs={"y": "m"}, parameters=[Parameter("k", 0.5, "", (0.01, 0.99))],
    )  # fmt: skip
    series = engine.simulate(model, {"k": 0.8}, 200, np.random.default_rng(3)).series
    best = quasi_ml(model, series, tolerance=1e-8)
    for found in (
        engine.rts_em(model, series),
        engine.rts_em(model, series, method="quasi-newton"),
        engine.rbps_em(model, series, n_particles=2, n_iterations=60, warm_start=False),
    ):
        assert found.theta["k"] == pytest.approx(best.theta["k"], abs=1e-3)


def vars_of(model):
    """The fields of a model, to make another one from."""
    return {name: getattr(model, name) for name in model.__dataclass_fields__}
