"""The restricted likelihood divides squares by the readings less the parameters, and leaves the rest alone."""

import numpy as np
import pytest

import engine
from engine.data.series import Series
from engine.estimation.quasi_ml import quasi_ml
from engine.estimation.restricted import restricted

T = 40
SHAPES = 5


def regression():
    """y = sum of theta_k u_k + noise: nothing moves."""
    names = [f"b{k}" for k in range(SHAPES)]
    return engine.MixedModel(
        name="regression",
        dynamics=lambda a, u, t, dt, th: ([a[:, 0]], np.zeros((1, 0)), [[0.0]]),
        measurement=lambda a, u, t, th: (
            [a[:, 0] + sum(getattr(th, name) * u[k] for k, name in enumerate(names))],
            np.zeros((1, 0)),
            [[th.r**2]],
        ),
        initial=lambda th: (engine.Gaussian([0.0], [[1e-12]]), [], np.zeros((0, 0))),
        nonlinear={"rest": "1"},
        inputs={f"u{k}": "1" for k in range(SHAPES)},
        outputs={"y": "1"},
        parameters=[
            *(engine.Parameter(name, 1.0, "1") for name in names),
            engine.Parameter("r", 0.5, "1", (1e-3, 10.0)),
        ],
    )


@pytest.fixture(scope="module")
def fitted():
    rng = np.random.default_rng(4)
    u = rng.standard_normal((T, SHAPES))
    series = Series(u.sum(axis=1)[:, None] + 0.5 * rng.standard_normal((T, 1)), u, dt=1.0)
    return quasi_ml(regression(), series, tolerance=1e-8), series


def test_a_regression_is_divided_by_its_degrees_of_freedom(fitted):
    fit, series = fitted
    noise = np.array([False] * SHAPES + [True])
    found = restricted(fit, series, noise)
    left = series.y[:, 0] - series.u @ np.linalg.lstsq(series.u, series.y[:, 0], rcond=None)[0]
    assert fit.theta["r"] ** 2 == pytest.approx(left @ left / T, rel=1e-3)
    assert found.theta["r"] ** 2 == pytest.approx(left @ left / (T - SHAPES), rel=0.02)
    np.testing.assert_allclose(
        np.asarray(found.theta)[:SHAPES], np.asarray(fit.theta)[:SHAPES], atol=1e-3
    )
    assert found.log_likelihood <= fit.log_likelihood


@pytest.mark.parametrize("kind", [True, False])
def test_of_one_kind_alone_nothing_is_given_back(fitted, kind):
    fit, series = fitted
    assert restricted(fit, series, np.full(SHAPES + 1, kind)) is fit
