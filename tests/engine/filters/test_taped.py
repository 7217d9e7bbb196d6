"""The filter through tapes is the filter through calls, for whatever has a tape; what has none is called."""

from __future__ import annotations

import bisect
import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from scipy.interpolate import (
    Akima1DInterpolator,
    CubicSpline,
    PchipInterpolator,
    UnivariateSpline,
    interp1d,
    make_interp_spline,
)
from scipy.special import expit

import engine
import engine.filters.sigma_point
import engine.filters.strata
from engine.data.joined import in_turn, joined, together
from engine.data.series import Series
from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.of_series import setting_for
from engine.errors import ModelError
from engine.filters.filter_steps import FilterSteps, Thetas
from engine.filters.heavy_tails import with_mixture
from engine.filters.sigma_point import moment_filter, moment_path, run_on_tape
from engine.filters.taped import moving_on_tape
from engine.models.registry import get_model
from engine.statespace.continuous import continuous
from engine.statespace.model import Gaussian, MixedModel, Parameter
from engine.statespace.on_tape import OnTape
from engine.statespace.recorded.curves import pieces_of

T, K = 60, 3


def drift(a, u, t, theta):
    """A pendulum on a motor."""
    angle, rate = a.T
    return [rate, u[0] - theta.k * np.sin(angle) - theta.c * rate], np.zeros((2, 0))


def pendulum():
    return continuous(
        name="pendulum",
        drift=drift,
        diffusion=lambda a, u, t, theta: np.diag([1e-6, theta.q]),
        measurement=lambda a, u, t, theta: (a[:, :1], np.zeros((1, 0)), [[theta.r]]),
        initial=lambda theta: (Gaussian([0.3, 0.0], 0.01 * np.eye(2)), [], np.zeros((0, 0))),
        nonlinear={"angle": "rad", "rate": "rad/s"},
        inputs={"torque": "1/s^2"},
        outputs={"encoder": "rad"},
        parameters=[
            Parameter("k", 4.0, bounds=(0.0, 20.0)),
            Parameter("c", 0.3, bounds=(0.0, 5.0)),
            Parameter("q", 0.02, bounds=(1e-9, 1.0)),
            Parameter("r", 0.01, bounds=(1e-9, 1.0)),
        ],
    )


def series_for(model, seed, even=True):
    rng = np.random.default_rng(seed)
    steps = np.full(T - 1, 0.1) if even else rng.uniform(0.05, 0.2, T - 1)
    y = 0.3 * rng.standard_normal((T, model.ny)).cumsum(axis=0)
    y[rng.random((T, model.ny)) < 0.1] = np.nan
    u = rng.standard_normal((T, len(model.inputs))) + 1.5
    return Series(
        y,
        u if len(model.inputs) else None,
        t=np.concatenate([[0.0], steps.cumsum()]),
        y_names=tuple(model.outputs),
        u_names=tuple(model.inputs),
    )


def thetas_of(model, seed):
    """Near the defaults, effects at sizes that are not zero."""
    rng = np.random.default_rng(seed)
    theta = np.asarray(model.theta()).copy()
    theta = np.where(theta == 0.0, 0.05, theta)
    return np.clip(theta * (1.0 + 0.02 * rng.random((K, theta.size))), model.lower, model.upper)


def both(model, thetas, series, monkeypatch):
    taped = run_on_tape(FilterSteps(model, Thetas(model, thetas), series))
    with monkeypatch.context() as patch:
        patch.setattr(engine.filters.sigma_point, "filter_by_tape", lambda *_: None)
        called = moment_filter(model, thetas, series)
    return taped, called


def assert_same(taped, called):
    scale = np.nanmax(np.abs(called.log_terms))
    np.testing.assert_allclose(taped.log_terms, called.log_terms, rtol=1e-8, atol=1e-8 * scale)
    np.testing.assert_allclose(taped.S, called.S, rtol=1e-7, atol=1e-9 * np.nanmax(called.S))


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "every"),
    [
        ("pendulum", False),
        *(
            pytest.param(name, True, marks=pytest.mark.slow)
            for name in ("mixed-4", "tanks", "pendulum")
        ),
    ],
)
def test_with_effects_it_is_what_calls_make(name, every, monkeypatch):
    """With one of each kind, or all of them."""
    model = pendulum() if name == "pendulum" else get_model(name)
    series = series_for(model, 1)
    setting = setting_for(model, series, np.asarray(model.theta()))
    without = []
    effects = all_effects(setting)
    if not every:
        effects = list({effect.kind: effect for effect in effects}.values())
    for effect in [None, *effects]:
        extended = model if effect is None else effect.apply(model)
        if extended.random_scales:
            continue  # has a filter of its own, see below
        taped, called = both(extended, thetas_of(extended, 2), series, monkeypatch)
        if taped is None:
            without.append("" if effect is None else effect.name)
        else:
            assert_same(taped, called)
    assert len(without) <= 5, without  # nearly all that diagnoses ask for is on tape
    assert "" not in without


@pytest.mark.parametrize(
    "name",
    [
        "variance:rate->time",
        *(
            pytest.param(name, marks=pytest.mark.long)
            for name in ("drift:encoder", "variance:encoder->time", "parameter-drift:k")
        ),
    ],
)
def test_what_begins_anew_with_each_record_is_as_well(name, monkeypatch):
    """Its clock looks into a table of the records, which was called at every row of each of them."""
    model = pendulum()
    records = in_turn([series_for(model, seed, even=False) for seed in range(3)])
    series = together(records)
    setting = setting_for(model, series, np.asarray(model.theta()))
    (effect,) = (one for one in all_effects(setting) if one.name == name)
    extended = effect.apply(model)
    taped, called = both(extended, thetas_of(extended, 2), series, monkeypatch)
    assert taped is not None
    assert_same(taped, called)


@pytest.mark.parametrize(
    ("name", "channel"), [("pendulum", "encoder"), ("pendulum", "rate"), ("mixed-4", "z1")]
)
def test_outliers_are_as_well(name, channel, monkeypatch):
    model = pendulum() if name == "pendulum" else get_model(name)
    where = "measurement" if channel in model.outputs else "dynamics"
    extended = with_mixture(model, where, channels=[channel])
    series = joined(series_for(model, 5), series_for(model, 6, even=False))
    thetas = thetas_of(extended, 4)
    gone = []
    with monkeypatch.context() as patch:
        patch.setattr(engine.filters.strata, "_step_by_step", lambda *_: gone.append(1))
        taped = moment_filter(extended, thetas, series)
    assert not gone
    monkeypatch.setattr(engine.filters.strata, "tapes_of", lambda *_: None)
    called = moment_filter(extended, thetas, series)
    assert_same(taped, called)
    np.testing.assert_allclose(taped.innovations, called.innovations, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("name", ["mixed-4", "pendulum", "oscillator"])
def test_so_is_the_way_of_one_filter(name, monkeypatch):
    model = pendulum() if name == "pendulum" else get_model(name)
    series = joined(series_for(model, 5), series_for(model, 6, even=name == "oscillator"))
    theta = thetas_of(model, 4)[0]
    gone = []
    with monkeypatch.context() as patch:
        patch.setattr(engine.filters.sigma_point, "_kept_by_calls", lambda *_: gone.append(1))
        taped = moment_path(model, theta, series)
    assert not gone
    monkeypatch.setattr(engine.filters.sigma_point, "filter_by_tape", lambda *_: None)
    called = moment_path(model, theta.copy() * (1.0 + 1e-15), series)  # it is not kept
    for name, values in vars(called).items():
        scale = np.nanmax(np.abs(values))
        np.testing.assert_allclose(getattr(taped, name), values, rtol=1e-8, atol=1e-9 * scale)


@pytest.mark.parametrize("name", ["mixed-4", "pendulum", "oscillator", "servo"])
def test_uneven_steps_and_records_one_after_the_other(name, monkeypatch):
    model = pendulum() if name == "pendulum" else get_model(name)
    series = series_for(model, 3, even=False)
    assert_same(*both(model, thetas_of(model, 4), series, monkeypatch))
    two = joined(series_for(model, 5), series_for(model, 6))
    assert_same(*both(model, thetas_of(model, 4), two, monkeypatch))


def held(matrices):
    """A level over a step of ``matrices`` (theta, dt), as users write it."""

    def dynamics(a, u, t, dt, theta):
        A, B, Q = matrices(theta, dt)
        return A[0, 0] * a + B[0, 0] * u[0], np.zeros((1, 0)), [[0.01 + Q[0, 0]]]

    return level(dynamics)


def discretized(theta, dt):
    F = np.array([[-theta.k, 1.0], [0.0, -2.0 * theta.k]])
    return engine.discretize(F, np.array([[1.0], [0.0]]), np.diag([0.1, 0.0]), dt=dt)


def by_scipy(theta, dt):
    A = scipy.linalg.expm(np.array([[-theta.k, 1.0], [0.0, -2.0 * theta.k]]) * dt)
    return A, np.ones((1, 1)), np.eye(1)


def by_roots(theta, dt):
    A = np.linalg.cholesky(np.array([[1.0, theta.k * dt], [theta.k * dt, 1.0]]))
    return 0.5 * A, np.ones((1, 1)), np.eye(1)


def by_inverses(theta, dt):
    F = np.array([[-theta.k, 1.0], [0.0, -2.0 * theta.k]])
    return np.linalg.inv(np.eye(2) - F * dt), np.ones((1, 1)), np.eye(1)


def test_a_model_that_has_none_for_uneven_steps_keeps_the_one_for_even_ones(monkeypatch):
    model = held(by_roots)
    theta = thetas_of(model, 4)
    taped, _ = both(model, theta, series_for(model, 5, even=False), monkeypatch)
    assert taped is None
    assert_same(*both(model, theta, series_for(model, 5), monkeypatch))


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("kind", ["parameter-step", "parameter-drift", "path", "pole"])
def test_matrices_over_a_step_that_change_with_time(kind, even, monkeypatch):
    """Exponentials for every row: of a library's model with each effect, and of a user's."""
    model = get_model("oscillator")
    series = series_for(model, 3, even=even)
    effects = all_effects(setting_for(model, series, np.asarray(model.theta())), [kind])
    for effect in effects[:2]:
        extended = effect.apply(model)
        assert_same(*both(extended, thetas_of(extended, 4), series, monkeypatch))


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("matrices", [discretized, by_scipy, by_inverses])
def test_so_do_those_of_a_users_function(matrices, even, monkeypatch):
    model = held(matrices)
    assert_same(*both(model, thetas_of(model, 4), series_for(model, 3, even=even), monkeypatch))


def level(dynamics):
    return MixedModel(
        name="level",
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: (a, np.zeros((1, 0)), [[0.1]]),
        initial=lambda theta: (Gaussian([1.0], [[0.1]]), [], np.zeros((0, 0))),
        nonlinear={"x": "m"},
        inputs={"u": "m"},
        outputs={"y": "m"},
        parameters=[Parameter("k", 0.9, bounds=(0.0, 2.0))],
    )


def by_time(a, u, t, dt, theta):
    return (theta.k if t < 2.0 else 0.5) * a


def by_input(a, u, t, dt, theta):
    if u[0] > 2.5:
        return theta.k * a + 0.1
    return theta.k * np.arctan(a) if u[0] > 1.0 else 0.8 * a


def by_state(a, u, t, dt, theta):
    out = np.empty_like(a)
    for i, x in enumerate(a[:, 0]):
        if x < 0.0:
            out[i] = theta.k * x
        elif x > 0.5 and u[0] > 1.5:
            out[i] = 0.3 + theta.k * math.sqrt(x)
        else:
            out[i] = 0.9 * theta.k * x
    return out


def until_it_converges(a, u, t, dt, theta):
    """An implicit step."""
    x = a[:, 0]
    for _ in range(20):
        step = (x - a[:, 0] - 0.1 * (u[0] - theta.k * x**3)) / (1.0 + 0.3 * theta.k * x**2)
        x = x - step
        if np.abs(step).max() < 1e-6:
            break
    return x[:, None]


LEVELS, NAMED = (0.1, 0.2, 0.3), {0: 0.0, 1: 0.05}


def in_turn_of_hours(a, u, t, dt, theta):
    """Guarded things on one side only: a table's entry, a logarithm, a product with zero."""
    if 1.0 <= t % 3.0 < 2.0:
        return theta.k * a + LEVELS[int(u[0] > 1.0) + int(u[0] > 2.0)] + NAMED[int(u[0] > 1.5)]
    if u[0] > 1.2:
        return theta.k * a + 0.1 * math.log(u[0] - 1.1)
    return theta.k * a + 0.0 * u[0]


def by_everything(a, u, t, dt, theta):
    k = theta.k if theta.k > 0.9 else 0.9
    first = np.where(a > 0.0, k * a, 0.5 * a) if t > 1.0 else 0.7 * a
    return first + 0.1 * u[0] if u[0] > 1.4 else first


SWITCHING = (by_time, by_input, by_state, until_it_converges, in_turn_of_hours, by_everything)


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("step", SWITCHING)
def test_where_ways_part_each_row_takes_its_own(step, even, monkeypatch):
    model = level(lambda *given: (step(*given), np.zeros((1, 0)), [[0.01]]))
    for seed in (1, 2, 3):  # inputs that no record before had
        series = series_for(model, seed, even)
        assert_same(*both(model, thetas_of(model, seed), series, monkeypatch))
    assert_same(*both(model, np.array([[0.85], [0.95]]), series, monkeypatch))


@pytest.mark.parametrize("step", [by_input, by_state, until_it_converges])
def test_outliers_and_paths_learn_ways_as_well(step, monkeypatch):
    model = level(lambda *given: (step(*given), np.zeros((1, 0)), [[0.01]]))
    extended, series = with_mixture(model, "measurement", channels=["y"]), series_for(model, 2)
    gone = []
    with monkeypatch.context() as patch:
        patch.setattr(engine.filters.strata, "_step_by_step", lambda *_: gone.append(1))
        patch.setattr(engine.filters.sigma_point, "_kept_by_calls", lambda *_: gone.append(1))
        taped = moment_filter(extended, thetas_of(extended, 4), series)
        path = moment_path(model, thetas_of(model, 4)[0], series)
    assert not gone
    monkeypatch.setattr(engine.filters.strata, "tapes_of", lambda *_: None)
    assert_same(taped, moment_filter(extended, thetas_of(extended, 4), series))
    monkeypatch.setattr(engine.filters.sigma_point, "filter_by_tape", lambda *_: None)
    called = moment_path(model, thetas_of(model, 4)[0], replace(series))  # none is kept of it
    np.testing.assert_allclose(path.filtered, called.filtered, rtol=1e-8, atol=1e-8)


def test_a_way_of_rows_at_which_no_step_is_made_is_none(monkeypatch):
    """An input that switches in the last row, and a step from one record to the next."""

    def switched(a, u, t, dt, theta):
        assert dt < 10.0
        return (theta.k if u[0] < 4.0 and dt < 1.0 else 0.5) * a, np.zeros((1, 0)), [[0.01]]

    model, one = level(switched), series_for(level(switched), 1)
    last = replace(one, u=np.append(np.ones(T - 1), 5.0)[:, None])
    far = replace(series_for(model, 2, even=False), begins=())
    far = Series(far.y, far.u, t=far.t + 500.0, y_names=("y",), u_names=("u",))
    for series in (last, together([one, far])):
        assert_same(*both(model, thetas_of(model, 1), series, monkeypatch))


def test_a_way_that_only_one_record_takes_is_learned_there(monkeypatch):
    """The pass begins anew, and the next record finds it."""
    model = level(lambda *given: (by_input(*given), np.zeros((1, 0)), [[0.01]]))
    calm, busy = (
        replace(series_for(model, 1), u=np.full((T, 1), 2.0)),
        series_for(model, 2),
    )
    for series in (calm, busy, calm):
        assert_same(*both(model, thetas_of(model, 1), series, monkeypatch))


def test_a_function_of_too_many_ways_is_called(monkeypatch):
    def dynamics(a, u, t, dt, theta):
        for i in range(T):
            if t < 0.1 * i:
                return (1.0 - 0.01 * i) * theta.k * a, np.zeros((1, 0)), [[0.01]]
        return theta.k * a, np.zeros((1, 0)), [[0.01]]

    model = level(dynamics)
    taped, called = both(model, thetas_of(model, 1), series_for(model, 1), monkeypatch)
    assert taped is None
    assert np.isfinite(called.log_likelihood).all()


def test_what_one_side_says_otherwise_when_called_is_seen(monkeypatch):
    """A way that does not say what the function does, met in the middle of a record."""
    asked = []

    def dynamics(a, u, t, dt, theta):
        if u[0] > 2.0:
            asked.append(isinstance(a, np.ndarray) and a.dtype == object)
            return (0.5 if asked[-1] else theta.k) * a, np.zeros((1, 0)), [[0.01]]
        return theta.k * a, np.zeros((1, 0)), [[0.01]]

    model = level(dynamics)
    series = replace(series_for(model, 1), u=np.where(np.arange(T) == 30, 3.0, 1.0)[:, None])
    taped, called = both(model, thetas_of(model, 1), series, monkeypatch)
    plain = level(lambda a, u, t, dt, theta: (theta.k * a, np.zeros((1, 0)), [[0.01]]))
    right = both(plain, thetas_of(model, 1), series, monkeypatch)[1]
    np.testing.assert_allclose(called.log_likelihood, right.log_likelihood, rtol=1e-9)
    if taped is not None:
        assert_same(taped, right)


def test_parameters_that_decide_alone_leave_one_side(monkeypatch):
    def by_parameter(a, u, t, dt, theta):
        return (0.5 * a if theta.k > 0.9 else theta.k * np.tanh(a)), np.zeros((1, 0)), [[0.01]]

    model, series = level(by_parameter), series_for(level(by_parameter), 1)
    for k in (0.8, 0.95, 0.7, 0.99):
        assert_same(*both(model, np.array([[k], [k + 1e-6]]), series, monkeypatch))
    assert_same(*both(model, np.array([[0.8], [0.95]]), series, monkeypatch))  # rows on both
    lines = [
        moving_on_tape(
            FilterSteps(model, Thetas(model, np.array([[k], [k]])), series), np.ones((6, 1))
        ).lines
        for k in (0.8, 0.95)
    ]
    assert len(lines[0].codes) > len(lines[1].codes)


def test_lines_that_are_made_once_hold_for_other_parameters(monkeypatch):
    """An exponent among them that is 2, and others; in one row, in all alike, and in each another."""

    def powers(a, u, t, dt, theta):
        return theta.k * np.abs(a) ** theta.n + theta.c * u[0], np.zeros((1, 0)), [[theta.q]]

    names = {"k": 0.3, "n": 2.0, "c": 0.1, "q": 0.01}
    parameters = [Parameter(name, value, bounds=(0.0, 4.0)) for name, value in names.items()]
    model = replace(level(powers), parameters=parameters)
    series, first = series_for(model, 1), np.asarray(model.theta())
    for moved in ([], [1], [0], [1, 3], [0, 1, 2, 3], [2], [], [1]):
        for factor in (1.0, 1.2):
            thetas = np.tile(first, (K, 1))
            thetas[:, moved] *= factor * np.linspace(1.0, 1.1, K)[:, None]
            assert_same(*both(model, thetas, series, monkeypatch))
            assert_same(*both(model, thetas[1:2], series, monkeypatch))


def test_a_way_that_is_new_is_looked_at_from_its_beginning(monkeypatch):
    def by_parameter(a, u, t, dt, theta):
        return (0.5 * a if theta.k > 0.9 else theta.k * a), np.zeros((1, 0)), [[0.01]]

    model, asked = level(by_parameter), []
    series = series_for(model, 1)

    def agrees(self, t, a=None, share=None, lost=None):
        asked.append(t)
        return True

    monkeypatch.setattr(OnTape, "agrees", agrees)
    for k, first in ((0.8, 2), (0.8, 2), (0.8, 2), (0.8, 0), (0.95, 1)):
        asked.clear()
        assert run_on_tape(FilterSteps(model, Thetas(model, np.array([[k]])), series)) is not None
        assert asked.count(0) == first  # of the reading and the step


def test_one_that_always_holds_does_not(monkeypatch):
    def guarded(a, u, t, dt, theta):
        return (theta.k if t > -1.0 else 0.5) * a, np.zeros((1, 0)), [[0.01]]

    model = level(guarded)
    taped, called = both(model, thetas_of(model, 1), series_for(model, 1), monkeypatch)
    assert_same(taped, called)


def test_what_a_function_changes_its_mind_about_is_seen():
    """A number of the script that is another at the second fit."""
    wanted = {"k": 0.5}

    def dynamics(a, u, t, dt, theta):
        return wanted["k"] * a, np.zeros((1, 0)), [[0.01]]

    model = level(dynamics)
    series, thetas = series_for(model, 1), thetas_of(model, 1)
    for _ in range(5):
        first = moment_filter(model, thetas, series).log_likelihood
    wanted["k"] = 0.8
    second = moment_filter(model, thetas, series).log_likelihood
    other = level(dynamics)
    np.testing.assert_allclose(second, moment_filter(other, thetas, series).log_likelihood)
    assert (second != first).all()


@pytest.mark.parametrize(
    "function",
    [
        lambda x: np.interp(x, np.linspace(0.0, 2.0, 401), np.linspace(0.0, 1.5, 401) ** 2),
        lambda x: np.arange(402.0)[np.searchsorted(np.linspace(0.0, 2.0, 401), x)],
        lambda x: np.eye(3)[np.int64(x) % 3, 1],
        lambda x: np.logaddexp(x, 0.5),
    ],
)
def test_what_the_kernel_does_not_know_is_called(function, monkeypatch):
    def dynamics(a, u, t, dt, theta):
        return theta.k * function(a[:, 0])[:, None], np.zeros((1, 0)), [[0.01]]

    model = level(dynamics)
    taped, called = both(model, thetas_of(model, 1), series_for(model, 1), monkeypatch)
    assert taped is None
    assert np.isfinite(called.log_likelihood).all()


@pytest.mark.parametrize(
    "function",
    [
        np.sin, np.tanh, np.sqrt, np.log1p, np.arctan, np.floor, np.sign, np.expm1, np.square,
        np.abs, np.cosh, lambda x: x**3, lambda x: x**2, lambda x: np.maximum(x, 0.5),
        lambda x: np.where((x > 0.2) & (x < 1.0) | ~(x < 2.0), x, 0.1 * x),
        lambda x: np.clip(x, 0.1, 0.8), lambda x: np.arctan2(x, 1.0), lambda x: x % 0.7,
        lambda x: np.hypot(x, 1.0), lambda x: np.exp(-(x**2)), lambda x: 1.0 / (1.0 + x * x),
        lambda x: np.copysign(1.0, x), lambda x: np.logical_or(x > 1.0, x < 0.0) * x,
        np.cbrt, np.arcsinh, expit, lambda x: np.arccosh(1.0 + x), lambda x: np.arctanh(np.sin(x)),
        lambda x: x // 0.7, lambda x: np.heaviside(x - 0.5, 0.5), lambda x: np.fmax(x, 0.5),
        lambda x: np.fmin(0.5, x), lambda x: np.float_power(x, 1.5),
        lambda x: np.interp(x, [0.2, 1.0, 2.0, 2.1], [0.1, 1.0, 1.5, 1.2]),
        lambda x: np.interp(x, np.linspace(0.0, 9.0, 100), np.linspace(0.0, 3.0, 100) ** 0.5),
        lambda x: np.searchsorted([0.2, 1.0, 1.0, 2.0], x),
        lambda x: np.searchsorted([0.2, 1.0, 1.0, 2.0], np.floor(x), side="right"),
        lambda x: np.array([0.1, 0.7, 0.3])[-1 - np.searchsorted([0.2, 1.0], x)],
        lambda x: np.array([1.0, 2.0, 3.0])[x.astype(int) % 3],
        lambda x: np.piecewise(x, [x < 0.3, x > 1.0], [0.2, np.sqrt, lambda x: x**2]),
        lambda x: np.piecewise(x, [x > 0.1, x > 1.0], [np.sin, 0.7]),
    ],
)  # fmt: skip
def test_functions_of_numpy(function, monkeypatch):
    def dynamics(a, u, t, dt, theta):
        x = np.abs(a[:, 0]) + 0.1 * u[0]
        return theta.k * function(x)[:, None], np.zeros((1, 0)), [[0.01]]

    model = level(dynamics)
    taped, called = both(model, thetas_of(model, 1), series_for(model, 1), monkeypatch)
    assert_same(taped, called)


@pytest.mark.parametrize(
    "function",
    [
        lambda x, th: max(0.0, min(x, th.k, 0.8)),
        lambda x, th: max(x - 0.4, 0.1) + math.floor(3.0 * x) + math.ceil(x) + math.trunc(x),
        lambda x, th: x * math.isclose(x, th.k, abs_tol=0.5),
        lambda x, th: float(np.interp(x, [0.2, 1.0, 2.0], [0.1, th.k, 1.5 * th.k])),
        lambda x, th: np.array([1.0, 2.0, 3.0])[int(x) % 3],
        lambda x, th: np.array([0.1, th.k, 0.8, 2.0])[bisect.bisect([0.2, 1.0, 2.0], x)],
    ],
)
def test_functions_of_python_in_a_loop_over_particles(function, monkeypatch):
    def dynamics(a, u, t, dt, theta):
        x = [theta.k * function(x + 0.1 * u[0], theta) for x in np.abs(a[:, 0])]
        return np.array(x)[:, None], np.zeros((1, 0)), [[0.01]]

    model = level(dynamics)
    taped, called = both(model, thetas_of(model, 1), series_for(model, 1), monkeypatch)
    assert_same(taped, called)


X = np.linspace(-3.0, 4.0, 15)
CURVES = (
    CubicSpline(X, np.sin(X)),
    CubicSpline(X, np.sin(X), extrapolate=False),
    PchipInterpolator(X, np.sin(X)),
    Akima1DInterpolator(X, np.sin(X)),
    make_interp_spline(X, np.sin(X)),
    UnivariateSpline(X, np.sin(X), s=0.1),
    UnivariateSpline(X, np.sin(X), s=0.0, ext="const"),
    UnivariateSpline(X, np.sin(X), s=0.0, ext="zeros"),
    interp1d(X, np.sin(X), fill_value="extrapolate"),
    interp1d(X, np.sin(X), kind="cubic", bounds_error=False, fill_value=(0.0, 1.0)),
    interp1d(X, np.sin(X)),
    CubicSpline(X, np.sin(X)).derivative(),
)


@pytest.mark.parametrize("curve", CURVES, ids=lambda curve: type(curve).__name__)
def test_curves_of_scipy(curve, monkeypatch):
    """Given to the function as users do: under a name, and as the default of an argument."""

    def dynamics(a, u, t, dt, theta, own=curve):
        return theta.k * curve(a[:, 0])[:, None] + 0.1 * own(u[0]), np.zeros((1, 0)), [[0.01]]

    model, rng = level(dynamics), np.random.default_rng(3)
    series = replace(series_for(model, 1), u=rng.uniform(-2.9, 3.9, (T, 1)))
    assert_same(*both(model, thetas_of(model, 1), series, monkeypatch))


def test_beyond_its_ends_a_curve_is_what_scipy_says():
    """Read far outside, where each kind goes on in another way or has no value."""
    far = np.array([-9.0, -3.1, -3.0, 0.37, 1.0, 4.0, 4.2, 20.0])
    for curve in CURVES:
        model = level(lambda a, u, t, dt, th, f=curve: (f(a), np.zeros((1, 0)), [[0.01]]))
        found = [pieces_of(curve).at(far)]
        expected = curve(far) if not pieces_of(curve).raises else None
        if expected is not None:
            np.testing.assert_allclose(found[0], expected, rtol=1e-12, atol=1e-12)
            taken, *_ = model.transition(far[:, None], [0.0], 0.0, 1.0, model.record(model.theta()))
            np.testing.assert_allclose(taken[:, 0], expected, rtol=1e-12, atol=1e-12)
    model = level(lambda a, u, t, dt, th: (CURVES[-2](a), np.zeros((1, 0)), [[0.01]]))
    with pytest.raises(ModelError, match="interpolation range"):
        model.transition(far[:, None], [0.0], 0.0, 1.0, model.record(model.theta()))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("n", [1, 2, 3, 4, 6])
def test_equations_that_are_solved_in_a_step(n, seed, monkeypatch):
    """An implicit step with pivots in any order, and matrices that states change."""
    rng = np.random.default_rng(seed)
    M, w, c = rng.standard_normal((n, n)), rng.standard_normal(n), rng.standard_normal((n, n))

    def dynamics(a, u, t, dt, theta):
        rows = np.array([w * theta.k * np.tanh(x[0]) + 0.1 * u[0] for x in a])
        fixed = np.array([np.linalg.solve(M, row) for row in rows])
        moving = M + c * a[:, 0, None, None] if n < 5 else M * theta.k
        moved = (
            np.linalg.solve(moving, rows[:, :, None])[:, :, 0]
            if n < 5
            else rows @ np.linalg.inv(moving)
        )
        return 0.1 * np.tanh(fixed + moved).sum(axis=1)[:, None], np.zeros((1, 0)), [[0.01]]

    model = level(dynamics)
    assert_same(*both(model, thetas_of(model, 1), series_for(model, 1), monkeypatch))


@pytest.mark.parametrize("even", [True, False])
def test_what_inputs_and_times_alone_tell_may_be_any_function(even, monkeypatch):
    curve = CubicSpline([-5.0, 0.0, 2.0, 6.0], [0.0, 0.4, 1.0, 0.7])

    def dynamics(a, u, t, dt, theta):
        valve = curve(u[0]) * np.logaddexp(0.0, t) / dt
        return (
            [theta.k * a[:, 0] + 0.1 * np.tanh(valve) * (valve > 1.0)],
            np.zeros((1, 0)),
            [[0.01]],
        )

    model = level(dynamics)
    series, thetas = series_for(model, 1, even), thetas_of(model, 1)
    taped, called = both(model, thetas, series, monkeypatch)
    assert_same(taped, called)
    own = moving_on_tape(FilterSteps(model, Thetas(model, thetas), series), np.zeros((3 * K, 1)))
    assert own.u.shape[1] > series.u.shape[1]
    assert own.u.flags.c_contiguous  # the one layout that kernels are compiled for


def test_an_entry_that_no_table_has_leaves_the_tape():
    """A call says what is wrong; it is met after some time only."""
    table = np.array([0.9, 0.95, 1.0])

    def dynamics(a, u, t, dt, theta):
        return theta.k * table[np.int64(np.abs(a[:, 0]) + t)][:, None], np.zeros((1, 0)), [[0.01]]

    model = level(dynamics)
    with pytest.raises(ModelError, match="index"):
        moment_filter(model, thetas_of(model, 1), series_for(model, 1))


def test_a_filter_that_is_lost_is_lost_on_tape_too():
    def dynamics(a, u, t, dt, theta):
        return np.exp(theta.k * a), np.zeros((1, 0)), [[0.01]]

    model = level(dynamics)
    thetas = np.array([[0.2], [2.0]])
    found = moment_filter(model, thetas, series_for(model, 1)).log_likelihood
    assert np.isfinite(found[0])
    assert found[1] == -np.inf


@pytest.mark.parametrize("off", [1e-6, 1e-4, 1e-2])
@pytest.mark.parametrize("differential", [False, True])
def test_a_step_of_differential_equations_may_differ_from_its_tape_by_what_differences_round(
    differential, off
):
    """In a first row, which may be at rest. Of other models nothing is a difference."""
    discrete = level(lambda a, u, t, dt, th: (th.k * a, np.zeros((1, 0)), [[0.01]]))
    model = pendulum() if differential else discrete
    run = FilterSteps(model, Thetas(model, thetas_of(model, 1)[:1]), series_for(model, 1))
    a = np.full((1, model.na), 0.2)
    own = moving_on_tape(run, a)
    right = own.call
    own.call = lambda t, a: tuple(x * (1.0 + off) for x in right(t, a))
    assert own.begins_well(a) is (differential and off < 1e-3)


def reactor():
    """A reaction that heats itself; a step of a whole sample may run away with it."""

    def drift(a, u, t, theta):
        c, temp = a[:, 0], a[:, 1]
        rate = theta.k * np.exp(-8750.0 / temp) * c
        return [1.0 - c - rate, 350.0 - temp + 209.0 * rate + 2.0 * (u[0] - temp)], np.zeros((2, 0))

    return continuous(
        name="reactor",
        drift=drift,
        diffusion=lambda a, u, t, theta: np.diag([6e-3, 3.0]),
        measurement=lambda a, u, t, theta: ([a[:, 1]], np.zeros((1, 0)), [[1.0]]),
        initial=lambda theta: (
            Gaussian([0.9, 320.0], [[0.01, 0.0], [0.0, 4.0]]),
            np.zeros(0),
            np.zeros((0, 0)),
        ),
        nonlinear={"c": "mol/L", "temp": "K"},
        linear={},
        inputs={"coolant": "K"},
        outputs={"y": "K"},
        parameters=[Parameter("k", 6e10, "1/min", (1e8, 1e12))],
    )


def reactor_run(seed):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(290.0, 310.0, 30), 10)
    y = 350.0 + 2.0 * np.cumsum(rng.standard_normal(300))
    model = reactor()
    return FilterSteps(model, Thetas(model, np.array([[1e9], [1.001e9]])), Series(y, u, dt=0.1))


def test_a_filter_that_is_lost_says_nothing_about_the_tape():
    """So far off that differences by the states are rounding, calls and the tape differ by that."""
    run = reactor_run(0)
    a = np.repeat([[0.9, 320.0], [1.7e-11, -2.6e182]], 5, axis=0)
    moving = moving_on_tape(run, a)
    assert moving.agrees(5, a, lost=np.array([False, True]))
    assert not moving.agrees(5, a)


@pytest.mark.parametrize("seed", range(4))
def test_an_entry_of_a_covariance_is_small_beside_both_deviations(seed):
    """Next to nothing in a step's Q is rounding of differences, and no reason to give up the tape."""
    found = run_on_tape(reactor_run(seed))
    assert found is not None
    assert np.isfinite(found.log_likelihood).all()
