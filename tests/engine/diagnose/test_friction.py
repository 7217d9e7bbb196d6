"""Dry friction holds what stands and stops what moves, however long the steps: against motions by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import engine
from engine.diagnose import extend, make_effect
from engine.diagnose.effects.kinds.friction import rubbed, with_feeding
from engine.diagnose.effects.of_series import setting_for
from engine.estimation.quasi_ml import quasi_ml
from tests.engine.plain_models import Units

DT = 0.05
SIZES = st.floats(-10.0, 10.0, allow_subnormal=False)


def by_hand(v, force, friction, time):
    """A speed after a time under a constant force and friction, corner by corner."""
    while time > 0.0:
        if v == 0.0 and abs(force) <= friction:
            return 0.0
        way = np.sign(v) or np.sign(force)
        slope = force - way * friction
        turn = -v / slope if way * slope < 0.0 else np.inf
        if turn >= time:
            return v + slope * time
        v, time = 0.0, time - turn
    return v


@given(v=SIZES, force=SIZES, friction=st.floats(0.0, 10.0), scale=st.sampled_from([1e-6, 1.0, 1e6]))
def test_a_step_under_a_constant_force_is_exact(v, force, friction, scale):
    v, force, friction = (0.0 if abs(x) < 1e-3 else x for x in (v, force, friction))
    after = rubbed(*(scale * np.array([x]) for x in (v, v + force, friction))) / scale
    assert after[0] == pytest.approx(by_hand(v, force, friction, 1.0), abs=1e-9)


def measured(k=0.0, c=0.0, friction=1.0, T=300, fine=200):
    """Positions of a body of 1 kg with a spring k and a damper c that sticks and slips; the force on it."""
    u = np.repeat(np.random.default_rng(1).uniform(-6.0, 6.0, T // 15), 15)
    x, v, out, h = 0.0, 0.0, [], DT / fine
    for force in u:
        out.append(x)
        for _ in range(fine):
            x += 0.5 * h * v
            v = by_hand(v, force - k * x - c * v, friction, h)
            x += 0.5 * h * v
    return np.array(out), u


def body(continuous=True):
    """Its model without the friction: an equation, or Euler's rule for it as a user writes that."""
    names = {
        "name": "body",
        "measurement": lambda a, u, t, th: ([0.0], [[1.0, 0.0]], [[th.r]]),
        "initial": lambda th: (
            engine.Gaussian(np.zeros(0), np.zeros((0, 0))),
            np.zeros(2),
            1e-10 * np.eye(2),
        ),
        "nonlinear": {},
        "linear": {"x": "m", "v": "m/s"},
        "inputs": {"force": "N"},
        "outputs": {"y": "m"},
        "parameters": [
            engine.Parameter("k", 0.0, "1/s^2", (0.0, 100.0)),
            engine.Parameter("c", 0.0, "1/s", (0.0, 10.0)),
            engine.Parameter("q", 1e-4, "m^2/s^3", (1e-12, 1.0)),
            engine.Parameter("r", 1e-6, "m^2", (1e-12, 1.0)),
        ],
    }
    if continuous:
        return engine.continuous(
            drift=lambda a, u, t, th: ([0.0, u[0]], [[0.0, 1.0], [-th.k, -th.c]]),
            diffusion=lambda a, u, t, th: np.diag([1e-12, th.q]),
            **names,
        )
    return engine.MixedModel(
        dynamics=lambda a, u, t, dt, th: (
            [0.0, dt * u[0]],
            [[1.0, dt], [-dt * th.k, 1.0 - dt * th.c]],
            np.diag([dt * 1e-12, dt * th.q]),
        ),
        **names,
    )


def rubbing(model, series, values, known=True):
    """The model with a friction of the speed, and its parameters: of the model, and the friction's size.

    What feeds the speed is looked at with these parameters where they are ``known``, else with the model's own.
    """
    theta = model.theta(values)
    at = np.asarray(theta if known else model.theta())
    extended = extend(model, ["coulomb:v"], setting_for(model, series, at))
    return extended, extended.theta({**theta.asdict(), "coulomb_v": 1.0})


@pytest.mark.parametrize(
    ("k", "c", "known"),
    [(0.0, 0.0, True), (20.0, 0.4, True), (20.0, 0.4, False)],
    ids=["slide", "spring", "spring that was fitted away"],
)
def test_a_body_that_sticks_and_slips_is_run_as_it_moves(k, c, known):
    """However few the steps: with friction that stops but does not hold it was off by ten times as much."""
    x, u = measured(k, c)
    series = engine.Series(x, u, dt=DT, y_names=["y"], u_names=["force"])
    for substeps, off in ((1, 6e-3), (2, 1.5e-3), (4, 4e-4)):
        fine = series.refined(substeps)
        extended, theta = rubbing(body(), fine, {"k": k, "c": c}, known)
        y = engine.free_run(extended, theta, fine).y[fine.samples, 0]
        assert np.sqrt(np.mean((y - x) ** 2)) < off * x.std()


@pytest.mark.parametrize("continuous", [True, False])
@pytest.mark.parametrize("push", [0.3, 0.7, 0.99])
def test_what_stands_is_held_by_a_friction_that_is_the_larger(push, continuous):
    u = np.full(50, push)
    series = engine.Series(np.zeros(50), u, dt=DT, y_names=["y"], u_names=["force"])
    extended, theta = rubbing(body(continuous), series, {})
    y = engine.free_run(extended, theta, series).y
    np.testing.assert_allclose(y, 0.0, atol=1e-12)


@pytest.mark.parametrize("continuous", [True, False])
def test_what_stands_is_held_beside_a_slow_load(continuous):
    """The load was left among the linear states, and what stands crept under its mean and the force."""
    with_load = loaded(continuous)
    series = engine.Series(np.zeros(50), np.full(50, 0.5), dt=DT, y_names=["y"], u_names=["force"])
    extended, theta = rubbing(with_load, series, {})
    y = engine.free_run(extended, theta, series).y
    np.testing.assert_allclose(y, 0.0, atol=1e-12)


def test_what_feeds_a_speed_is_told_for_a_drive_of_two_masses_too():
    """Five states beside the speed were too many, and it crept: a size of 5.0 was 4.6 by one step a sample."""
    names = ["x", "v", "x2", "v2", "current", "load"]
    A = np.random.default_rng(1).uniform(0.1, 0.5, (6, 6))
    model = engine.MixedModel(
        name="two-masses",
        dynamics=lambda a, u, t, dt, th: (np.zeros(6), A, 1e-4 * np.eye(6)),
        measurement=lambda a, u, t, th: ([0.0], [[1.0, 0.0, 0.0, 0.0, 0.0, 0.0]], [[1e-4]]),
        initial=lambda th: (
            engine.Gaussian(np.zeros(0), np.zeros((0, 0))),
            np.zeros(6),
            np.eye(6),
        ),
        nonlinear={},
        linear=dict.fromkeys(names, "1"),
        inputs={},
        outputs={"y": "1"},
        parameters=[engine.Parameter("unused", 1.0, "1", (0.0, 2.0))],
    )
    assert [*with_feeding(model, "v", names).nonlinear] == names


def loaded(continuous):
    """The body with a force on it that walks at random."""
    plain = body(continuous)
    names = {
        "name": "loaded",
        "measurement": lambda a, u, t, th: ([0.0], [[1.0, 0.0, 0.0]], [[th.r]]),
        "initial": lambda th: (
            engine.Gaussian(np.zeros(0), np.zeros((0, 0))),
            np.zeros(3),
            1e-10 * np.eye(3),
        ),
        "nonlinear": {},
        "linear": {**plain.linear, "load": "m/s^2"},
        "inputs": plain.inputs,
        "outputs": plain.outputs,
        "parameters": plain.parameters,
    }
    if continuous:
        return engine.continuous(
            drift=lambda a, u, t, th: ([0.0, u[0], 0.0], np.diag([1.0, 1.0], 1)),
            diffusion=lambda a, u, t, th: np.diag([1e-12, th.q, 1e-4]),
            **names,
        )
    return engine.MixedModel(
        dynamics=lambda a, u, t, dt, th: (
            [0.0, dt * u[0], 0.0],
            np.eye(3) + np.diag([dt, dt], 1),
            np.diag([dt * 1e-12, dt * th.q, dt * 1e-4]),
        ),
        **names,
    )


@pytest.mark.long
@pytest.mark.parametrize("channels", [{}, {"x": (1e9, 0.0), "v": (1e3, 0.0), "y": (1e9, 0.0)}])
def test_the_likelihood_of_friction_needs_no_short_steps(channels):
    x, u = measured()
    y = x + 1e-3 * np.random.default_rng(2).standard_normal(len(x))
    given = engine.Series(y, u, dt=DT, y_names=["y"], u_names=["force"])
    units, values = Units(body(), channels), []
    model, series = units.converted(), units.series(given)
    size = units.of(["v"])[0][0]
    for substeps in (1, 4):
        fine = series.refined(substeps)
        extended, theta = rubbing(model, fine, {})
        start = {**theta.asdict(), "coulomb_v": 0.7 * size}
        fit = quasi_ml(extended, fine, extended.theta(start), ["q", "r", "coulomb_v"])
        assert fit.theta["coulomb_v"] == pytest.approx(size, rel=0.02)
        values.append(fit.log_likelihood)
    assert values[1] - values[0] < 10.0


def test_a_friction_that_no_longer_grows_says_so():
    """As that of a simulator which makes dry friction soft; of a position a dead zone is one."""
    x, u = measured(T=60)
    series = engine.Series(x, u, dt=DT, y_names=["y"], u_names=["force"])
    model = body()
    setting = setting_for(model, series, np.asarray(model.theta()))
    titles = {name: make_effect(f"deadzone:{name}", setting).title for name in ("x", "v")}
    assert titles["v"] == "dead zone of v: friction that stays the same above a speed"
    assert titles["x"] == "dead zone of x"
