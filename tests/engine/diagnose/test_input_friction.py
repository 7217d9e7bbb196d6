"""Friction of a cart that carries a load acts on both: where the input acts, and on neither alone."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import engine
from engine.diagnose import all_effects, extend, make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.screening.screening import screen_effects
from engine.estimation.quasi_ml import quasi_ml
from engine.filters.filter_steps import FilterSteps, Thetas
from engine.filters.sigma_point import moment_filter, run_on_tape
from engine.simulation.free_run import free_run
from tests.engine.diagnose.test_friction import by_hand
from tests.engine.diagnose.test_kinds_by_integration import run
from tests.engine.plain_models import Units

G = 9.81


def cart(M, m, length, force, angle, rate):
    """The accelerations of a cart and of its load, by their coupled masses."""
    s, c = np.sin(angle), np.cos(angle)
    x = (force + m * s * (length * rate**2 + G * c)) / (M + m * s * s)
    return x, -(x * c + G * s) / length


def drift(a, u, t, th):
    _, angle, w = a.T
    x, alpha = cart(th.M, 3.0, 0.8, u[0], angle, w)
    return [x, w, alpha], np.zeros((3, 0))


CRANE = engine.continuous(
    name="trolley-crane",
    drift=drift,
    diffusion=lambda a, u, t, th: np.diag([th.q, 1e-10, th.q]),
    measurement=lambda a, u, t, th: (a[:, :2], np.zeros((2, 0)), np.diag([th.r, 0.01 * th.r])),
    initial=lambda th: (engine.Gaussian(np.zeros(3), 1e-6 * np.eye(3)), [], np.zeros((0, 0))),
    nonlinear={"speed": "m/s", "angle": "rad", "rate": "rad/s"},
    inputs={"motor": "N"},
    outputs={"tacho": "m/s", "inclinometer": "rad"},
    reference={"speed": 0.0, "rate": 0.0, "motor": 0.0},
    parameters=[
        engine.Parameter("M", 9.0, "kg", (1.0, 100.0)),
        engine.Parameter("q", 1e-4, "m^2/s^3", (1e-10, 1.0)),
        engine.Parameter("r", 1e-4, "m^2/s^2", (1e-8, 1.0)),
    ],
)
DT = 0.05


def measured(friction=0.0, drag=0.0, T=300, noise=0.01, seed=1):
    """By scipy, the friction steep but smooth; sensors' noise on the samples."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-25.0, 25.0, T // 15), 15)
    x, y = np.zeros(3), np.zeros((T, 3))

    def rate(t, x, force):
        v, angle, w = x
        rubbed = force - friction * math.tanh(v / 1e-3) - drag * v * abs(v)
        x, alpha = cart(10.0, 3.0, 0.8, rubbed, angle, w)
        return [x, w, alpha]

    for t in range(T):
        y[t] = x
        x = solve_ivp(rate, (0.0, DT), x, "LSODA", rtol=1e-8, atol=1e-9, args=(u[t],)).y[:, -1]
    sensed = y[:, :2] + noise * np.array([1.0, 0.1]) * rng.standard_normal((T, 2))
    return engine.Series(sensed, u, dt=DT), y


@pytest.mark.parametrize(
    ("name", "size", "hidden"),
    [("input-coulomb:speed->motor", 6.0, "friction"), ("input-drag:speed->motor", 2.0, "drag")],
)
def test_it_is_what_the_equations_of_the_masses_say(name, size, hidden):
    series, states = measured(**{hidden: size})
    own = {"M": 10.0, f"{name.partition(':')[0].replace('-', '_')}_speed__motor": size}
    y, _ = run(CRANE, name, own, series.refined(8), {}, setting_for(CRANE, series, CRANE.theta()))
    without = free_run(CRANE, {"M": 10.0}, series, np.zeros(3), []).y
    error, effect = (
        np.abs(one[::k][:300] - states[:, :2]).max() for one, k in ((y, 8), (without, 1))
    )
    assert error < 0.03 * effect


def test_it_holds_what_stands_and_turns_with_the_motion_within_a_step():
    """Two speeds on one input, the other way round and with half of its force: it acts on both."""
    pair = engine.MixedModel(
        name="pair",
        dynamics=lambda a, u, t, dt, th: (
            a + dt * u[0] * np.array([1.0, -0.5]),
            np.zeros((2, 0)),
            1e-6 * np.eye(2),
        ),
        measurement=lambda a, u, t, th: (a, np.zeros((2, 0)), 1e-6 * np.eye(2)),
        initial=lambda th: (engine.Gaussian(np.zeros(2), np.eye(2)), [], np.zeros((0, 0))),
        nonlinear={"v": "m/s", "w": "m/s"},
        inputs={"force": "m/s^2"},
        outputs={"y1": "m/s", "y2": "m/s"},
        reference={"v": 0.0},
        parameters=[],
        continuous=True,
    )
    setting = Setting(pair, dt=DT)
    rubbed = make_effect("input-coulomb:v->force", setting).apply(pair)
    v = np.array([-1.0, -0.03, 0.0, 0.03, 1.0])
    a = np.stack([v, np.full(5, 2.0)], axis=1)
    for force in (-0.5, 0.5, 3.0):
        after, _, _ = rubbed.transition(a, np.array([force]), 0.0, DT, rubbed.record([1.0]))
        ends = np.array([by_hand(one, force, 1.0, DT) for one in v])
        np.testing.assert_allclose(after[:, 0], ends, atol=1e-12)
        np.testing.assert_allclose(after[:, 1], 2.0 - 0.5 * (ends - v), atol=1e-12)


STEP = 0.02


def hung(x, M=10.0, m=3.0, length=0.8):
    """The rates of a trolley of 10 kg with a load that hangs still but for small angles; the force's slopes."""
    speed, angle, w = x[..., 0], x[..., 1], x[..., 2]
    pull = m * G * angle / M
    return speed, w, pull, -(pull + G * angle) / length, 1.0 / M, -1.0 / (M * length)


def small_swings(T, friction, fine=50, seed=3):
    """(T, 3) trolley's speed, angle and rate, a friction that holds and stops it, by fine steps; the force."""
    u = np.repeat(np.random.default_rng(seed).uniform(-20.0, 20.0, T // 15), 15)
    x, out, h = np.zeros(3), np.zeros((T, 3)), STEP / fine
    for t in range(T):
        out[t] = x
        for _ in range(fine):
            v, w, pull, swing, by_force, swung = hung(x)
            free = v + h * (pull + by_force * u[t])
            push = h * by_force * friction
            left = np.sign(v or free) * max(np.sign(v or free) * free - push, 0.0)
            rubbed = (free - left) / (h * by_force)
            rate = w + h * (swing + swung * (u[t] - rubbed))
            x = np.array([left, x[1] + h * rate, rate])
    return out, u


LINEAR_CRANE = engine.continuous(
    name="small-swings",
    drift=lambda a, u, t, th: (
        [u[0] / 10.0, 0.0, -u[0] / 8.0],
        [[0.0, 0.3 * G, 0.0], [0.0, 0.0, 1.0], [0.0, -1.3 * G / 0.8, 0.0]],
    ),
    diffusion=lambda a, u, t, th: np.diag([1e-4, 1e-10, 1e-4]),
    measurement=lambda a, u, t, th: ([0.0, 0.0], np.eye(3)[:2], 1e-6 * np.eye(2)),
    initial=lambda th: (
        engine.Gaussian(np.zeros(0), np.zeros((0, 0))),
        np.zeros(3),
        1e-10 * np.eye(3),
    ),
    nonlinear={},
    linear={"speed": "m/s", "angle": "rad", "rate": "rad/s"},
    inputs={"motor": "N"},
    outputs={"tacho": "m/s", "inclinometer": "rad"},
    reference={"speed": 0.0},
    parameters=[engine.Parameter("unused", 1.0, "", (0.0, 2.0))],
)


def test_it_holds_a_trolley_that_stands_where_all_is_linear():
    """What moves the trolley was left among the linear states, and it crept: off by ten times as much."""
    states, u = small_swings(300, 6.0)
    series = engine.Series(states[:, :2], u, dt=STEP)
    setting = setting_for(LINEAR_CRANE, series, np.asarray(LINEAR_CRANE.theta()))
    extended = extend(LINEAR_CRANE, ["input-coulomb:speed->motor"], setting)
    y = free_run(extended, extended.theta({"input_coulomb_speed__motor": 6.0}), series).y
    off = np.sqrt(np.mean((y - states[:, :2]) ** 2, axis=0)) / states[:, :2].std(axis=0)
    assert (off < 5e-3).all()


def test_it_is_asked_where_an_input_moves_several_masses_one_of_them_a_rate():
    series, _ = measured(T=60)
    names = [e.name for e in all_effects(setting_for(CRANE, series, CRANE.theta()))]
    kinds = ("input-coulomb", "input-drag")
    assert {name for name in names if name.startswith(kinds)} == {
        f"{kind}:{state}->motor" for kind in kinds for state in ("speed", "rate")
    }
    for other in ("oscillator", "servo", "tanks", "mixed-4"):
        model = engine.get_model(other)
        y = np.random.default_rng(1).standard_normal((80, model.ny))
        u = np.ones((80, len(model.inputs)))
        one = engine.Series(y, u, dt=0.1, y_names=[*model.outputs], u_names=[*model.inputs])
        names = [e.name for e in all_effects(setting_for(model, one, model.theta()))]
        assert not any(name.startswith(kinds) for name in names)


@pytest.mark.parametrize("kind", ["input-coulomb", "input-drag"])
def test_at_size_zero_the_extended_model_is_the_model(kind):
    series, _ = measured(T=60)
    setting = setting_for(CRANE, series, CRANE.theta())
    extended = extend(CRANE, [f"{kind}:speed->motor"], setting)
    both = [
        moment_filter(model, np.asarray(model.theta())[None], series).log_likelihood[0]
        for model in (CRANE, extended)
    ]
    assert both[1] == pytest.approx(both[0], rel=1e-9)


# millimetres a second from another zero, degrees, kilonewtons, milliseconds that began long ago
SI = Units(CRANE)
OTHER = Units(
    CRANE,
    {
        "speed": (1e3, 500.0),
        "tacho": (1e3, 500.0),
        "angle": (57.3, 0.0),
        "rate": (57.3, 0.0),
        "motor": (1e-3, 0.0),
    },
    (1e3, 1e6),
)


@pytest.mark.long
@pytest.mark.parametrize(("units", "size"), [(SI, 3.0), (OTHER, 3e-3)])
def test_a_screen_sees_it_and_not_either_mass_alone(units, size):
    model, series = units.converted(), units.series(measured(friction=3.0)[0])
    base = quasi_ml(model, series)
    setting = setting_for(model, series, np.asarray(base.theta))
    kinds = ["input-coulomb", "input-drag", "coulomb", "drag", "input-deadzone"]
    seen = screen_effects(base, series, setting, kinds, 0.05, 1, lambda *_: None, None)
    best = sorted(seen.scores, key=lambda score: -score.statistic)
    assert best[0].effect.name == "input-coulomb:speed->motor"
    assert best[0].size == pytest.approx(size, rel=0.35)


@pytest.mark.slow
def test_a_trolleys_friction_is_named():
    """Once Stribeck's friction of the trolley alone led, and a second effect of the load was looked for."""
    series, _ = measured(friction=3.0, T=300)
    found = engine.diagnose(
        CRANE,
        series,
        effects=[
            "input-coulomb",
            "input-drag",
            "coulomb",
            "stribeck",
            "drag",
            "input-deadzone",
            "bias",
        ],
    )
    assert [cause.effect for cause in found.causes] == ["input-coulomb:speed->motor"]
    assert found.causes[0].size == pytest.approx(3.0, abs=4 * found.causes[0].standard_error + 0.1)
    assert found.causes[0].unit == "N"


@pytest.mark.parametrize("k", [1, 2, 4])
def test_filters_go_through_its_tape_while_friction_holds_the_trolley(k):
    """What stops it exactly in one order of the sums leaves rounding in another, and the tape was given up."""
    series = measured(friction=3.0, T=60)[0].refined(k)
    setting = setting_for(CRANE, series, CRANE.theta())
    extended = extend(CRANE, ["input-coulomb:speed->motor"], setting)
    theta = np.array([extended.theta({"M": 10.0, "input_coulomb_speed__motor": 2.5})])
    assert run_on_tape(FilterSteps(extended, Thetas(extended, theta), series)) is not None
