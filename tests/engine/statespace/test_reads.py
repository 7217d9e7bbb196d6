"""What the byte code of a function proves that it does not read."""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import numpy as np
import pytest

import engine
from engine.statespace.reads import fields_read

Three = namedtuple("Three", "q r s")  # noqa: PYI024 - as a model makes it of its parameters


def _helper(theta: Any) -> float:
    return float(theta.q)


def _own_name(theta: Any, other: float = 1.0) -> float:
    theta = other
    return theta


@pytest.mark.parametrize(
    ("function", "names"),
    [
        (lambda theta: theta.q + theta.s * theta.q, {"q", "s"}),
        (lambda theta: 1.0, set()),
        (lambda theta: [theta.q, [np.sqrt(theta.r)]], {"q", "r"}),
        (_helper, {"q"}),
        (lambda theta: _helper(theta), None),
        (lambda theta: theta[0], None),
        (lambda theta: (theta.q, *theta), None),
        (lambda theta: getattr(theta, "q"), None),  # noqa: B009
        (lambda theta: [theta.q for _ in range(2)], "here or nowhere"),
        (lambda theta: (lambda: theta.q)(), None),
        (lambda theta: eval("theta.q"), None),
        (_own_name, None),
        (np.asarray, None),
    ],
)
def test_what_is_taken_of_a_record(function: Any, names: Any) -> None:
    found = fields_read(function, 0)
    if names == "here or nowhere":  # an inner function up to Python 3.11
        assert found in (None, {"q"})
    else:
        assert found == names


def _written_out(theta: Any) -> float:
    return float(theta._asdict()["q"])


def _by_name(theta: Any) -> float:
    return float(theta.q)


@pytest.mark.parametrize(
    ("read", "q"), [(_written_out, True), (_helper, True), (lambda theta: 1.0, False)]
)
def test_rows_that_differ_in_what_is_not_read_are_one(read: Any, q: bool) -> None:
    """Of a function that takes one parameter vector a call, whatever way it reads it."""
    asked: list[int] = []

    def dynamics(a: Any, u: Any, t: Any, dt: Any, theta: Any) -> Any:
        asked.append(len(a))
        if not all(isinstance(value, float) for value in theta):
            raise TypeError("one parameter vector a call")
        return [read(theta) * a[:, 0]], np.zeros((1, 0)), [[1.0]]

    model = engine.MixedModel(
        name="three",
        nonlinear={"x": "1"},
        outputs={"y": "1"},
        parameters=[engine.Parameter(name, 1.0, "1", (0.0, 9.0)) for name in "qrs"],
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[1.0]]),
        initial=lambda theta: (engine.Gaussian([0.0], [[1.0]]), [], np.zeros((0, 0))),
    )
    theta = model.record(np.ones(3))._replace(q=np.array([0.5, 1.0, 1.5]))
    found = model.transition(np.ones((3, 1)), np.zeros(0), 0.0, 1.0, theta)[0]
    assert found.tolist() == ([[0.5], [1.0], [1.5]] if q else [[1.0]] * 3)


@pytest.mark.parametrize("by_row", ["q", "k"])
def test_noise_is_asked_for_once_where_a_parameter_of_the_drift_is_another_in_every_row(
    by_row: str,
) -> None:
    """As where it depends on a state: a record of thousands of rows has thousands of values."""
    asked = []

    def diffusion(a: Any, u: Any, t: Any, theta: Any) -> Any:
        asked.append(theta.q)
        return [[theta.q]]

    model = engine.continuous(
        name="leak",
        nonlinear={"x": "1"},
        outputs={"y": "1"},
        parameters=[engine.Parameter(name, 1.0, "1", (0.0, 99.0)) for name in "kq"],
        drift=lambda a, u, t, theta: ([-theta.k * a[:, 0]], np.zeros((1, 0))),
        diffusion=diffusion,
        measurement=lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[1.0]]),
        initial=lambda theta: (engine.Gaussian([0.0], [[1.0]]), [], np.zeros((0, 0))),
    )
    values = np.linspace(0.1, 5.0, 200)
    theta = model.record(np.ones(2))._replace(**{by_row: values})
    a, nothing = np.ones((200, 1)), np.zeros(0)
    Q = np.broadcast_to(model.dynamics(a, nothing, 0.0, 0.1, theta)[2], (200, 1, 1))
    calls = len(asked)
    alone = [
        model.dynamics(a[:1], nothing, 0.0, 0.1, theta._replace(**{by_row: float(value)}))[2]
        for value in values
    ]
    np.testing.assert_allclose(Q, np.array(alone).reshape(200, 1, 1), rtol=1e-12)
    assert calls == (1 if by_row == "k" else 200)
