"""Functions written for one time and one parameter vector, evaluated for many rows as they are alone."""

import bisect
import copy
import functools
import math
import pickle
from dataclasses import dataclass, replace
from types import SimpleNamespace

import hypothesis.strategies as st
import numba
import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from hypothesis import Phase, given, settings
from numpy.linalg import solve
from scipy.interpolate import CubicSpline, RegularGridInterpolator, interp1d
from scipy.special import expit

import engine
from engine import Gaussian, MixedModel, Parameter, Series
from engine.errors import ModelError
from engine.filters.sigma_point import moment_filter
from engine.statespace.recorded import NotByRowsError, by_rows, of_numpy
from engine.statespace.recorded.paths import Path, graft

M = 60
GRAVITY = 9.81
TABLE = (np.array([-1.0, 0.0, 2.0]), np.array([0.5, 0.0, 3.0]))
SHAPE = np.array([[1.0, 0.5], [0.0, 1.0]])


def helper(x, y=2.0):
    return math.tanh(x) / y if x > 0 else x


@functools.cache
def remembered(w, dt):
    return math.exp(-w * dt)


def matrices(a, u, t, dt, th):
    A = np.zeros((2, 1))
    A[0, 0] = math.exp(-th.w * dt)
    A[1] += th.w * t
    return [A[0, 0] * a[:, 0], th.k * u[0]], A, np.diag([th.q, 1e-4])


def conditions(a, u, t, dt, th):
    f = th.k * u[0] if u[0] > 0.3 else -u[0]
    if t > 5.0 and not (th.w < 1.0 or u[1] < 0):
        f = f + 1.0
    return [a[:, 0] + f, max(th.w, 1.0, u[1]) + min(u[0], t)], [[0.1], [0.2]], th.q * np.eye(2)


def systems(a, u, t, dt, th):
    F = np.array([[0.0, 1.0], [-(th.w**2), -2.0 * th.k * th.w]])
    A, B, Q = engine.discretize(F, [[0.0], [1.0]], np.diag([0.0, th.q]), dt=dt)
    f = [B[i, 0] * u[0] + A[i, 0] * a[:, 0] for i in range(2)]
    return f, A[:, 1:], Q + 1e-9 * np.eye(2)


def algebra(a, u, t, dt, th):
    F = [[-th.w, 0.5], [u[1], -2.0]]
    A = scipy.linalg.expm(np.asarray(F) * dt)
    x = solve(np.array([[2.0 + th.k, 0.1], [0.2, 3.0]]), np.array([u[0], t]))
    B = np.linalg.inv(np.eye(2) + 0.1 * A @ A.T)
    f = [x[0] + A[0, 0] * a[:, 0], (x + A @ np.array([th.k, 1.0]))[1]]
    return f, B[:, :1], np.eye(2) * th.q + SHAPE @ SHAPE.T


def functions(a, u, t, dt, th):
    w = float(th.w)
    rate = np.interp(u[0], *TABLE) + helper(u[1], y=3.0) + math.log(w, 2.0) + math.atan2(u[0], w)
    swing = np.where(a[:, 0] > 0, np.sqrt(np.abs(a[:, 0])), -a[:, 0]) + np.clip(u[1], -0.5, th.k)
    level = np.linalg.norm(np.array([th.w, th.k, u[0]])) + np.hypot(th.w, u[0]) + expit(th.k)
    return (
        [swing + rate, level - GRAVITY % th.w],
        [[remembered(w, dt)], [t // 2.0]],
        np.diag([th.q] * 2),
    )


def loops(a, u, t, dt, th):
    x, n, force = [a[:, 0], 0.1], 5, math.sin(th.w * t) if t > 1.0 else 0.0
    for _ in range(n):
        slope = [x[1], -(th.w**2) * np.sin(x[0]) + u[0] * force]
        x = [xi + dt / n * si for xi, si in zip(x, slope, strict=True)]
    return x, np.reshape([th.k, 0.0], (2, 1)), [[th.q, 0.0], [0.0, th.q]]


def substeps(a, u, t, dt, th):
    x = [a[:, 0], th.w]
    for k in range(max(1, int(dt / 0.03))):
        x = [x[0] - 0.03 * k * th.w, x[1] + (k == 1) * u[0]]
    return x, SHAPE[:, :1], np.diag([th.q, th.q])


def types(a, u, t, dt, th):
    if isinstance(th.w, float) and np.isscalar(th.k) and not isinstance(u[0], np.ndarray):
        out = np.array([th.w, th.k], dtype=float)
    else:
        out = np.zeros(2)
    return out.astype(float), np.full((2, 1), th.k), np.identity(2, dtype=np.float64) * th.q


def seldom(a, u, t, dt, th):
    """What it has beyond 2.2 is met by few rows."""
    return (
        [a[:, 0] + (100.0 * th.w if abs(u[0]) > 2.2 else 0.0), u[1]],
        SHAPE[:, :1],
        th.q * np.eye(2),
    )


def indexed(a, u, t, dt, th):
    return [a[:, 0], (1.0, 2.0, 3.0)[int(t) % 3] * th.w], SHAPE[:, :1], np.diag([th.q, th.q])


def caught(a, u, t, dt, th):
    try:
        n = range(int(10 * th.w))
    except Exception:  # noqa: BLE001 - as users write it
        n = ()
    return [a[:, 0], float(len(n))], SHAPE[:, :1], np.diag([th.q, th.q])


def averages(a, u, t, dt, th):
    speed = np.linalg.norm(np.array([[th.w, u[0]], [th.k, u[1]]]), axis=1)
    level = np.mean(speed) + np.array([th.w, th.k]).mean() + np.round(u[0], 1) + np.sinc(u[1])
    table = np.array([[th.w, u[0]], [u[1], th.k]])
    level = level + np.abs(table).max() + table.min() + np.max(table, axis=0)[1]
    return [a[:, 0] + level, np.deg2rad(u[0])], SHAPE[:, :1] * np.mean(th.w), th.q * np.eye(2)


class Pump:
    def flow(self, w):
        return 2.0 * w


class Worn(Pump):
    def flow(self, w):
        return 0.9 * super().flow(w)


def inherited(a, u, t, dt, th):
    return [a[:, 0] * Worn().flow(th.w), u[0]], SHAPE[:, :1], th.q * np.eye(2)


WRITTEN = (
    *(matrices, conditions, systems, algebra, functions, loops, substeps, types, seldom),
    *(indexed, caught, averages, inherited),
)


def keyed(a, u, t, dt, th):
    gain = {0.0: 1.0}.get(round(t), 2.0) + len(f"{th.w:.3f}")
    return [a[:, 0], gain * th.w], SHAPE[:, :1], np.diag([th.q, th.q])


REFUSED = (keyed,)


def model_of(dynamics, **changed):
    return MixedModel(
        name=dynamics.__name__,
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([a[:, 0]], np.array([[theta.k]]), [[0.1]]),
        initial=lambda theta: (Gaussian([0.1], [[1.0]]), [0.0], [[1.0]]),
        nonlinear={"x": "1"},
        linear={"z": "1"},
        inputs={"u": "1", "v": "1"},
        outputs={"y": "1"},
        parameters=[
            Parameter("w", 1.1, "1", (0.0, 9.0)),
            Parameter("k", 0.4, "1", (0.0, 9.0)),
            Parameter("q", 0.1, "1", (1e-9, 9.0)),
        ],
        **changed,
    )


def rows_of(seed, model, M=M):
    rng = np.random.default_rng(seed)
    thetas = np.asarray(model.theta()) * rng.uniform(0.6, 1.6, (M, 3))
    u = rng.standard_normal((2, M))
    return rng.standard_normal((M, 1)), u, rng.uniform(0.0, 10.0, M), 0.1, model.records(thetas)


def alone(model, a, u, t, dt, theta):
    """Every row in a call of its own, by the function itself."""
    out = []
    for i in range(len(a)):
        own = model.record(np.array([v[i] if np.ndim(v) else v for v in theta]))
        f, A, Q = model.dynamics(a[i : i + 1], u[:, i], float(t[i]), dt, own)
        f = np.array(
            [np.asarray(x).item() for x in np.asarray(f, dtype=object).ravel()], dtype=float
        )
        out.append((f, np.array(A, dtype=float), np.array(Q, dtype=float)))
    return [np.array(x) for x in zip(*out, strict=True)]


def assert_same(got, expected):
    for x, y in zip(got, expected, strict=True):
        x = np.broadcast_to(x, y.shape)
        np.testing.assert_allclose(x, y, rtol=1e-11, atol=1e-13 * (1.0 + np.abs(y).max()))


@pytest.mark.long
@pytest.mark.parametrize("written", WRITTEN, ids=lambda f: f.__name__)
@settings(max_examples=8, deadline=None, derandomize=True, phases=[Phase.generate])
@given(seed=st.integers(0, 10**6))
def test_rows_are_what_they_are_alone(written, seed):
    model = model_of(written)
    for k in range(4):
        given = rows_of(seed + k, model)
        assert_same(model.transition(*given), alone(model, *given))
    assert model.transitions.recorded


@pytest.mark.parametrize("written", REFUSED, ids=lambda f: f.__name__)
def test_what_becomes_a_text_is_called_row_by_row(written):
    model = model_of(written)
    for seed in range(3):
        given = rows_of(seed, model)
        assert_same(model.transition(*given), alone(model, *given))
    assert not model.transitions.recorded


@pytest.mark.parametrize("written", WRITTEN, ids=lambda f: f.__name__)
def test_parameters_side_by_side_are_filtered_as_alone(written):
    model = model_of(written)
    rng = np.random.default_rng(3)
    series = Series(rng.standard_normal(40), rng.standard_normal((40, 2)), dt=0.1)
    thetas = np.asarray(model.theta()) * rng.uniform(0.9, 1.1, (5, 3))
    got = moment_filter(model, thetas, series).log_likelihood
    each = [moment_filter(replace(model), row[None], series).log_likelihood[0] for row in thetas]
    np.testing.assert_allclose(got, each, rtol=1e-9)


@pytest.mark.parametrize("alike", [1e-11, -1.0])
def test_exponentials_are_by_a_kernel_or_of_each_distinct_matrix(alike, monkeypatch):
    """SciPy takes one matrix of a stack after the other: where the kernel differs, no more than it must."""
    taken, own = [], scipy.linalg.expm
    monkeypatch.setattr(of_numpy, "ALIKE", alike)
    model = model_of(algebra)
    a, u, t, dt, _ = rows_of(5, model, 200)
    u = np.tile(u[:, :1], 200)
    thetas = np.tile(np.asarray(model.theta()), (200, 1))
    thetas[100:, 0] = 0.9
    theta = model.records(thetas)
    model.transition(a, u, t, dt, theta)
    monkeypatch.setattr(scipy.linalg, "expm", lambda M: (taken.append(M.size // 4), own(M))[1])
    found = model.transition(a, u, t, dt, theta)
    monkeypatch.undo()
    assert sum(taken) < 100  # most of them calls that check it
    assert_same(found, alone(model, a, u, t, dt, theta))


def test_what_is_known_is_not_asked_again():
    made = []

    def counted(*given):
        made.append(1)
        return keyed(*given)

    model = model_of(counted)
    given = rows_of(0, model)
    assert not model.transitions.takes(*given)
    made.clear()
    assert not model.transitions.takes(*given)
    assert not made


def test_few_calls_are_made_and_none_for_rows_that_were_met_before():
    made = []

    def dynamics(*given):
        made.append(1)
        return conditions(*given)

    model = model_of(dynamics)
    for seed in range(3):
        model.transition(*rows_of(seed, model, 1000))
    made.clear()
    for seed in range(10, 14):
        model.transition(*rows_of(seed, model, 1000))
    assert len(made) < 60  # 4000 rows


def test_a_way_that_is_met_late_is_recorded_then():
    model = model_of(seldom)
    a, u, t, dt, theta = rows_of(0, model)
    for _ in range(3):
        model.transition(a, np.clip(u, -2.0, 2.0), t, dt, theta)
    u = np.clip(u, -2.0, 2.0)
    u[0, 17] = 2.5
    assert_same(model.transition(a, u, t, dt, theta), alone(model, a, u, t, dt, theta))


def test_a_function_with_too_many_ways_is_called_row_by_row():
    def dynamics(a, u, t, dt, th):
        k = 0.0
        while k < 50.0 * abs(u[0]):
            k = k + 1.0
        return [a[:, 0], k * th.w], SHAPE[:, :1], np.diag([th.q, th.q])

    model = model_of(dynamics)
    given = rows_of(0, model)
    for _ in range(3):
        assert_same(model.transition(*given), alone(model, *given))
    assert not model.transitions.recorded


def test_a_value_that_does_not_exist_is_told_as_the_function_tells_it():
    def dynamics(a, u, t, dt, th):
        return [math.sqrt(th.w - 1.0) * a[:, 0], 1.0], SHAPE[:, :1], np.diag([th.q, th.q])

    model = model_of(dynamics)
    a, u, t, dt, theta = rows_of(0, model)
    theta = theta._replace(w=np.linspace(1.1, 2.0, M))
    for _ in range(2):
        model.transition(a, u, t, dt, theta)
    assert model.transitions.recorded
    lost = theta._replace(w=np.linspace(0.9, 2.0, M))
    f, _, _ = model.transition(a, u, t, dt, lost)
    assert np.isnan(f[:, 0]).tolist() == (lost.w < 1.0).tolist()
    with pytest.raises(engine.errors.ModelError, match="math domain error"):
        model.transition(a, u, t, dt, theta._replace(w=np.linspace(0.5, 0.9, M)))
    assert_same(model.transition(a, u, t, dt, theta), alone(model, a, u, t, dt, theta))


def test_what_a_function_is_not_given_may_change_between_passes():
    """A constant of the script, changed on the way: it is looked at again whenever a record is."""
    planet = SimpleNamespace(gravity=9.81)

    def dynamics(a, u, t, dt, th):
        return [a[:, 0] - 0.01 * planet.gravity, float(th.w)], SHAPE[:, :1], np.diag([th.q, th.q])

    model = model_of(dynamics)
    given = rows_of(0, model)
    for _ in range(3):
        model.transition(*given)
    assert model.transitions.recorded
    planet.gravity = 3.7
    model.transitions.look_again()
    assert_same(model.transition(*given), alone(model, *given))


def looped(a, u, t, dt, th):
    """As somebody writes it who thinks of one particle after the other."""
    rows = []
    for (x,) in a:
        flow = th.k * (x - th.w) if x > th.w else 0.0
        rows.append([x - dt * flow + u[0], min(x, 1.0)])
    return np.array(rows), SHAPE[:, :1], np.diag([th.q, th.q])


def test_a_loop_over_particles_is_gone_through_once():
    made = []

    def dynamics(a, u, t, dt, th):
        rows = []
        for (x,) in a:
            made.append(1)
            flow = th.k * (x - th.w) if x > th.w else 0.0
            rows.append([x - dt * flow + u[0], min(x, 1.0)])
        return np.array(rows), SHAPE[:, :1], np.diag([th.q, th.q])

    rng, model = np.random.default_rng(0), model_of(dynamics)
    record = model.record(model.theta())
    for k in range(40):
        a, u = 2.0 * rng.standard_normal((100, 1)), rng.standard_normal(2)
        f, _, _ = model.transition(a, u, 0.1 * k, 0.1, record)
        np.testing.assert_allclose(f, looped(a, u, 0.1 * k, 0.1, record)[0], rtol=1e-12)
    assert model.transitions.recorded
    assert len(made) < 400  # of 4000 particles
    given = rows_of(0, model)
    assert_same(model.transition(*given), alone(model, *given))


def test_a_loop_over_states_is_none_over_particles():
    def dynamics(a, u, t, dt, th):
        f = [a[:, i] * th.w for i in range(1)]
        return (
            [*f, a[:, 0] @ a[:, 0] * 0.0 + 1.0 if len(a) < 0 else 1.0],
            SHAPE[:, :1],
            np.diag([th.q] * 2),
        )

    model = model_of(dynamics)
    for k in range(4):
        model.transition(np.ones((9, 1)) * k, np.ones(2), 0.0, 0.1, model.record(model.theta()))
    assert not model.transitions.recorded


def test_particles_that_influence_each_other_in_a_loop_are_refused():
    def dynamics(a, u, t, dt, th):
        total, rows = 0.0, []
        for (x,) in a:
            total = total + x
            rows.append([total, 1.0])
        return np.array(rows), SHAPE[:, :1], np.diag([th.q, th.q])

    model = model_of(dynamics)
    given = np.arange(9.0)[:, None], np.ones(2), 0.0, 0.1, model.record(model.theta())
    with pytest.raises(engine.errors.ModelError, match="depends on the other rows"):
        model.transition(*given)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_differential_equations_of_numbers_are_recorded_too(hold):
    def drift(a, u, t, th):
        A = np.array([[1.0], [-th.k]])
        return [0.0, u[0] - (th.w if u[1] > 0 else 0.5) * np.sin(a[:, 0])], A

    model = engine.continuous(
        name="pendulum",
        drift=drift,
        diffusion=lambda a, u, t, th: np.diag([0.0, th.q]),
        **{
            name: value
            for name, value in vars(model_of(loops)).items()
            if name
            in ("measurement", "initial", "nonlinear", "linear", "inputs", "outputs", "parameters")
        },
    )
    rng = np.random.default_rng(1)
    series = Series(rng.standard_normal(30), rng.standard_normal((30, 2)), dt=0.1, hold=hold)
    thetas = np.asarray(model.theta()) * rng.uniform(0.9, 1.1, (5, 3))
    got = moment_filter(model, thetas, series).log_likelihood
    each = [moment_filter(replace(model), row[None], series).log_likelihood[0] for row in thetas]
    np.testing.assert_allclose(got, each, rtol=1e-9)


# what the first look must not let pass, each wrong where it is done as arrays do it


def counted(a, u, t, dt, th):
    return [a[:, 0] + ((th.w > 1.0) + (th.k > 0.4)), sum([u[0] > 0, u[1] > 0])], SHAPE[:, :1], Q


def counted_seldom(a, u, t, dt, th):
    n = (th.w > 1.1) + (th.k > 0.4) if u[0] > 1.5 else 0
    return [a[:, 0] + n, math.sin(th.w)], SHAPE[:, :1], Q


def of_booleans(a, u, t, dt, th):
    marks = np.zeros(2)
    marks[0], marks[1] = th.w > 1.0, th.k > 0.4
    return [math.exp(th.w > 1.0), marks.sum()], SHAPE[:, :1], Q


def bits(a, u, t, dt, th):
    return [1.0 if math.floor(t) & 1 else -1.0, a[:, 0]], SHAPE[:, :1], Q


def catches_all(a, u, t, dt, th):
    n = 0
    if u[0] > 1.5:
        try:
            n = int(3 * th.w)
        except:  # noqa: E722 - as users write it
            n = 7
    return [math.sin(th.w), n * 1.0], SHAPE[:, :1], Q


def catches_errors(a, u, t, dt, th):
    try:
        rate = math.log(u[0] - 1.0)
    except Exception:  # noqa: BLE001 - as users write it
        rate = -7.0
    return [math.sin(th.w), rate], SHAPE[:, :1], Q


def aliases(a, u, t, dt, th):
    x = np.zeros(2)
    y = np.asarray(x)
    y[0] = math.sin(th.w)
    z = x.astype(float)
    z[1] = 5.0
    return x + np.array([u[0], th.k], ndmin=2)[0], SHAPE[:, :1], Q


def zeros(a, u, t, dt, th):
    return (
        np.array([[0.0, 1.0], [1.0, math.sin(th.w)]]) @ np.array([a[0, 0], u[0]]),
        SHAPE[:, :1],
        Q,
    )


def infinite(a, u, t, dt, th):
    v = float(u[0])
    close = math.isclose(v, 0.0, abs_tol=0.1) or np.isclose(v, 0.0, rtol=0.1)
    return [1.0 if close else math.sin(th.w), 1.0 if np.isclose(0.0, v) else 0.0], SHAPE[:, :1], Q


def zeros_of_roots(a, u, t, dt, th):
    with np.errstate(all="ignore"):
        x = np.array([np.sqrt(u[0]), u[1]])
        return np.array([[0.0, 1.0], [1.0, math.sin(th.w)]]) @ x, SHAPE[:, :1], Q


def python_extremes(a, u, t, dt, th):
    return [max(0.0, a[0, 0]), min(a[0, 0], math.sin(th.w))], SHAPE[:, :1], Q


Q = np.diag([0.1, 0.1])
DELICATE = (
    *(counted, counted_seldom, of_booleans, bits, catches_all, catches_errors, aliases),
    *(zeros, zeros_of_roots, python_extremes, infinite),
)


def single(model, a, u, t, dt, theta):
    """As ``alone``, for functions of a single particle."""
    return alone(model, a, u, t, dt, theta)[0]


@pytest.mark.parametrize("written", DELICATE, ids=lambda f: f.__name__)
def test_every_call_gives_what_rows_are_alone_also_the_first(written):
    model = model_of(written)
    for seed in range(6):
        a, u, t, dt, theta = rows_of(seed, model)
        u = np.clip(u, -1.0, 1.0) if seed < 2 else u
        if written in (zeros, python_extremes) and seed > 2:
            a[::3] = np.nan
        f, _, _ = model.transition(a, u, t, dt, theta)
        np.testing.assert_allclose(f, single(model, a, u, t, dt, theta), rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("written", DELICATE, ids=lambda f: f.__name__)
def test_a_recording_of_harmless_rows_is_right_for_others_or_refused(written):
    model = model_of(written)
    made = by_rows(written, ((2,), (2, 1), (2, 2)))
    for seed in range(12):
        a, u, t, dt, theta = rows_of(seed, model)
        u = np.clip(u, -0.9, 0.9) if seed < 2 else u
        if written in (zeros, python_extremes) and seed > 2:
            a[::3] = np.nan
        if written is infinite and seed > 2:
            u[0, ::3] = np.inf
        try:
            f, _, _ = made(a, u, t, dt, theta)
        except NotByRowsError:
            continue
        np.testing.assert_allclose(f, single(model, a, u, t, dt, theta), rtol=1e-11, atol=1e-13)


def typed(a, u, t, dt, th):
    return [math.sin(th.w) if type(th.w) is float else 0.0, u[0]], SHAPE[:, :1], Q


def test_the_first_call_of_what_was_recorded_is_looked_at():
    model = model_of(typed)
    for seed in range(3):
        given = rows_of(seed, model)
        assert_same(model.transition(*given), alone(model, *given))


def test_an_entry_that_a_table_does_not_have_is_told_as_the_function_tells_it():
    def dynamics(a, u, t, dt, th):
        return [DAY[int(u[0])], th.w], SHAPE[:, :1], Q

    made = by_rows(dynamics, ((2,), (2, 1), (2, 2)))
    a, u, t, dt, theta = rows_of(0, model_of(loops))
    made(a, np.clip(u, -1.0, 1.0), t, dt, theta)
    with pytest.raises(NotByRowsError) as told:
        made(a, np.where(u > 0.0, 4.0, u), t, dt, theta)
    assert told.value.here
    with pytest.raises(ModelError, match="index 4 is out of bounds"):
        model_of(dynamics).transition(a, np.where(u > 0.0, 4.0, u), t, dt, theta)


def test_what_arrays_give_where_python_raises_is_left_to_the_function():
    def dynamics(a, u, t, dt, th):
        return [math.gamma(u[0]), math.floor(u[1])], SHAPE[:, :1], Q

    made = by_rows(dynamics, ((2,), (2, 1), (2, 2)))
    a, u, t, dt, theta = rows_of(0, model_of(loops))
    made(a, np.abs(u), t, dt, theta)
    for i, wrong in ((0, -1.0), (0, 1e3), (1, np.inf), (1, np.nan)):
        given = np.abs(u)
        given[i, 3] = wrong
        with pytest.raises(NotByRowsError) as told:
            made(a, given, t, dt, theta)
        assert told.value.here


def masks(a, u, t, dt, th):
    f = math.sin(th.w) * a[:, 0]
    f[f > 0.3] = 0.3
    return [f, u[u > 0.0].sum() + np.sum(u > 0.5)], SHAPE[:, :1], Q


def opened(a, u, t, dt, th):
    A = SHAPE.copy()
    A[0, 1] = math.sin(th.w)
    B = np.diag([1.0, 2.0])
    B *= th.k
    return A @ u + B[1] + np.arange(2, dtype=float), A[:, 1:], Q


def silent(a, u, t, dt, th):
    with np.errstate(invalid="ignore"):
        root = np.where(u[0] > 0, np.sqrt(u[0]), 0.0)
    return [root, math.hypot(u[0], u[1], th.w)], SHAPE[:, :1], Q


def decided(a, u, t, dt, th):
    near = math.isclose(u[0], 0.0, abs_tol=0.1) or np.isclose(u[1], 0.0, atol=0.1)
    n, rest = divmod(t, 3.0)
    w = th.w if isinstance(th.w, int | float) and not hasattr(th.w, "__len__") else 0.0
    chosen = np.select([u[0] < 0, u[0] < 1], [w, u[0]], default=2.0)
    return [chosen + n, rest + (1.0 if near else math.sin(w))], SHAPE[:, :1], Q


def kinds(a, u, t, dt, th):
    gain = {"drag": helper}["drag"](u[0]) + RATES["lift"](u[1]) + np.r_[u[0], th.w].sum()
    F = np.array([[2.0 + th.w**2, 0.1], [0.1, 2.0]])
    level = np.linalg.det(F) + np.linalg.cholesky(F)[1, 0] + float(u[0] > 0) + float(u[1] > 0)
    return [gain, level + max(abs(x) for x in (0.5, -0.7))], SHAPE[:, :1], Q


def heights(a, u, t, dt, th):
    rate = np.interp(u[0], [-1.0, 0.0, 0.5], [th.w, 0.0, th.k]) + np.interp(0.2, (0, 1), (th.k, t))
    limited = np.clip(u[1], a_min=-0.3, a_max=math.sin(th.w)) + np.clip(u, None, 0.1)[0]
    return [a[:, 0] + rate, limited], SHAPE[:, :1], Q


class Curve:
    """A helper as it is written: made in the function, or there for all calls."""

    def __init__(self, low, high):
        self.low, self.high = low, high

    def __call__(self, x):
        return self.low + self.slope * math.tanh(x) if x > 0 else float(self.half(self.low))

    @property
    def slope(self):
        return self.high - self.low

    @staticmethod
    def half(x):
        return math.exp(-x) / 2.0


@dataclass(frozen=True)
class Plant:
    gain: float
    curve: Curve

    @functools.lru_cache(maxsize=10)  # noqa: B019 - as users write it
    def matrix(self, w):
        return np.array([[math.exp(-w), 0.1], [0.0, self.gain]])

    def force(self, x):
        return self.gain * self.curve(x) + self.matrix(x)[0, 0]


PLANT = Plant(0.7, Curve(0.5, 2.0))


def objects(a, u, t, dt, th):
    own, other = Curve(th.w, u[0]), Plant(th.k, PLANT.curve)
    return [own(u[1]) + PLANT.force(th.w), other.force(t)], SHAPE[:, :1], Q


def as_method(a, u, t, dt, th):
    f = PLANT.force(th.w)
    return [f * a[:, 0], PLANT.matrix(th.k)[0] @ u], SHAPE[:, :1], Q


@numba.njit
def compiled(x, w):
    return math.exp(-w) * x if x > 0.0 else x


each_rate = np.vectorize(lambda x, w: math.exp(-w) if x > 0 else helper(x), otypes=[float])


def vectorized(a, u, t, dt, th):
    own = np.vectorize(lambda x: max(x, 0.2) * math.sin(th.w))
    return (
        [own(a[:, 0]) + each_rate(u, th.w)[1], each_rate(t, th.k) + compiled(u[0], th.w)],
        SHAPE[:, :1],
        Q,
    )


SPLINE = CubicSpline([-3.0, -1.0, 0.5, 3.0], [0.0, 0.3, 1.0, 0.7])
LINE = interp1d([-3.0, 0.0, 4.0], [1.0, 0.0, 2.0], fill_value="extrapolate")


FIELD = RegularGridInterpolator(
    ([-9.0, 0.0, 9.0], [-9.0, 9.0]), [[0.0, 1.0], [2.0, 1.0], [3.0, 5.0]]
)


def libraries(a, u, t, dt, th):
    F, G = np.array([[0.0, 1.0], [-(th.w**2), -0.3]]), np.array([[0.0], [th.k]])
    A, B, *_ = scipy.signal.cont2discrete((F, G, np.eye(2), np.zeros((2, 1))), dt)
    S = scipy.linalg.solve_discrete_lyapunov(A, np.diag([th.q, 1e-4]))
    largest = (
        np.linalg.eigvalsh(S)[-1]
        + FIELD((u[0], math.tanh(t))).item()
        + scipy.linalg.block_diag([[th.k]], S)[0, 0]
    )
    f = A @ np.array([u[0], t]) + B[:, 0] * u[1]
    return (
        [f[0] + SPLINE(a[:, 0]) + float(LINE(u[0])), f[1] * largest],
        A[:, 1:],
        S + 1e-9 * np.eye(2),
    )


DAY = np.array([0.0, 1.0, 0.3, 0.5])
MAP = np.arange(12.0).reshape(4, 3) ** 2
YEAR = np.sin(np.arange(2000.0))
GRID = [-1.0, 0.0, 0.7]


def tables(a, u, t, dt, th):
    hour = int(t / 0.5) % 4
    gains = np.array([th.w, th.k, 2.0])
    load = DAY[hour] + MAP[hour] @ np.ones(3) + MAP[hour, round(t) % 3] + YEAR[int(100 * t)]
    place = bisect.bisect(GRID, u[0]) + np.searchsorted(GRID, u[1]) - bisect.bisect_left(GRID, 0.0)
    drift = gains[math.floor(t) % 3] + DAY[-1 - hour] + DAY[(np.asarray(t) * 3).astype(int) % 4]
    return (
        [a[:, 0] * DAY[place % 4] + load, drift],
        SHAPE[:, :1],
        np.exp(np.asarray(th.q))[..., None] * Q,
    )


def imports(a, u, t, dt, th):
    import math as m

    import numpy as own
    import scipy.linalg
    from scipy.linalg import expm

    A = expm(own.array([[0.0, 1.0], [-(th.w**2), -0.3]]) * dt)
    B = scipy.linalg.solve_discrete_lyapunov(A, own.diag([m.exp(th.q), 1e-4]))
    return [own.maximum(a[:, 0], th.k) + A[0, 1] * u[1], B[0, 0] * m.sin(t)], A[:, 1:], Q


RATES = {"lift": helper}


@pytest.mark.parametrize(
    "written",
    [
        masks,
        imports,
        opened,
        silent,
        decided,
        kinds,
        heights,
        objects,
        as_method,
        vectorized,
        libraries,
        tables,
    ],
    ids=lambda f: f.__name__,
)
def test_more_that_is_written_so_is_recorded(written):
    model = model_of(written)
    for seed in range(6):
        given = rows_of(seed, model)
        assert_same(model.transition(*given), alone(model, *given))
    assert model.transitions.recorded
    made = by_rows(written, ((2,), (2, 1), (2, 2)))  # which raises where it cannot
    for seed in range(3):
        given = rows_of(seed, model)
        assert_same(made(*given), alone(model, *given))


class Remembering:
    """A plant as it is written with what it found for the last parameters."""

    def __init__(self):
        self.key, self.log, self.on = None, [], False

    def cached(self, a, u, t, dt, th):
        if self.key is None or abs(dt - self.key) > 1e-12 or abs(th.w - self.w) > 1e-12:
            self.Phi = scipy.linalg.expm(np.array([[0.0, 1.0], [-(th.w**2), -0.1]]) * dt)
            self.key, self.w = dt, th.w
        return self.Phi @ u, self.Phi[:, :1], Q

    def switched(self, a, u, t, dt, th):
        if abs(u[0]) > 0.5:
            self.on = u[0] > 0
        return [math.sin(th.w) * (2.0 if self.on else 1.0), 0.0], SHAPE[:, :1], Q

    def set(self, on):
        self.on = on

    def switch(self, x):
        self.on = x > 0.5 or (self.on and x > -0.5)
        return 2.0 if self.on else 1.0

    def through_method(self, a, u, t, dt, th):
        return [math.sin(th.w) * self.switch(u[0]), 0.0], SHAPE[:, :1], Q

    def logged(self, a, u, t, dt, th):
        self.log.append(th.w)
        return [math.sin(th.w), u[0]], SHAPE[:, :1], Q


def test_a_function_that_assigns_to_what_stays_is_not_recorded():
    on, table = False, {"on": False}

    def enclosed(a, u, t, dt, th):
        nonlocal on
        on = u[0] > 0.5 or (on and u[0] > -0.5)
        return [math.sin(th.w) * (2.0 if on else 1.0), 0.0], SHAPE[:, :1], Q

    def in_table(a, u, t, dt, th):
        table["on"] = bool(u[0] > 0.5 or (table["on"] and u[0] > -0.5))
        return [math.sin(th.w) * (2.0 if table["on"] else 1.0), 0.0], SHAPE[:, :1], Q

    history = [0.0]

    def in_list(a, u, t, dt, th):
        before = history[-1]
        history.append(u[0])
        return [math.sin(th.w) * before, 0.0], SHAPE[:, :1], Q

    plant = Remembering()

    def through_object(a, u, t, dt, th):
        return [math.sin(th.w) * plant.switch(u[0]), 0.0], SHAPE[:, :1], Q

    class Car:
        def __init__(self):
            self.plant = Remembering()

        def turned(self, a, u, t, dt, th):
            on = self.plant.on
            self.turn(u[0])
            return [math.sin(th.w) * (2.0 if on else 1.0), 0.0], SHAPE[:, :1], Q

        def turn(self, x):
            self.plant.set(x > 0.5)

    of_plant = Car().turned, plant.switched, plant.cached, plant.through_method, through_object
    for written in (enclosed, in_table, in_list, *of_plant):
        calls = by_rows(written, ((2,), (2, 1), (2, 2)))
        a, u, t, dt, theta = rows_of(0, model_of(loops))
        with pytest.raises(NotByRowsError):
            calls(a, u, t, dt, theta)


def test_what_a_function_remembers_of_a_recording_are_plain_numbers():
    plant = Remembering()
    for written in (plant.cached, plant.logged):
        model = model_of(lambda *given, written=written: written(*given))
        for seed in range(4):
            given = rows_of(seed, model)
            assert_same(model.transition(*given), alone(model, *given))
    log = [float(x) for x in plant.log if np.ndim(x) == 0]
    assert np.isfinite(log).all()
    kept = []

    def keeps(a, u, t, dt, th):
        kept_ref(th.w, np.array([th.w, u[0]]))
        return [math.sin(th.w), u[0]], SHAPE[:, :1], Q

    kept_ref = type("", (), {"__call__": lambda self, *xs: kept.append(xs)})()
    by_rows(keeps, ((2,), (2, 1), (2, 2)))(*rows_of(0, model))
    (number, array), *_ = kept
    assert number + 1.0 == float(number) + 1.0
    assert pickle.loads(pickle.dumps(number)) == number == copy.deepcopy(number)
    assert f"{number:.3f}" == f"{float(number):.3f}"
    assert {number: 1}[float(number)] == 1
    assert (array @ SHAPE).dtype == np.exp(array).dtype == np.append(array, 1.0).dtype == float


def test_a_function_that_counts_its_calls_or_keeps_a_protocol_is_recorded():
    calls, protocol = 0, []

    def dynamics(a, u, t, dt, th):
        nonlocal calls
        calls += 1
        protocol.append(t)
        return [math.sin(th.w), u[0]], SHAPE[:, :1], Q

    made = by_rows(dynamics, ((2,), (2, 1), (2, 2)))
    given = rows_of(0, model_of(loops))
    assert_same(made(*given), alone(model_of(dynamics), *given))
    assert np.isfinite(np.array(protocol, dtype=float)).all()


def test_numbers_drawn_seldom_are_not_recorded():
    rng = np.random.default_rng(0)

    def dynamics(a, u, t, dt, th):
        return [math.sin(th.w), rng.normal() if u[0] > 1.5 else 0.0], SHAPE[:, :1], Q

    calls = by_rows(dynamics, ((2,), (2, 1), (2, 2)))
    a, u, t, dt, theta = rows_of(0, model_of(loops))
    calls(a, np.clip(u, -1.0, 1.0), t, dt, theta)
    with pytest.raises(NotByRowsError):
        calls(a, u + 1.0, t, dt, theta)


def test_a_condition_that_rounding_decides_is_left_to_the_function_for_this_call():
    path = Path(condition=3, then={True: Path()})
    graft(path, Path(condition=3, then={True: Path()}))  # it is known already
    assert list(path.then) == [True]


def test_a_diffusion_of_parameters_that_cannot_be_recorded_keeps_no_drift_from_it():
    model = engine.continuous(
        name="tank",
        drift=lambda a, u, t, th: ([u[0] - math.exp(-th.k) * a[:, 0]], np.zeros((1, 0))),
        diffusion=lambda a, u, t, th: [[round(th.q, 6)]],
        measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[0.1]]),
        initial=lambda th: (Gaussian([0.1], [[1.0]]), [], np.zeros((0, 0))),
        nonlinear={"x": "1"},
        inputs={"u": "1", "v": "1"},
        outputs={"y": "1"},
        parameters=list(model_of(loops).parameters),
    )
    given = rows_of(0, model)
    for _ in range(3):
        model.transition(*given)
    assert model.transitions.recorded


@pytest.mark.parametrize("dynamics", [matrices, loops])
def test_the_first_rows_are_not_called_one_by_one(dynamics):
    """A model that was extended is a new one: each learned anew, by a call for each row of the record."""
    calls = []

    def counted(*given):
        calls.append(len(given[0]))
        return dynamics(*given)

    model, given = model_of(counted), rows_of(0, model_of(dynamics), 40 * M)
    found = model.transition(*given)
    assert len(calls) < 10 * M
    assert_same(found, alone(model_of(dynamics), *given))
