"""Every error of the check that a model passes when it is registered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.errors import ModelError
from engine.presentation.model_check import model_check
from engine.statespace.checks import check_model
from engine.statespace.continuous import continuous
from engine.statespace.model import Gaussian, MixedModel, Parameter


def dynamics(a, u, t, dt, theta):
    return [theta.k * a[:, 0], 0.0], [[1.0], [0.5]], np.eye(2)


def measurement(a, u, t, theta):
    return [a[:, 0]], [[0.0]], [[1.0]]


def initial(theta):
    return Gaussian([0.0], [[1.0]]), [0.0], [[1.0]]


GOOD = MixedModel(
    name="good",
    dynamics=dynamics,
    measurement=measurement,
    initial=initial,
    nonlinear={"a": "m"},
    linear={"z": "m"},
    inputs={"u": "V"},
    outputs={"y": "m"},
    parameters=[Parameter("k", 0.5, "1", (0.0, 1.0))],
)


def returning(value, place, function):
    """The function with one of its three return values replaced."""

    def changed(*arguments):
        out = list(function(*arguments))
        out[place] = value(out[place]) if callable(value) else value
        return tuple(out)

    return changed


def raising(error):
    def function(*arguments):
        raise error

    return function


class Bad:
    """A density of a_1 whose draws or log-densities have the wrong shape."""

    def __init__(self, drawn=(1,), valued=()):
        self.drawn, self.valued = drawn, valued

    def sample(self, rng, n):
        return np.zeros((n, *self.drawn))

    def log_density(self, a):
        return np.zeros((len(a), *self.valued))


def parameters(*several):
    return {"parameters": [Parameter(*one) for one in several]}


def test_a_good_model_passes():
    check_model(GOOD)
    check_model(replace(GOOD, initial=returning(Bad(), 0, initial)))


def vehicle(divided_by, linear=True):
    """A vehicle's yaw, slower by its speed, or by how far two speeds are apart."""

    def by_speed(a, u, t, dt, theta):
        speed = divided_by(u)
        f = a[:, 0] * (1 - dt * theta.k / speed)
        return [f if linear else f - dt * a[:, 0] ** 3, 0.0], [[0.1], [0.5]], np.eye(2)

    return replace(GOOD, dynamics=by_speed, inputs={"speed": "m/s", "wind": "m/s"})


@pytest.mark.parametrize(
    ("divided_by", "tried"),
    [(lambda u: u[0], "1"), (lambda u: float(u[0]), "1"), (lambda u: u[1] - u[0], "1 and 2")],
)
def test_a_model_that_divides_by_an_input_is_tried_at_another(divided_by, tried):
    """At a speed of 0 it was no model: neither registered nor read from a file."""
    check_model(vehicle(divided_by))
    right, method, *_ = model_check(vehicle(divided_by))
    assert f"with inputs of {tried} and a step of 1" in right
    assert method.startswith("Linear and Gaussian")
    assert model_check(vehicle(divided_by, linear=False))[1].startswith("Not linear and Gaussian")


@pytest.mark.parametrize(("rate", "tried"), [(1.0, "1"), (1e5, "0.001"), (1e7, "1e-06")])
def test_what_grows_too_fast_for_a_step_of_a_second_is_tried_at_a_shorter_one(rate, tried):
    """An oscillator circuit of 16 kHz was no model: after a second at rest its state has no number."""

    def drift(a, u, t, theta):
        x, v = a.T
        return [rate * v, rate * (theta.k * (1 - x**2) * v - x + u[0])], np.zeros((2, 0))

    circuit = continuous(
        name="circuit",
        inputs=GOOD.inputs,
        outputs=GOOD.outputs,
        nonlinear={"x": "V", "v": "V"},
        drift=drift,
        diffusion=lambda a, u, t, theta: rate * np.eye(2),
        measurement=lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[1.0]]),
        initial=lambda theta: (Gaussian([0.1, 0.0], np.eye(2)), [], np.zeros((0, 0))),
        parameters=GOOD.parameters,
    )
    check_model(circuit)
    assert f"and a step of {tried}, in the unit" in model_check(circuit)[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": ""}, "a model needs a name"),
        ({"outputs": {}}, "model 'good' has no outputs; name at least one"),
        ({"nonlinear": {}, "linear": {}}, "model 'good' has no states; name"),
        ({"inputs": ["u"]}, "model 'good': inputs must map names to units"),
        ({"outputs": {"a": "m"}}, "model 'good' uses the channel name 'a' twice"),
        (parameters(("k 1", 0.5)), "the parameter name 'k 1' cannot be used"),
        (parameters(("_k", 0.5)), "the parameter name '_k' cannot be used"),
        (parameters(("k", 0.5), ("k", 0.5)), "model 'good' has two parameters named 'k'"),
        (parameters(("k", 0.5, "", (1, 0))), r"parameter 'k': bounds \(1, 0\) are not \(low, hi"),
        (parameters(("k", 2.0, "", (0, 1))), "parameter 'k': default 2 is outside its bounds"),
    ],
)
def test_names(change, message):
    with pytest.raises(ModelError, match=message):
        check_model(replace(GOOD, **change))


@pytest.mark.parametrize(
    ("value", "place", "message"),
    [
        (np.zeros(3), 0, r"model 'good', dynamics: f has shape \(3,\); \(4, 2\) or \(2,\)"),
        ([0.0], 0, r"dynamics: f has shape \(1,\); a list of 2 rows"),
        ([np.zeros(2), 0.0], 0, r"dynamics: f: row 0 has shape \(2,\); a number or \(4,\)"),
        ([np.nan, 0.0], 0, "dynamics: f is not finite at the default parameters"),
        (np.zeros((1, 2)), 1, r"dynamics: A has shape \(1, 2\); \(2, 1\) or \(4, 2, 1\)"),
        ([[1.0, 0.0], [0.0]], 1, "dynamics: A is not a list of 2 rows of 1 entries"),
        ([[np.inf], [0.0]], 1, "dynamics: A is not finite"),
        (np.eye(3), 2, r"dynamics: Q has shape \(3, 3\); \(2, 2\) or \(4, 2, 2\)"),
        ([[1.0, 0.5], [0.0, 1.0]], 2, "dynamics: Q is not symmetric"),
        ([[1.0, 2.0], [2.0, 1.0]], 2, "dynamics: Q has the negative eigenvalue -1; a covariance"),
        ([[np.nan, 0.0], [0.0, 1.0]], 2, "dynamics: Q is not finite"),
    ],
)
def test_dynamics(value, place, message):
    with pytest.raises(ModelError, match=message):
        check_model(replace(GOOD, dynamics=returning(value, place, dynamics)))


@pytest.mark.parametrize(
    ("value", "place", "message"),
    [
        (np.zeros((3, 2)), 0, r"measurement: h has shape \(3, 2\); \(4, 1\) or \(1,\)"),
        ([np.inf], 0, "measurement: h is not finite"),
        (np.zeros((2, 2)), 1, r"measurement: C has shape \(2, 2\); \(1, 1\) or \(4, 1, 1\)"),
        ([[np.nan]], 1, "measurement: C is not finite"),
        (np.eye(2), 2, r"measurement: R has shape \(2, 2\)"),
        ([[-1.0]], 2, "measurement: R has the negative eigenvalue -1"),
        ([[0.0]], 2, "measurement: R has a zero on its diagonal; every output needs"),
    ],
)
def test_measurement(value, place, message):
    with pytest.raises(ModelError, match=message):
        check_model(replace(GOOD, measurement=returning(value, place, measurement)))


@pytest.mark.parametrize(
    ("value", "place", "message"),
    [
        (Bad(drawn=(2,)), 0, r"p\(a_1\) draws shape \(3, 2\); \(3, 1\) is needed"),
        (Bad(valued=(1,)), 0, r"log p\(a_1\) has shape \(3, 1\); \(3,\) is needed"),
        ([0.0, 0.0], 1, r"initial: z1 has shape \(2,\); a list of 1 rows"),
        ([np.nan], 1, "initial: z1 is not finite"),
        ([[-0.5]], 2, "initial: P1 has the negative eigenvalue -0.5"),
        (np.eye(2), 2, r"initial: P1 has shape \(2, 2\)"),
        (lambda P: lambda a: np.zeros((2, 2)), 2, r"initial: P1 has shape \(2, 2\)"),
        (None, 0, "initial returned NoneType as the density of a_1"),
    ],
)
def test_initial(value, place, message):
    with pytest.raises(ModelError, match=message):
        check_model(replace(GOOD, initial=returning(value, place, initial)))


@pytest.mark.parametrize("function", ["dynamics", "measurement", "initial"])
def test_an_error_inside_a_function_is_named(function):
    with pytest.raises(ModelError, match=f"model 'good': {function} raised ZeroDivisionError: oh"):
        check_model(replace(GOOD, **{function: raising(ZeroDivisionError("oh"))}))


def test_a_function_that_looks_for_a_parameter_that_is_not_there():
    broken = replace(GOOD, parameters=[Parameter("other", 1.0)])
    with pytest.raises(ModelError, match=r"model 'good': dynamics raised AttributeError.*'k'"):
        check_model(broken)
