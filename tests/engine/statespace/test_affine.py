"""Functions that a few calls tell: found, right at all rows, and left alone where they are not such."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

import engine
from engine import Series
from engine.diagnose import extend
from engine.estimation.differences import neighbours
from engine.filters.neighbours import filter_neighbours
from engine.filters.sigma_point import moment_filter
from engine.statespace.reads import reads
from engine.statespace.refutation import repeated_if_refuted

T, K = 300, 4


class Textbook:
    """Two linear states, written for one time and one parameter vector a call; counts its calls."""

    def __init__(self, force, late=None, unit=1.0):
        self.calls = 0
        self.unit = unit

        def step(u, th):
            self.calls += 1
            A = np.array([[1.0 - 0.1 * th.k, 0.1], [-0.1 * th.w, 0.97]])
            return np.array([0.0, unit * float(force(th, u))]), A, np.diag([1e-4, th.q**2])

        if late is None:
            self.dynamics = lambda a, u, t, dt, theta: step(u, theta)
        else:
            self.dynamics = lambda a, u, t, dt, theta: step(u + late(float(t)), theta)
        self.model = engine.MixedModel(
            name="textbook",
            dynamics=self.dynamics,
            measurement=lambda a, u, t, theta: (
                np.zeros(1),
                np.array([[1.0, 0.0]]),
                np.array([[float(theta.r) ** 2]]),
            ),
            initial=lambda theta: (engine.Gaussian([], np.zeros((0, 0))), [0.0, 0.0], np.eye(2)),
            nonlinear={},
            linear={"x": "m", "v": "m/s"},
            inputs={"force": "N", "wind": "N"},
            outputs={"y": "m"},
            parameters=[
                engine.Parameter("k", 0.5, "1/s", (0.0, 5.0)),
                engine.Parameter("w", 1.0, "1/s^2", (0.0, 9.0)),
                engine.Parameter("b", 1.0, "", (0.0, 9.0)),
                engine.Parameter("q", 0.1, "m/s", (1e-3, 9.0)),
                engine.Parameter("r", 0.1, "m", (1e-3, 9.0)),
            ],
        )


def inputs(seed=6):
    return np.random.default_rng(seed).uniform(-2.0, 2.0, (T, 2))


FORCES = {
    "affine": lambda th, u: th.b * u[0] - 0.1 * u[1] + 0.2,
    "constant": lambda th, u: th.b,
    "square of an input": lambda th, u: th.b * u[0] * abs(u[0]),
    "product": lambda th, u: th.b * u[0] * u[1],
    "large inputs": lambda th, u: th.b * (u[0] if u[0] < 1.9 else 0.0),
    "dead zone": lambda th, u: th.b * (u[0] if abs(u[0]) > 0.1 else 0.0),
}
AFFINE = ("affine", "constant")


def evaluated(model, u, thetas, rows):
    """f, A, Q at some rows for each theta, as whole calls and step by step."""
    K, n = len(thetas), len(rows)
    record = model.records(np.repeat(thetas, n, axis=0), 1)
    whole = model.transition(
        np.empty((K * n, 0)), np.tile(u[rows].T, K), np.tile(0.1 * rows, K), 0.1, record
    )
    record, steps = model.records(thetas, 1), []
    for i in rows.tolist():
        steps.append(model.transition(np.empty((K, 0)), u[i], 0.1 * i, 0.1, record))
    return whole, steps


@pytest.mark.long
@pytest.mark.parametrize("unit", [1.0, 1e-9])
@pytest.mark.parametrize("force", FORCES)
def test_every_row_is_what_it_is_alone(force, unit):
    written = Textbook(FORCES[force], unit=unit)
    u, rng = inputs(), np.random.default_rng(0)
    theta = np.asarray(written.model.theta())
    rows = np.arange(T)
    for _ in range(3):  # whatever was learnt from the calls before
        thetas = theta * rng.uniform(0.5, 1.5, (K, len(theta)))
        whole, steps = evaluated(written.model, u, thetas, rows)
        for k, own in enumerate(thetas):
            plain = written.model.record(own)
            for i in rows.tolist():
                f, A, Q = written.dynamics(np.empty((1, 0)), u[i], 0.1 * i, 0.1, plain)
                size = abs(f).max() + unit
                np.testing.assert_allclose(whole[0][k * T + i], f, atol=1e-13 * size)
                np.testing.assert_allclose(steps[i][0][k], f, atol=1e-13 * size)
                for found in (whole[1:], steps[i][1:]):
                    at = k * T + i if found is not steps[i][1:] and len(found[0]) > K else k
                    np.testing.assert_allclose(found[0][at], A, rtol=1e-13)
                    np.testing.assert_allclose(found[1][at], Q, rtol=1e-13)


@pytest.mark.parametrize("force", FORCES)
def test_few_calls_are_made_where_few_tell_all(force):
    written = Textbook(FORCES[force])
    u, theta = inputs(), np.asarray(written.model.theta())
    thetas = theta * np.linspace(0.9, 1.1, K)[:, None]
    evaluated(written.model, u, 1.01 * thetas, np.arange(T))
    written.calls = 0
    evaluated(written.model, u, thetas, np.arange(T))
    assert written.calls < 20 * K
    assert written.model.transitions.recorded is (force not in AFFINE)


def test_a_function_that_reads_the_time_is_called_at_each():
    """However late it changes: no sample of times would be enough."""
    written = Textbook(FORCES["affine"], late=lambda t: 1.0 if t > 29.85 else 0.0)
    theta = np.asarray(written.model.theta())
    (f, _, _), steps = evaluated(written.model, np.zeros((T, 2)), theta[None], np.arange(T))
    assert f[-2, 1] == pytest.approx(0.2)
    assert f[-1, 1] == steps[-1][0][0, 1] == pytest.approx(1.1)


def test_inputs_beyond_those_met_are_looked_at():
    """A valve that closes at 3, while all inputs were below 2."""
    written = Textbook(lambda th, u: th.b * min(u[0], 3.0))
    u, theta = inputs(), np.asarray(written.model.theta())
    thetas = theta * np.linspace(0.9, 1.1, K)[:, None]
    evaluated(written.model, u, thetas, np.arange(T))
    for beyond in (2.1, 2.6, 5.0):  # a little further each time
        u[::7, 0] = beyond
        (f, _, _), steps = evaluated(written.model, u, thetas, np.arange(T))
        expected = np.minimum(u[:, 0], 3.0)[None] * thetas[:, 2:3]
        np.testing.assert_allclose(f[:, 1].reshape(K, T), expected, atol=1e-12)
        found = np.array([step[0][:, 1] for step in steps]).T
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_theta_that_contradicts_makes_the_work_be_done_again():
    """The valve's limit is a parameter: at first above all inputs, then among them."""
    written = Textbook(lambda th, u: min(u[0], 9.0 * th.b))
    u, theta = inputs(), np.asarray(written.model.theta())
    evaluated(written.model, u, theta[None] * np.ones((K, 1)), np.arange(T))
    low = np.tile(theta, (K, 1))
    low[:, 2] = 0.1
    runs = []

    @repeated_if_refuted
    def work():
        runs.append(evaluated(written.model, u, low, np.arange(T))[0][0][:, 1].reshape(K, T))
        return runs[-1]

    expected = np.minimum(u[:, 0], 0.9)
    np.testing.assert_allclose(work(), np.tile(expected, (K, 1)), atol=1e-12)
    assert len(runs) == 2


@pytest.mark.parametrize("away", [1e-7, 0.5])
def test_a_bump_without_height_at_the_start_is_seen_when_it_gets_one(away):
    """It acts in a few rows only, which no sample of the inputs need hold; two parameters move with it."""
    written = Textbook(lambda th, u: u[1] + (th.b - 1.0) * np.exp(-(((u[0] - 0.3) / 0.01) ** 2)))
    u, theta = inputs(), np.asarray(written.model.theta())
    bump = np.exp(-(((u[:, 0] - 0.3) / 0.01) ** 2))
    assert 0 < (bump > 0.01).sum() < 0.03 * T
    for moved in ([0], [0, 1, 2]):
        other = theta.copy()
        other[moved] += away
        (f, _, _), _ = evaluated(written.model, u, np.array([theta, other]), np.arange(T))
        np.testing.assert_allclose(f[:T, 1], u[:, 1], atol=1e-12)
        height = away if 2 in moved else 0.0
        np.testing.assert_allclose(f[T:, 1], u[:, 1] + height * bump, rtol=0.0, atol=1e-12)


def test_parameters_that_cannot_move_together_are_looked_at_one_by_one():
    """Where the rate and the stiffness are both large there is no value; either alone is fine."""

    def force(th, u):
        return np.nan if th.k > 1.0 and th.w > 2.0 else th.b * u[0]

    written = Textbook(force)
    u, theta = inputs(), np.asarray(written.model.theta())
    thetas = np.tile(theta, (3, 1))
    thetas[1, 0], thetas[2, 1] = 2.0, 3.0
    evaluated(written.model, u, thetas, np.arange(T))
    written.calls = 0
    (f, _, _), _ = evaluated(written.model, u, 1.01 * thetas, np.arange(T))
    np.testing.assert_allclose(f[:, 1], np.tile(1.01 * u[:, 0], 3), atol=1e-12)
    assert written.calls < T + 60  # all inputs once more, as two further parameters move


def test_what_was_told_before_other_inputs_were_met_is_made_again_too():
    """A limit between the inputs met first and those met later, at a theta that has none of its own."""
    written = Textbook(lambda th, u: min(u[0], 9.0 * th.b) + min(u[1], 30.0 * th.w))
    theta = np.asarray(written.model.theta())
    thetas = theta * np.linspace(0.9, 1.1, K)[:, None]
    runs = []

    @repeated_if_refuted
    def work():
        runs.append(len(runs))
        evaluated(written.model, inputs(), thetas, np.arange(T))
        evaluated(written.model, 3.0 * inputs(), thetas, np.arange(T))  # all are met anew
        low = thetas.copy()
        low[:, 2] = 0.1
        return evaluated(written.model, 3.0 * inputs(), low, np.arange(T))[0][0][:, 1]

    u = 3.0 * inputs()
    expected = np.minimum(u[:, 0], 0.9) + u[:, 1]
    np.testing.assert_allclose(work().reshape(K, T), np.tile(expected, (K, 1)), atol=1e-12)
    assert len(runs) == 2


def test_inputs_that_go_together_may_part_later():
    """Of one record the inputs are the same; the second one tells them apart."""
    written = Textbook(FORCES["affine"])
    theta = np.asarray(written.model.theta())[None]
    together = np.repeat(inputs()[:, :1], 2, axis=1)
    for u in (together, inputs(), together):
        (f, _, _), _ = evaluated(written.model, u, theta, np.arange(T))
        np.testing.assert_allclose(f[:, 1], u[:, 0] - 0.1 * u[:, 1] + 0.2, atol=1e-12)


def test_a_parameter_at_which_there_is_no_value_spoils_no_other():
    written = Textbook(lambda th, u: u[0] / (th.b - 0.5))
    theta = np.asarray(written.model.theta())
    thetas = np.tile(theta, (3, 1))
    thetas[:, 2] = (1.0, 0.5, 2.0)
    u = inputs()
    with np.errstate(all="ignore"):
        evaluated(written.model, u, thetas[::2], np.arange(T))
        (f, _, _), _ = evaluated(written.model, u, thetas, np.arange(T))
    f = f[:, 1].reshape(3, T)
    np.testing.assert_allclose(f[0], 2.0 * u[:, 0], atol=1e-12)
    np.testing.assert_allclose(f[2], u[:, 0] / 1.5, atol=1e-12)
    assert not np.isfinite(f[1]).any()


@pytest.mark.parametrize("bend", [0.0, 1e-3])
def test_a_bend_within_small_changes_of_a_large_input_is_seen(bend):
    """A pressure of 100,000 Pa that changes by one: its zero is far away, and no measure of it."""
    written = Textbook(lambda th, u: th.b * ((u[0] - 1e5) + bend * (u[0] - 1e5) ** 2))
    u, theta = inputs(), np.asarray(written.model.theta())
    thetas = theta * np.linspace(0.9, 1.1, K)[:, None]
    (f, _, _), _ = evaluated(written.model, u + np.array([1e5, 0.0]), thetas, np.arange(T))
    change = (u[:, 0] + 1e5) - 1e5
    expected = thetas[:, 2:3] * (change + bend * change**2)
    np.testing.assert_allclose(f[:, 1].reshape(K, T), expected, atol=1e-12)
    written.calls = 0
    evaluated(written.model, u + np.array([1e5, 0.0]), 1.01 * thetas, np.arange(T))
    assert written.calls < 20 * K
    assert written.model.transitions.recorded is (bend != 0.0)


def test_inputs_at_which_there_is_no_value_are_not_extrapolated():
    """Just beyond those met, where the affine function would have one."""
    written = Textbook(lambda th, u: th.b * u[0] if u[0] < 2.05 else np.nan)
    u, theta = inputs(), np.asarray(written.model.theta())
    thetas = theta * np.linspace(0.9, 1.1, K)[:, None]
    evaluated(written.model, u, thetas, np.arange(T))
    u[40, 0] = 2.1
    (f, _, _), steps = evaluated(written.model, u, thetas, np.arange(T))
    lost = np.isnan(f[:, 1].reshape(K, T))
    assert lost[:, 40].all()
    assert lost.sum() == K
    assert np.isnan(steps[40][0][:, 1]).all()


def test_rows_of_the_same_inputs_are_one_call():
    """A product of inputs, both held for thirty samples."""
    written = Textbook(FORCES["product"])
    u, theta = np.repeat(inputs()[::30], 30, axis=0), np.asarray(written.model.theta())
    thetas = theta * np.linspace(0.9, 1.1, K)[:, None]
    evaluated(written.model, u, thetas, np.arange(T))
    record = written.model.records(np.repeat(thetas, T, axis=0), 1)
    written.calls = 0
    f, _, _ = written.model.transition(
        np.empty((K * T, 0)), np.tile(u.T, K), np.tile(0.1 * np.arange(T), K), 0.1, record
    )
    assert written.calls < K * (T // 30 + 5)  # some are made to see what a function takes
    expected = thetas[:, 2:3] * u[:, 0] * u[:, 1]
    np.testing.assert_allclose(f[:, 1].reshape(K, T), expected, rtol=1e-13)


def test_who_writes_into_results_changes_none_of_the_next():
    written = Textbook(FORCES["affine"])
    u, theta = inputs(), np.asarray(written.model.theta())
    thetas = theta * np.linspace(0.9, 1.1, K)[:, None]
    first, steps = evaluated(written.model, u, thetas, np.arange(T))
    before = [array.copy() for array in (*first, *steps[-1])]
    for array in (*first, *steps[-1]):
        array[...] = np.nan
    again, steps = evaluated(written.model, u, thetas, np.arange(T))
    for old, new in zip(before, (*again, *steps[-1]), strict=True):
        np.testing.assert_array_equal(old, new)


@pytest.mark.parametrize("force", FORCES)
def test_filters_side_by_side_are_those_of_each(force):
    """What is not affine in the inputs is filtered row by row, and all of it as a plain loop would."""
    written = Textbook(FORCES[force])
    model, rng = written.model, np.random.default_rng(7)
    series = Series(rng.standard_normal((T, 1)), u=inputs(), dt=0.1)
    thetas = neighbours(model, np.asarray(model.theta()), np.arange(5))
    found = filter_neighbours(model, thetas, series)
    exact = moment_filter(model, thetas, series)
    single = Textbook(FORCES[force], late=lambda t: 0.0).model  # reads the time: called row by row
    for k, theta in enumerate(thetas):
        alone = moment_filter(single, theta, series)
        np.testing.assert_allclose(found.log_terms[:, k], alone.log_terms[:, 0], atol=1e-9)
        np.testing.assert_allclose(exact.log_terms[:, k], alone.log_terms[:, 0], atol=1e-9)


def test_an_extension_of_such_a_model_needs_as_few_calls():
    """Coulomb friction on a state that becomes a nonlinear one."""
    written = Textbook(FORCES["affine"])
    series = Series(np.zeros((T, 1)), u=inputs(), dt=0.1)
    more = extend(written.model, ["coulomb:v"])
    thetas = np.asarray(more.theta()) * np.linspace(0.9, 1.1, K)[:, None]
    for factor in (1.0, 1.02):  # the inputs are met one by one
        moment_filter(more, factor * thetas, series)
    written.calls = 0
    moment_filter(more, thetas * 1.01, series)
    assert written.calls < 20 * K


@pytest.mark.parametrize("irregular", [False, True])
@pytest.mark.parametrize("drifts", [False, True])
@pytest.mark.parametrize("force", AFFINE)
def test_what_differs_in_every_row_takes_no_call_for_each(force, drifts, irregular):
    """A drift gives a parameter another value in each row, and irregular times another time step."""
    written, rng = Textbook(FORCES[force]), np.random.default_rng(9)
    u, rows, none = inputs(), np.arange(T), np.empty((T, 0))
    dt = rng.uniform(0.05, 0.2, T) if irregular else 0.1
    t, calls = np.cumsum(dt * np.ones(T)), []
    for size in (1.0, 1.1, 1.2):
        b = size * (np.linspace(0.5, 1.5, T) if drifts else 1.0)
        record = written.model.record(written.model.theta())._replace(b=b)
        written.calls = 0
        found = written.model.transition(none, u.T, t, dt, record)
        calls.append(written.calls)
        for i in rows[::20].tolist():
            own = record._replace(b=b[i] if drifts else b)
            f, A, _ = written.dynamics(none[:1], u[i], t[i], 0.1, own)
            np.testing.assert_allclose(found[0][i], f, atol=1e-13)
            np.testing.assert_allclose(found[1][i] if found[1].ndim == 3 else found[1], A)
    assert calls[-1] < T // 10


# ---- which arguments a function reads -----------------------------------------------------------


def inner(a, u, t):
    return (lambda: t)()


def sees_all(a, u, t):
    return locals()["t"]


class Method:
    def unread(self, a, u, t):
        return a

    def read(self, a, u, t):
        return a + t


@pytest.mark.parametrize(
    ("function", "read"),
    [
        (lambda a, u, t: a + u, False),
        (lambda a, u, t: a + t, True),
        (lambda a, u, t, dt=1.0: a if t > 5 else u, True),
        (lambda a, *rest: a, True),
        (inner, True),
        (sees_all, True),
        (functools.partial(lambda a, u, t: a), True),
        (functools.wraps(inner)(lambda *all: inner(*all)), True),
        (Method().unread, False),
        (Method().read, True),
        (np.add, True),
    ],
)
def test_what_a_function_reads_is_told_by_its_code(function, read):
    assert reads(function, 2) is read


def test_other_parameters_of_the_same_functions_keep_what_is_known():
    written = Textbook(FORCES["affine"])
    u, theta = inputs(), np.asarray(written.model.theta()) * np.array([[1.0], [1.2]])
    evaluated(written.model, u, theta, np.arange(T))
    other = written.model.with_parameters(
        [replace(parameter, scale=2.0) for parameter in written.model.parameters]
    )
    written.calls = 0
    evaluated(other, u, 1.1 * theta, np.arange(T))
    assert written.calls < 40


def test_digits_do_not_depend_on_what_was_asked_first():
    """A run that goes on where another was stopped ends with the same numbers."""
    u, found = inputs(), []
    for first in (slice(0, T), slice(200, 240)):
        model = Textbook(FORCES["affine"]).model
        thetas = np.asarray(model.theta()) * np.linspace(0.9, 1.1, K)[:, None]
        model.transitions.look_again(u)
        evaluated(model, u, 1.1 * thetas, np.arange(T)[first])
        found.append(evaluated(model, u, thetas, np.arange(T))[0])
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)
