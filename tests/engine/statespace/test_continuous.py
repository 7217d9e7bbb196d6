"""Models written as differential equations, against integrators that are not ours."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import engine
from engine import Gaussian, ModelError, Parameter, Series
from engine.diagnose.records import Records
from engine.diagnose.steps.substeps import prepare

W2, DAMPING = 40.0, 0.2
PARAMETERS = (Parameter("w2", W2, "1/s^2", (1.0, 1e3), "gravity over length"),)


def pendulum(unit=1.0, second=1.0, **changes):
    """An angle in 1 / ``unit`` rad, time in 1 / ``second`` s; torque in rad/s^2."""

    def drift(a, u, t, theta):
        turn = unit * second**-2 * (u[0] - theta.w2 * np.sin(a[:, 0] / unit))
        return [0.0, turn], [[1.0], [-DAMPING / second]]

    fields = {
        "name": "pendulum",
        "nonlinear": {"angle": "rad"},
        "linear": {"rate": "rad/s"},
        "inputs": {"torque": "1/s^2"},
        "outputs": {"y": "rad"},
        "parameters": PARAMETERS,
        "drift": drift,
        "diffusion": lambda a, u, t, theta: np.diag([0.0, 1e-3 * unit**2 / second**3]),
        "measurement": lambda a, u, t, theta: ([a[:, 0]], [[0.0]], [[1e-4 * unit**2]]),
        "initial": lambda theta: (
            Gaussian([0.5 * unit], [[0.01 * unit**2]]),
            [0.0],
            [[0.1 * unit**2 / second**2]],
        ),
    }
    return engine.continuous(**{**fields, **changes})


def torque(T):
    return 5.0 * np.random.default_rng(0).standard_normal(T)


def integrated(u, dt):
    """The angle without noise, by SciPy."""
    x, out = np.array([0.5, 0.0]), [0.5]
    for held in u[:-1]:
        x = solve_ivp(
            lambda t, x, u=held: [x[1], u - W2 * math.sin(x[0]) - DAMPING * x[1]],
            (0.0, dt), x, rtol=1e-10, atol=1e-12,
        ).y[:, -1]  # fmt: skip
        out.append(x[0])
    return np.array(out)


def test_a_linear_model_is_exact_for_any_step():
    F = np.array([[-1.0, 2.0, 0.0], [0.0, -3.0, 1.0], [0.5, 0.0, -50.0]])
    G, Qc = np.array([[1.0], [0.0], [2.0]]), np.array([[1, 0.2, 0], [0.2, 1, 0], [0, 0, 0.3]])
    model = engine.continuous(
        name="linear", nonlinear={"a": "1"}, linear={"z1": "1", "z2": "1"}, inputs={"u": "1"},
        outputs={"y": "1"}, parameters=[],
        drift=lambda a, u, t, theta: (a @ F[:, :1].T + G[:, 0] * u[0], F[:, 1:]),
        diffusion=lambda a, u, t, theta: Qc,
        measurement=lambda a, u, t, theta: ([a[:, 0]], [[0.0, 0.0]], [[1.0]]),
        initial=lambda theta: (Gaussian([0.0], [[1.0]]), [0.0, 0.0], np.eye(2)),
    )  # fmt: skip
    a = np.array([[0.3], [-2.0], [0.0]])
    for dt in (1e-3, 0.4, 10.0):
        A, B, Q = engine.discretize(F, G, Qc, dt=dt)
        f, A_z, noise = model.transition(a, np.array([0.7]), 0.0, dt, model.record(model.theta()))
        np.testing.assert_allclose(f, a @ A[:, :1].T + 0.7 * B[:, 0], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(np.broadcast_to(A_z, (3, 3, 2))[2], A[:, 1:], atol=1e-9)
        np.testing.assert_allclose(np.broadcast_to(noise, (3, 3, 3))[1], Q, atol=1e-9)


@pytest.mark.parametrize("jacobian", [False, True])
def test_a_run_is_of_second_order(jacobian):
    given = {}
    if jacobian:
        given["jacobian"] = lambda a, u, t, theta: [[0.0], [-theta.w2 * np.cos(a[:, 0])]]
    model, u, dt = pendulum(**given), torque(80), 0.05
    exact, off = integrated(u, dt), []
    for k in (1, 2, 4, 8):
        series = Series(np.zeros(80), u, dt=dt).refined(k)
        y = engine.free_run(model, None, series, a1=[0.5], z1=[0.0]).y[series.samples, 0]
        off.append(np.abs(y - exact).max())
    assert off[0] < 0.01 * np.ptp(exact)
    assert all(b < 0.3 * a for a, b in pairwise(off))


def test_a_stiff_equation_does_not_run_away():
    """x' = -1e4 x^3: an Euler step of the same length would end far below zero."""
    model = engine.continuous(
        name="stiff", nonlinear={"x": "1"}, outputs={"y": "1"}, parameters=[],
        drift=lambda a, u, t, theta: ([-1e4 * a[:, 0] ** 3], np.zeros((1, 0))),
        diffusion=lambda a, u, t, theta: [[0.0]],
        measurement=lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[1.0]]),
        initial=lambda theta: (Gaussian([1.0], [[0.0]]), [], np.zeros((0, 0))),
    )  # fmt: skip
    y = engine.free_run(model, None, Series(np.zeros(50), dt=0.1)).y[:, 0]
    assert (np.diff(y) < 0.0).all()
    assert (y > 0.0).all()


def test_noise_of_the_rate_reaches_the_angle_within_the_step():
    model, dt = pendulum(), 0.2
    a = np.array([[0.4]])
    _, _, Q = model.transition(a, np.zeros(1), 0.0, dt, model.record(model.theta()))
    F = np.array([[0.0, 1.0], [-W2 * math.cos(0.4), -DAMPING]])
    _, _, exact = engine.discretize(F, None, np.diag([0.0, 1e-3]), dt=dt)
    np.testing.assert_allclose(np.broadcast_to(Q, (1, 2, 2))[0], exact, rtol=1e-5)
    assert exact[0, 0] > 0.0


def test_rows_times_and_parameters_at_once_are_those_one_by_one():
    model = pendulum()
    rng = np.random.default_rng(1)
    a, u, t, dt = (
        rng.normal(size=(9, 1)),
        rng.normal(size=(1, 9)),
        rng.normal(size=9),
        rng.random(9),
    )
    thetas = np.linspace(10.0, 90.0, 9)[:, None]
    f, A, Q = model.transition(a, u, t, dt, model.records(thetas))
    for i in range(9):
        one = model.transition(a[i : i + 1], u[:, i], t[i], dt[i], model.record(thetas[i]))
        for many, alone in zip((f, A, Q), one, strict=True):
            alone = alone if alone.ndim == many.ndim else alone[None]
            np.testing.assert_allclose(many[i], alone[0], rtol=1e-9, atol=1e-12)


def test_functions_that_take_numbers_only():
    def drift(a, u, t, theta):
        return [0.0, u[0] - math.pow(theta.w2, 1.0) * np.sin(a[:, 0])], [[1.0], [-DAMPING]]

    u = torque(60)
    series = Series(np.zeros(60), u, dt=0.05)
    runs = [engine.free_run(m, None, series).y for m in (pendulum(), pendulum(drift=drift))]
    np.testing.assert_allclose(*runs, rtol=1e-12, atol=1e-12)
    thetas = np.array([[30.0], [50.0]])
    a, u = np.array([[0.3], [0.4]]), np.zeros(1)
    both = [
        m.transition(a, u, 0.0, 0.05, m.records(thetas))[0]
        for m in (pendulum(), pendulum(drift=drift))
    ]
    np.testing.assert_allclose(*both, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("unit", "second"), [(1e9, 1.0), (180.0 / math.pi, 1e3), (1e-6, 1.0 / 3600.0)]
)
def test_units_of_states_and_time_say_the_same(unit, second):
    u = torque(60)
    y = engine.simulate(pendulum(), None, 60, np.random.default_rng(2), u=u, dt=0.05).y
    plain = engine.rbpf(pendulum(), None, Series(y, u, dt=0.05), 30, np.random.default_rng(3))
    other = Series(unit * y, u, dt=0.05 * second)
    scaled = engine.rbpf(pendulum(unit, second), None, other, 30, np.random.default_rng(3))
    shift = 60 * math.log(unit)
    assert scaled.log_likelihood + shift == pytest.approx(plain.log_likelihood, abs=1e-3)


@pytest.mark.long
def test_em_estimates_what_another_program_simulated():
    dt, T = 0.05, 200
    u = torque(T)
    y = integrated(u, dt) + 0.01 * np.random.default_rng(5).standard_normal(T)
    found = engine.rbps_em(
        pendulum(), Series(y, u, dt=dt), {"w2": 30.0}, n_iterations=8, n_particles=20
    )
    assert found.theta["w2"] == pytest.approx(W2, rel=0.02)


@pytest.mark.long
def test_a_diagnosis_may_make_more_steps_a_sample():
    u = torque(100)
    y = engine.simulate(pendulum(), None, 100, np.random.default_rng(2), u=u, dt=0.1).y
    model = pendulum()
    fine = prepare(model, Records(Series(y, u, dt=0.1)), lambda: np.asarray(model.theta()))
    assert fine.k > 1
    assert "steps a sample" in fine.notes[0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"drift": lambda a, u, t, theta: ([0.0], [[1.0], [0.0]])}, r"drift: f has shape \(1,\)"),
        ({"drift": lambda a, u, t, theta: ([0.0, 0.0], [[1.0]])}, "drift: A is not a list of 2 rows"),
        ({"diffusion": lambda a, u, t, theta: np.eye(3)}, r"diffusion: Qc has shape \(3, 3\)"),
        ({"jacobian": lambda a, u, t, theta: np.eye(2)}, r"jacobian: J has shape \(2, 2\)"),
        ({"diffusion": lambda a, u, t, theta: np.array([[1.0, 0.5], [0.0, 1.0]])},
         "diffusion: Qc is not symmetric"),
        ({"diffusion": lambda a, u, t, theta: -np.eye(2)}, "dynamics: Q has the negative eigenvalue"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(changes, words):
    with pytest.raises(ModelError, match=words):
        engine.rbpf(
            pendulum(**changes),
            None,
            Series(np.zeros(10), np.zeros(10)),
            5,
            np.random.default_rng(0),
        )


def test_a_run_that_runs_away_takes_no_other_with_it():
    """Beyond all numbers it is lost; beside it the others go on, and a fit tries something else."""
    from engine.simulation.free_run import run_rows

    def drift(a, u, t, theta):
        return [theta.k * a[:, 0] ** 3 + np.sin(a[:, 0])], np.zeros((1, 0))

    model = engine.continuous(
        name="cubic", drift=drift, diffusion=lambda a, u, t, theta: [[1e-4]],
        measurement=lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[1e-4]]),
        initial=lambda theta: (engine.Gaussian([1.0], [[0.01]]), [], np.zeros((0, 0))),
        nonlinear={"x": "m"}, linear={}, outputs={"y": "m"},
        parameters=[engine.Parameter("k", -1.0, "1/m^2/s", (-10.0, 10.0))],
    )  # fmt: skip
    series = engine.simulate(model, None, 60, np.random.default_rng(0), dt=0.1).series
    y, _ = run_rows(model, np.array([[5.0], [-1.0]]), series, np.ones((2, 1)))
    assert not np.isfinite(y[-1, 0]).any()
    alone, _ = run_rows(model, np.array([[-1.0]]), series, np.ones((1, 1)))
    np.testing.assert_allclose(y[:, 1], alone[:, 0], rtol=1e-9)
    with pytest.raises(ModelError, match="runs away"):
        engine.free_run(model, {"k": 5.0}, series, [1.0], [])
    assert engine.fit_simulation(model, series).theta["k"] == pytest.approx(-1.0, abs=0.2)


def test_a_drift_may_write_into_what_it_is_given_and_into_what_it_returned():
    rates, slopes = {}, np.empty((2, 1))

    def drift(a, u, t, theta):
        f = rates.setdefault(len(a), np.empty((len(a), 2)))
        np.sin(a[:, 0], out=a[:, 0])
        f[:, 0], f[:, 1] = 0.0, u[0] - theta.w2 * a[:, 0]
        slopes[:] = [[1.0], [-DAMPING]]
        return f, slopes

    u = torque(60)
    series = Series(np.zeros(60), u, dt=0.05)
    plain, own = (engine.free_run(m, None, series).y for m in (pendulum(), pendulum(drift=drift)))
    np.testing.assert_allclose(own, plain, rtol=1e-12, atol=1e-12)


def test_a_step_calls_the_drift_twice():
    """Once where the step begins, and once for all states and sides of the differences together."""
    sizes = []

    def drift(a, u, t, theta):
        sizes.append(len(a))
        return [a[:, 1], -theta.w2 * np.sin(a[:, 0])], np.zeros((2, 0))

    model = pendulum(
        drift=drift,
        nonlinear={"angle": "rad", "rate": "rad/s"},
        linear={},
        measurement=lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[1e-4]]),
        initial=lambda theta: (Gaussian([0.5, 0.0], np.eye(2)), [], np.zeros((0, 0))),
    )
    a, record = np.ones((7, 2)), model.record(model.theta())
    model.transitions.once(a, np.zeros(1), 0.0, 0.05, record)
    assert sizes == [7, 28]
    thetas = model.records(np.linspace(10.0, 90.0, 7)[:, None])
    together = model.transition(a, np.zeros(1), 0.0, 0.05, thetas)[0]
    alone = model.transition(a[3:4], np.zeros(1), 0.0, 0.05, model.record([50.0]))[0]
    np.testing.assert_allclose(together[3], alone[0], rtol=1e-12)


def house(diffusion):
    """Two rooms, the first declared nonlinear, in matrices that take many parameter vectors."""

    def drift(a, u, t, th):
        return [th.k * (u[0] - a[:, 0]), th.k * a[:, 0]], [[0.5 * th.k], [-th.k]]

    return engine.continuous(
        name="house",
        drift=drift,
        diffusion=diffusion,
        measurement=lambda a, u, t, th: ([a[:, 0]], [[0.0]], [[0.01]]),
        initial=lambda th: (engine.Gaussian([20.0], [[1.0]]), [20.0], [[1.0]]),
        nonlinear={"near": "degC"},
        linear={"far": "degC"},
        inputs={"outside": "degC"},
        outputs={"y": "degC"},
        parameters=[
            engine.Parameter("k", 0.2, "1/h"),
            engine.Parameter("q", 0.1),
            engine.Parameter("s", 0.2),
        ],
    )


def test_noise_that_takes_one_theta_keeps_the_drift_from_taking_many_no_more():
    """``np.diag`` of arrays is no diagonal matrix: as most people write it."""
    calls = []

    def diagonal(a, u, t, th):
        calls.append(th)
        return np.diag([th.q**2, th.s**2])

    def entry_by_entry(a, u, t, th):
        return [[th.q**2, 0.0], [0.0, th.s**2]]

    rng = np.random.default_rng(0)
    thetas = np.array([0.2, 0.1, 0.2]) * rng.uniform(0.5, 1.5, (12, 3))
    a, u = rng.normal(20.0, 1.0, (24, 1)), np.array([5.0])
    models = house(diagonal), house(entry_by_entry)
    for _ in range(3):
        both = [m.transition(a, u, 0.0, 0.25, m.records(thetas, 2)) for m in models]
        for one, other in zip(*both, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12)
    model = models[0]
    record = model.records(thetas, 2)
    model.transition(a, u, 0.0, 0.25, record)
    calls.clear()
    for k in range(200):  # as a filter steps on with the same parameters
        model.transition(a, u, 0.25 * k, 0.25, record)
    assert len(calls) < 200  # of 12 for each step; some are looks at whether rows agree
    assert all(isinstance(th.q, float) for th in calls)


def test_noise_that_reads_a_state_is_asked_for_every_state():
    model = house(lambda a, u, t, th: [[th.q**2 * np.abs(a[:, 0]), 0.0], [0.0, th.s**2]])
    record = model.record(model.theta())
    Q = [model.transition(np.array([[x]]), np.zeros(1), 0.0, 0.25, record)[2] for x in (1.0, 4.0)]
    Q = [one.reshape(2, 2)[0, 0] for one in Q]
    assert Q[1] > 3.0 * Q[0]


def test_it_is_told_what_a_discretised_model_reads():
    from engine.statespace.evaluation import INPUT, TIME
    from engine.statespace.reads import reads

    steady = house(lambda a, u, t, th: np.diag([th.q, th.s]))
    assert reads(steady.dynamics, INPUT)
    assert not reads(steady.dynamics, TIME)
    daily = house(lambda a, u, t, th: np.diag([th.q, th.s * (1.0 + t)]))
    assert reads(daily.dynamics, TIME)


def test_it_is_pickled_after_use_as_before():
    import pickle

    from tests.engine.statespace import picklable_cart

    cart = picklable_cart.cart
    a, thetas = np.array([[0.1], [0.2]]), np.array([[1.0], [2.0]])
    before = cart.transition(a, np.ones(1), 0.0, 0.1, cart.records(thetas))
    again = pickle.loads(pickle.dumps(cart))
    after = again.transition(a, np.ones(1), 0.0, 0.1, again.records(thetas))
    for one, other in zip(before, after, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("unit", [1e-7, 1.0, 1e7])
def test_noise_changes_nothing_of_a_step_but_its_noise(unit):
    """The slopes are differences, and how long these are must not hang on the noise."""
    curved = {
        "drift": lambda a, u, t, theta: (
            [unit * np.cos(40.0 * a[:, 0] / unit), -unit * theta.w2 * np.sin(a[:, 0] / unit)],
            [[1.0], [-DAMPING]],
        ),
        "parameters": (*PARAMETERS, Parameter("q", 1.0)),
        "diffusion": lambda a, u, t, theta: unit**2 * theta.q * np.eye(2),
    }
    model, a = pendulum(unit, **curved), unit * np.array([[0.0], [0.3], [1e-9]])
    steps = [model.transition(a, [0.0], 0.0, 0.1, model.record([W2, q])) for q in (1e-8, 1e4)]
    for one, other in zip(*(step[:2] for step in steps), strict=True):
        np.testing.assert_array_equal(one, other)
    assert (steps[0][2] != steps[1][2]).any()


def test_slopes_are_right_at_rest_whatever_the_unit():
    """Where neither value nor rate tell how far is near: the start's uncertainty does."""
    for unit in (1e-10, 1.0, 1e10):
        model = pendulum(unit)
        a = np.zeros((1, 1))
        _, A, _ = model.transition(a, np.zeros(1), 0.0, 0.1, model.record([W2]))
        F = np.array([[0.0, 1.0], [-W2, -DAMPING]])
        exact, _, _ = engine.discretize(F, None, None, dt=0.1)
        np.testing.assert_allclose(A.reshape(2, 1), exact[:, 1:], rtol=1e-7)


@pytest.mark.parametrize("push", [1e-6, 1.0, 1e6])
def test_a_linear_model_is_one_however_large_its_input(push):
    """Differences over a way that is short beside what the input does were rounding."""

    def drift(a, u, t, theta):
        return [0.0 * a[:, 0], 9807.0 * u[0] - theta.w2 * a[:, 0]], [[1.0], [-1.2]]

    model = engine.continuous(
        name="storey",
        drift=drift,
        diffusion=lambda a, u, t, theta: np.diag([0.0, 1.0]),
        measurement=lambda a, u, t, theta: ([a[:, 0]], [[0.0]], [[0.01]]),
        initial=lambda theta: (engine.Gaussian([0.0], [[0.01]]), [0.0], [[1.0]]),
        nonlinear={"x": "mm"},
        linear={"v": "mm/s"},
        inputs={"ground": "g"},
        outputs={"y": "mm"},
        parameters=[engine.Parameter("w2", 576.0, "1/s^2", (0.0, 1e6))],
    )
    for dt in (0.002, 0.02, 0.1, 1.0):
        u = push * np.sign(np.sin(np.arange(40.0)))
        series = engine.Series(np.zeros(40), u, dt=dt, y_names=["y"], u_names=["ground"])
        assert np.isfinite(engine.kalman_smoother(model, None, series).log_likelihood)
