"""Free runs found as a whole: the same as the loop's, in any units, or left to the loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

import engine
from engine.data.series import Series
from engine.errors import ModelError
from engine.simulation import simulate, whole_record
from engine.simulation.free_run import first_state
from engine.simulation.simulate import propagate
from engine.statespace.model import Gaussian, MixedModel
from engine.statespace.promotion import promote
from tests.engine.simulation.free_run_models import (
    logistic,
    lorenz,
    pendulum,
    small_model,
    unstable,
    van_der_pol,
)

T = 600


def record_of(model, n=T, dt=0.1, seed=0):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.5, 5.0, n // 25 + 1), 25)[:n, None] * np.ones(model.nu)
    return Series(np.zeros((n, model.ny)), u, dt=dt)


def solved(model, series, theta=None):
    """The rows that Newton's method finds."""
    vector = model.theta(theta)
    x1, _ = first_state(model, vector)
    return whole_record.whole_record(model, model.record(vector), series, x1)


def run(model, series, theta=None):
    """y and x of the free run."""
    vector = model.theta(theta)
    x1, _ = first_state(model, vector)
    y, a, z = propagate(
        model, model.record(vector), series, x1[None, : model.na], x1[None, model.na :]
    )
    return y[:, 0], np.concatenate([a[:, 0], z[:, 0]], axis=1)


def loop(model, series, theta=None):
    """The same by the loop over time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(whole_record, "SHORTEST", np.inf)
        return run(model, series, theta)


def apart(one, other):
    """Largest difference of two trajectories as a share of what each column moves."""
    return np.max(np.abs(one - other) / np.maximum(np.abs(other - other[0]).max(axis=0), 1e-300))


def assert_as_in_the_loop(model, series, theta=None):
    for one, other in zip(run(model, series, theta), loop(model, series, theta), strict=True):
        assert apart(one, other) < 1e-9


STABLE = [
    ("oscillator", 0.1),
    ("mixed-4", 1.0),
    ("tanks", 4.0),
    ("structure", 0.05),
    ("servo", 0.02),
    ("linear-2", 1.0),
    ("local-level", 1.0),
]


@pytest.mark.parametrize(("name", "dt"), STABLE)
def test_registered_models_run_as_in_the_loop(name, dt):
    model = engine.get_model(name)
    series = record_of(model, dt=dt)
    assert len(solved(model, series)) == T
    assert_as_in_the_loop(model, series)


def test_friction_that_sticks_and_slips():
    model = engine.get_model("servo")
    series = record_of(model, 2000, 0.01).replace(u=3.0 * np.sin(0.05 * np.arange(2000.0)))
    assert len(solved(model, series, {"Fc": 60.0})) == 2000
    assert_as_in_the_loop(model, series, {"Fc": 60.0})


@pytest.mark.parametrize("force", [0.0, 0.2, 2.0])
def test_friction_that_jumps_and_chatters(force):
    """Coulomb's law by np.sign: around standstill each step overshoots, or stands exactly."""

    def f(x, u, dt, th):
        return [x[0] + dt * x[1], x[1] + dt * (force * u[0] - np.sign(x[1]) - 0.3 * x[0])]

    model = small_model("sign", ("q", "v"), [1.0, 0.0], f, {}, ("force",))
    series = record_of(model, dt=0.05)
    u = np.sin(0.3 * series.t)
    assert_as_in_the_loop(model, series.replace(u=u))


@pytest.mark.parametrize("n", [2, 5, 299, 301, 6500])
def test_records_of_any_length(n):
    """Long ones are worked through in parts."""
    model = engine.get_model("structure")
    series = record_of(model, n, 0.05)
    assert_as_in_the_loop(model, series)


def test_irregular_times_and_several_steps_a_sample():
    model = engine.get_model("tanks")
    series = record_of(model, dt=4.0)
    t = np.cumsum(np.random.default_rng(0).uniform(1.0, 6.0, T))
    for other in (series.replace(t=t), series.refined(4)):
        assert len(solved(model, other)) == len(other)
        assert_as_in_the_loop(model, other)


def test_linear_states_made_nonlinear_change_nothing():
    model = engine.get_model("oscillator")
    series = record_of(model)
    inside = promote(model, list(model.linear))
    assert len(solved(inside, series)) == T
    assert apart(run(inside, series)[0], loop(model, series)[0]) < 1e-9


# ---- left to the loop ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "dt"), [(van_der_pol(), 0.05), (lorenz(), 0.01), (logistic(), 1.0)]
)
def test_what_does_not_converge_is_left_to_the_loop(model, dt):
    series = record_of(model, 2000, dt).replace(u=np.zeros((2000, model.nu)))
    rows = solved(model, series)
    assert 1 <= len(rows) < 1000
    assert apart(rows, loop(model, series)[1][: len(rows)]) < 1e-9


def test_a_run_that_grows_and_one_that_amplifies_rounding():
    """The first one's errors grow as it does itself; those of the second do not stay small beside it."""
    model = unstable(1.01)
    series = record_of(model)
    assert len(solved(model, series)) == T
    assert apart(run(model, series)[1], loop(model, series)[1]) < 1e-9
    series = record_of(logistic(3.7))
    np.testing.assert_array_equal(run(logistic(3.7), series)[1], loop(logistic(3.7), series)[1])


def test_a_run_that_is_not_finite_ends_as_in_the_loop():
    model = unstable(1.5)
    series = record_of(model, 3000)
    one, other = run(model, series)[1], loop(model, series)[1]
    np.testing.assert_array_equal(np.isfinite(one), np.isfinite(other))
    with pytest.raises(ModelError, match="the simulation runs away; at t = "):
        engine.free_run(model, None, series)


@pytest.mark.long
@pytest.mark.parametrize("within", [False, True])
def test_a_model_that_takes_one_time_in_a_call(within):
    model = engine.get_model("oscillator")
    series, calls = record_of(model), []

    def dynamics(a, u, t, dt, theta):
        calls.append(len(a))
        late = float(str(t)) > 1e9  # which is not recorded
        return model.dynamics(a, 2.0 * u if late else u, t, dt, theta)

    user = replace(model, dynamics=dynamics)
    if within:
        user = promote(user, list(model.linear))
    assert len(solved(user, series)) == 1
    calls.clear()
    assert len(solved(user, series)) == 1
    assert not calls  # it is remembered
    np.testing.assert_array_equal(run(user, series)[0], loop(user, series)[0])


@pytest.mark.parametrize("within", [False, True])
def test_a_condition_on_one_time_is_recorded_and_the_record_found_as_a_whole(within):
    model = engine.get_model("oscillator")
    series = record_of(model)

    def dynamics(a, u, t, dt, theta):
        return model.dynamics(a, u if t < 1e9 else 2.0 * u, t, dt, theta)

    user = replace(model, dynamics=dynamics)
    if within:
        user = promote(user, list(model.linear))
    assert len(solved(user, series)) == len(series)
    one, other = run(user, series)[0], loop(user, series)[0]
    np.testing.assert_allclose(one, other, atol=1e-9 * np.abs(other).max())


def test_a_condition_on_all_rows_is_found():
    """np.any for np.where: right in the loop, wrong for rows of other times, and only from some state on."""
    model = pendulum()

    def dynamics(a, u, t, dt, theta):
        f, A, Q = model.dynamics(a, u, t, dt, theta)
        return [f[0], f[1] + (0.1 * dt if np.any(a[:, 0] > 0.3) else 0.0)], A, Q

    user = replace(model, dynamics=dynamics)
    series = record_of(model, dt=0.05)
    assert run(user, series)[1][:, 0].max() > 0.3
    np.testing.assert_allclose(run(user, series)[1], loop(user, series)[1], rtol=1e-9)


def test_a_function_that_fails_away_from_the_run():
    model = engine.get_model("tanks")

    def dynamics(a, u, t, dt, theta):
        if (a[:, 0] > 7.0).any():
            raise ValueError("no such level")
        return model.dynamics(a, u, t, dt, theta)

    user = replace(model, dynamics=dynamics)
    series = record_of(model, dt=4.0).replace(u=np.full((T, 1), 1.0))
    np.testing.assert_allclose(run(user, series)[1], loop(model, series)[1], rtol=1e-9)


def test_a_function_that_writes_into_memory_of_its_own():
    model, memory = pendulum(), {}

    def dynamics(a, u, t, dt, theta):
        f, A, Q = model.dynamics(a, u, t, dt, theta)
        out = memory.setdefault(len(a), np.empty((len(a), 2)))
        out[:, 0], out[:, 1] = f
        a[:] = np.nan
        return out, A, Q

    series = record_of(model, dt=0.05)
    user = replace(model, dynamics=dynamics)
    assert apart(run(user, series)[1], loop(model, series)[1]) < 1e-9


def test_noise_and_several_runs_are_the_loops(monkeypatch):
    def never(*_):
        raise AssertionError

    monkeypatch.setattr(simulate, "whole_record", never)
    model = engine.get_model("tanks")
    engine.simulate(model, None, T, np.random.default_rng(0), u=np.ones(T), dt=4.0)
    series, x1 = record_of(model, dt=4.0), np.tile([6.0, 5.0, 0.0], (2, 1))
    propagate(model, model.record(model.theta()), series, x1[:, :2], x1[:, 2:])


# ---- in other units -------------------------------------------------------------------------------


def in_other_units(model, scale, shift, u, y, t):
    """Nonlinear states scaled and shifted, inputs, outputs and seconds scaled."""
    scale, shift = np.asarray(scale), np.asarray(shift)

    def dynamics(a, u_, t_, dt, theta):
        f, A, Q = model.transition((a - shift) / scale, np.asarray(u_) / u, t_ / t, dt / t, theta)
        return f * scale + shift, A, Q * np.outer(scale, scale)

    def measurement(a, u_, t_, theta):
        h, C, R = model.observation((a - shift) / scale, np.asarray(u_) / u, t_ / t, theta)
        return h * y, C, R * y * y

    def initial(theta):
        density = model.start(theta).density
        cov = density.cov * np.outer(scale, scale)
        return Gaussian(density.mean * scale + shift, cov), np.zeros(0), np.zeros((0, 0))

    return replace(model, dynamics=dynamics, measurement=measurement, initial=initial)


POWER = st.integers(-9, 9).map(lambda k: 10.0**k)


@pytest.mark.long
@settings(max_examples=30, deadline=None, derandomize=True, phases=[Phase.generate])
@given(
    x=POWER,
    v=POWER,
    u=POWER,
    y=POWER,
    t=POWER,
    shift=st.sampled_from([0.0, 1.0, -300.0]),
)
def test_runs_are_the_same_in_other_units(x, v, u, y, t, shift):
    model = pendulum()
    series = record_of(model, dt=0.05)
    there = Series(series.y, series.u * u, dt=0.05 * t)
    scaled = in_other_units(model, [x, v], [shift * x, shift * v], u, y, t)
    known, other = solved(model, series), solved(scaled, there)
    assert len(known) == len(other) == T
    np.testing.assert_allclose(
        (other / [x, v]) - shift, known, atol=1e-9 * np.abs(known).max(axis=0).min()
    )
    assert apart(run(scaled, there)[0], y * loop(model, series)[0]) < 1e-9


def test_a_state_that_rests_at_first_and_is_known_exactly():
    """Its size is not known beforehand: nothing moves in the first step."""

    def model(unit):
        return MixedModel(
            name="late",
            dynamics=lambda a, u, t, dt, th: (
                [
                    a[:, 0] + dt * a[:, 1] / unit,
                    a[:, 1] + dt * (u[0] * unit - np.sin(a[:, 0]) * unit - 0.5 * a[:, 1]),
                ],
                np.zeros((2, 0)),
                np.zeros((2, 2)),
            ),
            measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[1.0]]),
            initial=lambda th: (
                Gaussian([0.0, 0.0], np.zeros((2, 2))),
                np.zeros(0),
                np.zeros((0, 0)),
            ),
            nonlinear={"angle": "rad", "rate": "rad/s"},
            inputs={"moment": ""},
            outputs={"y": "rad"},
            parameters=[],
        )

    u = np.where(np.arange(T) < 100, 0.0, 0.5)
    for unit in (1e-9, 1.0, 1e9):
        one = model(unit)
        series = Series(np.zeros(T), u, dt=0.05)
        assert len(solved(one, series)) == T
        assert apart(run(one, series)[1], loop(one, series)[1]) < 1e-9
