"""A model that has no numbers at some states: whoever wrote it is told where, and what to write."""

import numpy as np
import pytest

import engine
from engine.errors import ModelError
from engine.estimation.quasi_ml import quasi_ml
from engine.filters.sigma_point import moment_path
from engine.statespace.had import can_be_had, first_that_can_be_had

BELOW = r"At h = -0\.\d+ m its dynamics has no number, as a root or a logarithm .* np\.sqrt"


def tank(root=lambda h: np.sqrt(h), seen=lambda h: h):
    """A vessel with a drain, as a process engineer writes it."""
    return engine.MixedModel(
        name="tank",
        dynamics=lambda a, u, t, dt, th: (
            [a[:, 0] + dt * (u[0] - th.k * root(a[:, 0])) / th.A],
            np.zeros((1, 0)),
            [[th.q**2 * dt]],
        ),
        measurement=lambda a, u, t, th: ([seen(a[:, 0])], np.zeros((1, 0)), [[1e-4]]),
        initial=lambda th: (engine.Gaussian([0.3], [[1e-4]]), [], np.zeros((0, 0))),
        nonlinear={"h": "m"},
        inputs={"inflow": "m^3/s"},
        outputs={"level": "m"},
        parameters=[
            engine.Parameter("k", 0.04, "m^2.5/s", (1e-4, 1.0)),
            engine.Parameter("A", 0.4, "m^2", (0.01, 10.0)),
            engine.Parameter("q", 0.003, "m/s^0.5", (1e-6, 1.0)),
        ],
    )


def emptied(T=60):
    """It drains until it is empty."""
    t = 5.0 * np.arange(T)
    return engine.Series(np.maximum(np.sqrt(0.3) - 0.05 * t, 0.0) ** 2, u=np.zeros(T), dt=5.0)


@pytest.mark.parametrize("root", [np.sqrt, lambda h: h**0.5, lambda h: np.exp(0.5 * np.log(h))])
def test_a_run_and_a_filter_say_at_which_state_there_is_no_number(root):
    model, record = tank(root), emptied()
    with pytest.raises(ModelError, match=f"the simulation ends; at t = .* {BELOW}"):
        engine.free_run(model, None, record)
    with pytest.raises(ModelError, match=f"the filter is lost at row .* {BELOW}"):
        moment_path(model, np.asarray(model.theta()), record)
    with pytest.raises(ModelError, match=f"the filter is lost at row .* {BELOW}"):
        quasi_ml(model, record)


def test_what_they_say_to_write_is_enough():
    model, record = tank(lambda h: np.sqrt(np.maximum(h, 0.0))), emptied()
    assert np.isfinite(engine.free_run(model, None, record).y).all()
    assert np.isfinite(quasi_ml(model, record).log_likelihood)


def test_a_sensor_without_a_number_is_told_apart_from_the_dynamics():
    model, record = tank(lambda h: np.maximum(h, 0.0) ** 0.5, lambda h: np.log(h)), emptied()
    with pytest.raises(ModelError, match="its measurement has no number"):
        moment_path(model, np.asarray(model.theta({"k": 0.3})), record)


def test_parameters_at_which_a_model_can_be_had():
    model = tank(lambda h: np.sqrt(h))
    theta, a = np.asarray(model.theta()), np.array([[0.3], [-0.1]])
    at = np.zeros(1), 0.0, 5.0
    assert can_be_had(model, model.record(theta), a, *at).tolist() == [True, False]
    nowhere, here = theta * [np.nan, 1.0, 1.0], theta * [1.1, 1.0, 1.0]
    found = first_that_can_be_had(model, [nowhere, here, theta], a[:1], *at)
    np.testing.assert_array_equal(found, here)
    assert first_that_can_be_had(model, [nowhere], a[:1], *at) is None
