"""Kinds of effects that remember, run off or repeat themselves, against equations integrated here."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import engine
from engine.diagnose import all_effects, extend, make_effect
from engine.diagnose.effects.hide import hide
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.symptoms.runs import noise_free
from engine.filters.sigma_point import moment_filter
from tests.engine.hidden_effects import DRIVE, DT, levels, smooth
from tests.engine.other_units import Units
from tests.engine.plain_models import pendulum, record, room


def cascade(linear=False):
    """Two tanks with linear outlets, the lower one fed by the upper one; a slow inflow beside the pump."""
    rates = np.array([[-0.5, 0.0, 1.0], [0.5, -0.3, 0.0], [0.0, 0.0, -0.01]])
    names = dict.fromkeys(("upper", "lower"), "m")

    def drift(a, u, t, theta):
        still = np.concatenate([a, np.zeros((len(a), 3 - a.shape[1]))], axis=1)
        return still @ rates.T + np.array([1.0, 0.0, 0.0]) * np.reshape(u[0], (-1, 1)), rates[
            :, a.shape[1] :
        ]

    mean = np.array([1.0, 1.0, 0.0])
    return engine.continuous(
        name="cascade",
        drift=drift,
        diffusion=lambda a, u, t, theta: np.diag([1e-4, 1e-4, 1e-6]),
        measurement=lambda a, u, t, theta: (
            ([0.0], [[0.0, 1.0, 0.0]], [[1e-4]]) if linear else ([a[:, 1]], [[0.0]], [[1e-4]])
        ),
        initial=lambda theta: (
            engine.Gaussian(mean[:0] if linear else mean[:2], 0.1 * np.eye(0 if linear else 2)),
            mean if linear else mean[2:],
            0.1 * np.eye(3 if linear else 1),
        ),
        nonlinear={} if linear else names,
        linear={**(names if linear else {}), "rain": "m/s"},
        inputs={"pump": "m/s"},
        outputs={"level": "m"},
        parameters=[],
    )


def run(model, name, own, series, start, setting=None):
    """Noise-free y and states by name of the model with an effect; ``start`` those that are not 0 at first."""
    extended = extend(model, [name], setting)
    states = [*extended.nonlinear, *extended.linear]
    x1 = np.array([start.get(state, 0.0) for state in states])
    y, x = noise_free(extended, np.asarray(extended.theta(own)), series, x1)
    return y, dict(zip(states, x.T, strict=True))


def integrated(rate, start, t, u):
    """x (T, n) of x' = rate(x, u), u held from each time to the next."""
    x = [np.asarray(start, dtype=float)]
    for begin, end, held in zip(t[:-1], t[1:], u[:-1], strict=True):
        ways = solve_ivp(
            lambda _, x, held=held: rate(x, held),
            (begin, end),
            x[-1],
            method="LSODA",
            rtol=1e-9,
            atol=1e-10,
        )
        x.append(ways.y[:, -1])
    return np.array(x)


def swinging_levels(n=300, dt=0.05):
    rng = np.random.default_rng(3)
    return engine.Series(np.zeros(n), np.repeat(rng.uniform(0.2, 2.5, n // 20), 20)[:n], dt=dt)


@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("into", ["", "->lower"])
def test_an_overflow_is_its_differential_equation(into, linear):
    series, rate, limit, share = swinging_levels(), 3.0, 2.0, 0.4
    name = f"overflow_upper{'__lower' if into else ''}"
    own = {name: rate, f"{name}_limit": limit} | ({f"{name}_share": share} if into else {})

    def rates(x, pump):
        surplus = rate * max(x[0] - limit, 0.0)
        gained = share * surplus if into else 0.0
        return [
            -0.5 * x[0] + x[2] + pump - surplus,
            0.5 * x[0] - 0.3 * x[1] + gained,
            -0.01 * x[2],
        ]

    start = {"upper": 1.0, "lower": 1.0, "rain": 0.1}
    _, x = run(cascade(linear), f"overflow:upper{into}", own, series, start)
    exact = integrated(rates, list(start.values()), series.t, series.u[:, 0])
    assert exact[:, 0].max() > limit + 0.1
    np.testing.assert_allclose(x["upper"], exact[:, 0], atol=2e-3)
    np.testing.assert_allclose(x["lower"], exact[:, 1], atol=2e-3)


@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("into", ["", "->lower"])
def test_an_overflow_of_levels_that_are_counted_downward_is_the_same(into, linear):
    series, name = swinging_levels(), f"overflow_upper{'__lower' if into else ''}"
    own, start = {name: 3.0, f"{name}_limit": 2.0}, {"upper": 1.0, "lower": 1.0, "rain": 0.1}
    model, effect = cascade(linear), f"overflow:upper{into}"
    down = Units(np.array([-1.0, -1.0, 1.0]), -np.ones(1), np.ones(1), 1.0, np.ones(0)).model(model)
    below = {name: 3.0, f"{name}_limit": -2.0, f"{name}_side": -1.0}
    y, x = run(model, effect, own, series, start)
    mirrored, _ = run(down, effect, below, series, start | {"upper": -1.0, "lower": -1.0})
    assert x["upper"].max() > 2.0
    np.testing.assert_allclose(mirrored, -y, atol=1e-9)


def test_nothing_stands_above_a_rim_however_long_the_step():
    series = swinging_levels(100, 1.0)
    own = {"overflow_upper__lower": 1e6, "overflow_upper__lower_limit": 2.0}
    start = {"upper": 1.0, "lower": 1.0}
    y, x = run(cascade(), "overflow:upper->lower", own, series, start)
    assert x["upper"].max() == pytest.approx(2.0)
    assert np.isfinite(y).all()


def test_only_stores_overflow():
    def stores(model):
        return [e.channel for e in all_effects(Setting(model), ["overflow"])]

    assert stores(cascade()) == ["upper", "upper->lower", "lower"]
    assert stores(engine.get_model("servo")) == []
    assert stores(pendulum()) == []


@pytest.mark.parametrize("linear", [False, True])
def test_a_path_is_its_differential_equation(linear):
    """Into a state, and beside it into a reading, from an input that has its zero elsewhere."""
    model = replace(cascade(linear), reference={"pump": 0.3})
    series, tau, size = swinging_levels(1500, 0.01), 2.0, -0.6
    first = series.u[0, 0]

    def rates(x, pump):
        lag = (pump - x[3]) / tau
        push = size * (x[3] - 0.3)
        return [-0.5 * x[0] + x[2] + pump + push, 0.5 * x[0] - 0.3 * x[1], -0.01 * x[2], lag]

    start = {"upper": 1.0, "lower": 1.0, "path_pump": first}
    exact = integrated(rates, [1.0, 1.0, 0.0, first], series.t, series.u[:, 0])
    own = {"path_pump__upper": size, "path_pump__upper_time": tau}
    _, x = run(model, "path:pump->upper", own, series, start)
    np.testing.assert_allclose(x["path_pump"], exact[:, 3], atol=1e-7)
    np.testing.assert_allclose(x["upper"], exact[:, 0], atol=4e-5)
    own = {"path_pump__level": size, "path_pump__level_time": tau}
    y, x = run(model, "path:pump->level", own, series, start)
    np.testing.assert_allclose(y[:, 0], x["lower"] + size * (exact[:, 3] - 0.3), atol=1e-6)


@pytest.mark.parametrize("linear", [False, True])
def test_a_linear_state_pushes_another_within_the_step(linear):
    """Into a nonlinear one the whole push came at the step's end: the lower tank was late by half of it."""
    series, size = swinging_levels(), 0.8

    def rates(x, pump):
        return [-0.5 * x[0] + x[2] + pump, 0.5 * x[0] - 0.3 * x[1] + size * x[2], -0.01 * x[2]]

    start = {"upper": 1.0, "lower": 1.0, "rain": 0.4}
    own = {"coupling_rain_lower": size, "coupling_rain_lower_zero": 0.0}
    _, x = run(cascade(linear), "coupling:rain->lower", own, series, start)
    exact = integrated(rates, list(start.values()), series.t, series.u[:, 0])
    np.testing.assert_allclose(x["lower"], exact[:, 1], atol=2e-5)


def test_a_direct_path_adds_the_input_counted_from_its_zero():
    series = swinging_levels()
    start = {"upper": 1.0, "lower": 1.0}
    own = {"direct_pump__level": 0.2}
    y, x = run(
        replace(cascade(), reference={"pump": 0.3}), "direct:pump->level", own, series, start
    )
    np.testing.assert_allclose(y[:, 0], x["lower"] + 0.2 * (series.u[:, 0] - 0.3), atol=1e-12)


@pytest.mark.parametrize("delta", [0.0, -0.8, 0.5, 1.0, -1.4, 1.6])
def test_bouc_wen_with_both_terms_is_its_differential_equation(delta):
    """For a speed that is held from step to step, whatever their length."""
    still = replace(
        DRIVE,
        dynamics=lambda a, u, t, dt, theta: (
            [u[0] + 0.0 * a[:, 0], 0.0],
            [[0.0], [0.9]],
            np.eye(2),
        ),
    )
    rng, width = np.random.default_rng(4), 0.4
    speeds = np.repeat(rng.uniform(-1.0, 1.0, 50), 3)
    series = engine.Series(np.zeros(150), np.append(speeds[1:], 0.0), dt=0.3)

    def rates(m, v):
        return v - (abs(v) * m + delta * v * np.abs(m)) / width

    own = {
        "boucwen_speed": 0.0,
        "boucwen_speed_width": width,
        "boucwen_speed_delta": delta,
    }
    _, x = run(still, "boucwen:speed", own, series, {"speed": speeds[0]})
    exact = integrated(rates, [0.0], series.t, speeds)
    assert np.abs(exact).max() > 0.1
    np.testing.assert_allclose(x["memory_speed"], exact[:, 0], rtol=1e-6, atol=1e-6)


def test_bouc_wen_without_its_second_term_is_the_plainer_hysteresis():
    model = pendulum(continuous=True)
    series = record(model)
    theta = np.asarray(model.theta())
    setting = setting_for(model, series, theta)
    values = []
    for kind in ("hysteresis", "boucwen"):
        extended = make_effect(f"{kind}:rate", setting).apply(model)
        own = extended.theta({f"{kind}_rate": -2.0, f"{kind}_rate_width": 0.1})
        values.append(moment_filter(extended, np.asarray(own)[None], series).log_likelihood[0])
    assert values[0] == pytest.approx(values[1], abs=1e-6)


def followed(x, half):
    """The played value, by hand."""
    p, out = x[0], []
    for one in x:
        if one - p > half:
            p = one - half
        elif p - one > half:
            p = one + half
        out.append(p)
    return np.array(out)


def test_play_follows_once_the_slack_is_taken_up():
    rng = np.random.default_rng(5)
    force = smooth(rng, 200)
    series = engine.Series(np.zeros(200), force, dt=DT)
    own = {"play_force": 0.4, "play_force_first": force[0]}
    first = {"speed": 0.3, "load": 0.1, "played_force": force[0]}
    y, _ = run(DRIVE, "play:force", own, series, first)
    played = engine.Series(np.zeros(200), followed(force, 0.4), dt=DT)
    by_hand, _ = noise_free(DRIVE, np.asarray(DRIVE.theta()), played, np.array([0.3, 0.1]))
    np.testing.assert_allclose(y, by_hand, atol=1e-12)
    plain, _ = noise_free(DRIVE, np.asarray(DRIVE.theta()), series, np.array([0.3, 0.1]))
    y, _ = run(
        DRIVE, "play:reading", {"play_reading": 0.2}, series, {**first, "played_reading": 0.3}
    )
    np.testing.assert_allclose(y[:, 0], followed(plain[:, 0], 0.2), atol=1e-12)


def test_play_is_the_same_on_a_refined_series():
    model = engine.get_model("oscillator")
    rng = np.random.default_rng(3)
    u, hidden = np.repeat(rng.uniform(-1.0, 1.0, 12), 10), {"play_drive": 0.3}
    series = hide(model, ["play:drive"], hidden, 120, rng, u=u, dt=0.08).series
    values = []
    for k in (1, 4):
        refined = series.refined(k)
        setting = setting_for(model, refined, np.asarray(model.theta()))
        extended = make_effect("play:drive", setting).apply(model)
        at = np.asarray(extended.theta(hidden))[None]
        values.append(moment_filter(extended, at, refined).log_likelihood[0])
    assert values[0] == pytest.approx(values[1], abs=1e-3)


def test_cogging_is_its_differential_equation():
    model = pendulum(continuous=True)
    rng = np.random.default_rng(6)
    series = engine.Series(np.zeros(800), np.repeat(rng.uniform(-1.5, 1.5, 20), 40), dt=0.01)

    def rates(x, u):
        force = 1.5 * np.sin(2.0 * np.pi * (x[0] - 0.1) / 0.3)
        return [x[1], -9.0 * np.sin(x[0]) - 0.3 * x[1] + 4.0 * u + force]

    own = {"cogging_angle__rate": 1.5, "cogging_angle__rate_period": 0.3}
    own["cogging_angle__rate_offset"] = 0.1
    y, _ = run(model, "cogging:angle->rate", own, series, {"angle": 0.2})
    exact = integrated(rates, [0.2, 0.0], series.t, series.u[:, 0])
    np.testing.assert_allclose(y[:, 0], exact[:, 0], atol=4e-3)  # half a push early


@pytest.mark.parametrize("hour", [1.0, 3600.0])
def test_a_slow_sensor_is_its_differential_equation_at_any_times(hour):
    """Times that are not regular, in seconds or hours; the speed moves on a straight line between them."""
    rng = np.random.default_rng(7)
    t = hour * np.cumsum(rng.uniform(0.05, 1.0, 120))
    straight = replace(
        DRIVE,
        dynamics=lambda a, u, t, dt, theta: (
            [u[0] + 0.0 * a[:, 0], 0.0],
            [[0.0], [0.9]],
            np.eye(2),
        ),
    )
    speed, tau = levels(rng, 120), 0.7 * hour
    series = engine.Series(np.zeros(120), np.append(speed[1:], 0.0), t=t)
    y, _ = run(
        straight, "slow-sensor:reading", {"slow_sensor_reading": tau}, series, {"speed": speed[0]}
    )
    r = [speed[0]]
    for i in range(119):
        way = solve_ivp(
            lambda s, r, i=i: (np.interp(s, t[i : i + 2], speed[i : i + 2]) - r) / tau,
            t[i : i + 2],
            [r[-1]],
            rtol=1e-9,
            atol=1e-10,
        )
        r.append(way.y[0, -1])
    np.testing.assert_allclose(y[:, 0], r, atol=1e-6)


@pytest.mark.parametrize("adds", [True, False])
@pytest.mark.parametrize("hour", [1.0, 3600.0])
def test_a_slow_actuator_is_its_differential_equation_at_any_times(hour, adds):
    """Times that are not regular, in seconds or hours; the command adds, or is met by its square."""
    rng = np.random.default_rng(8)
    t = hour * np.cumsum(rng.uniform(0.05, 1.0, 120))
    plant = replace(
        DRIVE,
        dynamics=lambda a, u, t, dt, theta: (
            [a[:, 0] + dt * (u[0] if adds else u[0] * abs(u[0])), 0.0],
            [[0.0], [0.9]],
            np.eye(2),
        ),
    )
    force, tau = levels(rng, 120), 0.7 * hour
    series = engine.Series(np.zeros(120), force, t=t)
    start = {"speed": 0.3, "acting_force": -1.0}
    y, states = run(plant, "slow-input:force", {"slow_input_force": tau}, series, start)
    acting = [-1.0]
    for step, held in zip(np.diff(t), force[:-1], strict=True):
        acting.append(held + (acting[-1] - held) * np.exp(-step / tau))
    np.testing.assert_allclose(states["acting_force"], acting, atol=1e-9)
    means = [
        held + (last - held) * tau / step * -np.expm1(-step / tau)
        for step, held, last in zip(np.diff(t), force, acting[:-1], strict=False)
    ]
    rates = np.array(means if adds else means * np.abs(means))
    by_hand = 0.3 + np.append(0.0, np.cumsum(np.diff(t) * rates))
    np.testing.assert_allclose(y[:, 0], by_hand, rtol=1e-9)


def test_a_slow_actuator_of_no_time_is_the_model_where_a_reading_has_the_input_too():
    plant = replace(
        DRIVE, measurement=lambda a, u, t, theta: ([a[:, 0] + 0.5 * u[0]], [[0.0]], [[1e-3]])
    )
    series = engine.Series(np.zeros(60), levels(np.random.default_rng(9), 60), dt=DT)
    plain, _ = noise_free(plant, np.asarray(plant.theta()), series, np.array([0.3, 0.1]))
    y, _ = run(plant, "slow-input:force", {}, series, {"speed": 0.3, "load": 0.1})
    np.testing.assert_allclose(y, plain, atol=1e-12)
    own, setting = {"slow_input_force": 20.0}, Setting(plant, dt=DT)
    slow, states = run(plant, "slow-input:force", own, series, {}, setting)
    acts = 0.5 * states["acting_force"]  # what is seen is its mean over the sample that begins
    np.testing.assert_allclose(
        slow[:-1, 0] - states["speed"][:-1], (acts[:-1] + acts[1:]) / 2, atol=1e-5
    )


def test_a_slow_sensor_sees_linear_states_too_and_is_a_lag_in_hours():
    """The time constant is in seconds: samples of another length find the same one."""
    model = room(continuous=True)
    series = record(model, 200, dt=0.5)
    values = []
    for seconds in (1.0, 3600.0):
        slow = replace(
            model,
            dynamics=lambda a, u, t, dt, th, s=seconds: model.transition(a, u, t / s, dt / s, th),
            outputs={"y": "degC"},
        )
        one = engine.Series(series.y, series.u, t=series.t * seconds)
        extended = extend(slow, ["slow-sensor:y"])
        at = np.asarray(extended.theta({"slow_sensor_y": 0.8 * seconds}))[None]
        values.append(moment_filter(extended, at, one).log_likelihood[0])
    assert values[0] == pytest.approx(values[1], rel=1e-9)


def bent_drive():
    """The drive, its force through a curve: it does not simply add."""
    return replace(
        DRIVE,
        dynamics=lambda a, u, t, dt, theta: DRIVE.dynamics(
            a, [np.tanh(u[0]) * (1.0 + 0.1 * a[:, 0])], t, dt, theta
        ),
    )


@pytest.mark.parametrize(("model", "late"), [(DRIVE, 4), (DRIVE, 11), (bent_drive(), 3)])
def test_a_dead_time_of_many_samples_is_that_of_the_input(model, late):
    force = smooth(np.random.default_rng(8), 100)
    series = engine.Series(np.zeros(100), force, dt=DT)
    own = {"delay_force": late, "delay_force_samples": late, "delay_force_before": 0.5}
    extended = extend(model, ["delay:force"])
    before = {name: 0.5 for name in [*extended.nonlinear, *extended.linear] if "last" in name}
    y, _ = run(model, "delay:force", own, series, before)
    shifted = engine.Series(np.zeros(100), np.append(np.full(late, 0.5), force)[:100], dt=DT)
    by_hand, _ = noise_free(model, np.asarray(model.theta()), shifted, np.zeros(2))
    np.testing.assert_allclose(y, by_hand, atol=1e-9)


def test_an_input_that_adds_may_be_late_by_many_samples_though_slopes_are_rounded():
    """The rounding of differenced slopes changes with the input; late inputs are linear states all the same."""

    def dynamics(a, u, t, dt, theta):
        f, A, Q = DRIVE.dynamics(a, u, t, dt, theta)
        return f, np.asarray(A) * (1.0 + 1e-12 * np.sin(1e6 * u[0])), Q

    series = engine.Series(np.zeros(60), smooth(np.random.default_rng(3), 60), dt=DT)
    exact, rounded = (
        extend(m, ["delay:force"], setting_for(m, series, np.asarray(m.theta())))
        for m in (DRIVE, replace(DRIVE, dynamics=dynamics))
    )
    assert list(rounded.linear) == list(exact.linear)
    assert list(rounded.nonlinear) == list(DRIVE.nonlinear)


@pytest.mark.parametrize("late", [0.3, 1.7, 3.1])
@pytest.mark.parametrize("model", [DRIVE, bent_drive()], ids=["adds", "bent"])
def test_a_dead_time_of_parts_of_a_sample_acts_within_the_sample(model, late):
    force, k = smooth(np.random.default_rng(8), 60), 10
    coarse = engine.Series(np.zeros(60), force, dt=DT)
    series = coarse.refined(k)
    setting = setting_for(model, series, np.asarray(model.theta()))
    own = {"delay_force": late, "delay_force_before": 0.5}
    extended = extend(model, ["delay:force"], setting)
    before = {name: 0.5 for name in [*extended.nonlinear, *extended.linear] if "last" in name}
    y, _ = run(model, "delay:force", own, series, before, setting)
    steps = round(late * k)
    u = np.repeat(force, k)
    shifted = np.append(np.full(steps, 0.5), u)[: len(series)]
    fine = engine.Series(np.zeros(len(series)), shifted, dt=DT / k)
    by_hand, _ = noise_free(model, np.asarray(model.theta()), fine, np.zeros(2))
    np.testing.assert_allclose(y, by_hand, atol=1e-9)


def test_cogging_repeats_itself_within_the_way_that_was_travelled():
    """With a longer period it would be any bend with an offset."""
    model = engine.get_model("oscillator")
    rng = np.random.default_rng(4)
    u = np.repeat(rng.standard_normal((30, 1)), 10, axis=0)
    series = engine.simulate(model, None, 300, rng, u=u, dt=0.1).series
    setting = setting_for(model, series, np.asarray(model.theta()))
    effect = make_effect("cogging:position->velocity", setting)
    way = np.ptp(setting.record.values["position"])
    _, longest = effect.parameters[1].bounds
    assert longest < 0.5 * way
    assert all(period <= longest for period, _ in effect.probes)


def test_friction_turns_with_the_motion_within_a_step():
    """A strong force turns the motion within one step; each speed turns at another time."""
    dt, force, friction = 0.1, 20.0, 1.0
    body = engine.MixedModel(
        name="body",
        dynamics=lambda a, u, t, dt, th: (a + dt * u[0], np.zeros((1, 0)), [[1e-6]]),
        measurement=lambda a, u, t, th: (a, np.zeros((1, 0)), [[1e-6]]),
        initial=lambda th: (engine.Gaussian([0.0], [[1.0]]), np.zeros(0), np.zeros((0, 0))),
        nonlinear={"speed": "m/s"},
        inputs={"force": "m/s^2"},
        outputs={"reading": "m/s"},
        parameters=[],
        continuous=True,
    )
    rubbed = make_effect("coulomb:speed", Setting(body, dt=dt)).apply(body)
    speeds = np.linspace(-0.95, -0.05, 19) * dt * force
    after, _, _ = rubbed.transition(
        speeds[:, None], np.array([force]), 0.0, dt, rubbed.record([friction, 0.0])
    )
    turn = -speeds / (force + friction)
    exact = (dt - turn) * (force - friction)
    np.testing.assert_allclose(after[:, 0], exact, rtol=1e-12)


@pytest.mark.parametrize("late", [0.3, 1.7, 4.0])
@pytest.mark.parametrize("linear", [False, True])
def test_a_dead_time_of_parts_of_a_step_acts_for_that_part(linear, late):
    """In steps of half a time constant: the share of a step's push that the part has is another one."""
    dt, k = 1.0, 10
    pump = swinging_levels(60, dt).u[:, 0]
    name, own = "delay:pump", {"delay_pump": late, "delay_pump_before": 0.5}
    start = {"upper": 1.0, "lower": 1.0}
    before = {"last_pump": 0.5, **{f"last_pump_{i}": 0.5 for i in range(2, 13)}}
    coarse = engine.Series(np.zeros(60), pump, dt=dt)
    y, _ = run(cascade(linear), name, own, coarse, start | before)
    shifted = np.append(np.full(round(late * k), 0.5), np.repeat(pump, k))[: 60 * k]
    fine = engine.Series(np.zeros(60 * k), shifted, dt=dt / k)
    by_hand, _ = noise_free(cascade(linear), np.zeros(0), fine, np.array([1.0, 1.0, 0.0]))
    np.testing.assert_allclose(y, by_hand[::k], atol=1e-7 if linear else 1e-4)
