"""Errors of a free run's parameters that are only determined together, also with first states."""

import numpy as np
import pytest

import engine
from engine.diagnose.free_run.answer import _apart, noise_fit
from engine.diagnose.free_run_fits.fitted import fit_runs

# the unit of x is not told: another c is another b, and another first state
MODEL = engine.MixedModel(
    name="unit",
    dynamics=lambda a, u, t, dt, th: (
        [th.p * a[:, 0] + th.b * u[0]],
        np.zeros((1, 0)),
        [[1e-4]],
    ),
    measurement=lambda a, u, t, th: ([th.c * a[:, 0]], np.zeros((1, 0)), [[th.r]]),
    initial=lambda th: (engine.Gaussian([1.0], [[1.0]]), [], np.zeros((0, 0))),
    nonlinear={"x": ""},
    inputs={"u": ""},
    outputs={"y": ""},
    parameters=[
        engine.Parameter("p", 0.9, "", (-1.0, 1.0)),
        engine.Parameter("b", 0.5, "", (0.0, 5.0)),
        engine.Parameter("c", 2.0, "", (0.0, 10.0)),
        engine.Parameter("r", 1e-2, "", (1e-6, 1.0)),
    ],
)


@pytest.mark.parametrize("x1", [0.01, 3.0, 30.0])
def test_what_the_unit_of_a_state_ties_has_no_error(x1):
    rng = np.random.default_rng(0)
    u, x = np.repeat(rng.uniform(-1.0, 1.0, 10), 10), np.full(100, x1)
    for k in range(99):
        x[k + 1] = 0.9 * x[k] + 0.5 * u[k]
    series = engine.Series(2.0 * x + 0.1 * rng.standard_normal(100), u, dt=1.0)

    def errors(*free):
        fit = noise_fit(fit_runs(MODEL, [series], MODEL.theta(), free, np.array([[x1]])))
        return dict(zip(fit.free, fit.standard_errors.tolist(), strict=True)), fit.tied

    together, tied = errors("p", "b", "c", "r")
    assert (together["b"], together["c"], tied) == (np.inf, np.inf, ("b", "c"))
    alone, none = errors("p", "b", "r")
    assert not none
    assert together["p"] == pytest.approx(
        alone["p"], rel=0.02
    )  # more freedom of another counts the rows less


def test_nothing_tied_leaves_every_combination():
    assert np.allclose(
        _apart(np.zeros((3, 0)), np.ones(3)) @ _apart(np.zeros((3, 0)), np.ones(3)).T, np.eye(3)
    )
    assert _apart(np.zeros((0, 1)), np.ones(0)).shape == (0, 0)
    # a direction of the first states
    assert _apart(np.array([[1e-9], [0.0]]), np.ones(2)).shape == (2, 2)
