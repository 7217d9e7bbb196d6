"""What each plain kind adds to a step, a reading, an input or a noise is the formula that it shows."""

from dataclasses import replace

import numpy as np
import pytest

from engine.diagnose import make_effect
from engine.diagnose.effects.setting import Record, Setting
from tests.engine.diagnose.test_friction import by_hand
from tests.engine.hidden_effects import DRIVE
from tests.engine.plain_models import room

SETTING = Setting(DRIVE, span=(0.0, 5.0), dt=0.1, resolution={"reading": 0.1})
STEP, FORCE = 0.05, 1.3
SPEED = np.array([-2.1, -0.4, 0.1, 0.9, 3.0])
THETA = [1.0, 1.0]
SPEED_ROW, LOAD_ROW = 0, 1
TIMES = (1.0, 2.5, 3.7)


def step(model, t=0.0, u=FORCE, theta=THETA, dt=STEP):
    """The mean's constant part (M, 2), its part by the load (M, 2, 1), and the noise (M, 2, 2)."""
    parts = model.transition(SPEED[:, None], np.array([u]), t, dt, model.record(np.array(theta)))
    shapes = ((5, 2), (5, 2, 1), (5, 2, 2))
    return [np.broadcast_to(part, shape) for part, shape in zip(parts, shapes, strict=True)]


def reading(model, t=0.0, theta=THETA):
    parts = model.observation(SPEED[:, None], np.array([FORCE]), t, model.record(np.array(theta)))
    shapes = ((5, 1), (5, 1, 1), (5, 1, 1))
    return [np.broadcast_to(part, shape) for part, shape in zip(parts, shapes, strict=True)]


def same(found, expected):
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


def beyond(x, limit):
    return np.sign(x) * np.maximum(np.abs(x) - limit, 0.0)


# name, own values (size first, a zero last), what is added to the rate
RATES = [
    ("force:speed", [0.6], lambda x, t: 0.6),
    ("force:load", [0.6], lambda x, t: 0.6),
    ("quadratic:speed", [0.2, 0.3], lambda x, t: 0.2 * (x - 0.3) ** 2),
    ("cubic:speed", [-0.8, 0.3], lambda x, t: -0.8 * (x - 0.3) ** 3),
    ("cubic:speed->load", [-0.8, 0.3], lambda x, t: -0.8 * (x - 0.3) ** 3),
    ("drag:speed", [0.9, 0.3], lambda x, t: -0.9 * (x - 0.3) * np.abs(x - 0.3)),
    ("deadzone:speed", [-2.0, 0.5, 0.3], lambda x, t: -2.0 * np.clip(x - 0.3, -0.5, 0.5)),
    ("saturation:speed", [-4.0, 0.5, 0.3], lambda x, t: -4.0 * beyond(x - 0.3, 0.5)),
    ("linear:speed", [0.7, 0.3], lambda x, t: 0.7 * (x - 0.3)),
    ("coupling:speed->load", [0.7, 0.3], lambda x, t: 0.7 * (x - 0.3)),
    ("step:speed", [0.6, 2.5], lambda x, t: 0.6 * (t >= 2.5)),
    ("step:load", [0.6, 2.5], lambda x, t: 0.6 * (t >= 2.5)),
    ("ramp:speed", [0.6, 0.5], lambda x, t: 0.6 * (t - 0.5)),
    ("pulse:speed", [0.6, 2.5, 0.1], lambda x, t: 0.6 * (t == 2.5)),
    (
        "harmonic:speed",
        [0.6, 0.2, 0.4, 0.3],
        lambda x, t: 0.6 * np.cos(0.8 * np.pi * (t - 0.3)) + 0.2 * np.sin(0.8 * np.pi * (t - 0.3)),
    ),
]


@pytest.mark.parametrize(("name", "own", "rate"), RATES)
def test_a_force_moves_its_state_alone_by_its_rate_times_the_step(name, own, rate):
    model = make_effect(name, SETTING).apply(DRIVE)
    row = LOAD_ROW if name.endswith("load") else SPEED_ROW
    for t in TIMES:
        f, A, Q = step(DRIVE)
        f = np.array(f)
        f[:, row] += STEP * rate(SPEED, t)
        same(step(model, t, theta=THETA + own), (f, A, Q))
        same(reading(model, t, theta=THETA + own), reading(DRIVE))


@pytest.mark.parametrize(("name", "row"), [("linear:load", 1), ("coupling:load->speed", 0)])
def test_a_linear_state_drives_by_its_distance_from_its_zero(name, row):
    model = make_effect(name, SETTING).apply(DRIVE)
    f, A, Q = step(DRIVE)
    f, A = np.array(f), np.array(A)
    f[:, row] -= STEP * 0.7 * 0.3
    A[:, row, 0] += STEP * 0.7
    same(step(model, theta=[*THETA, 0.7, 0.3]), (f, A, Q))


@pytest.mark.parametrize(
    ("name", "own", "size"),
    [
        ("coulomb:speed", [0.5, 0.3], lambda v: 0.5),
        ("coulomb:speed", [30.0, 0.3], lambda v: 30.0),
        ("stribeck:speed", [1.1, 0.5, 0.3], lambda v: 1.1 * np.exp(-abs(v) / 0.5)),
    ],
)
def test_friction_stops_a_motion_and_does_not_turn_it(name, own, size):
    """The load that moves the speed is known with it, and so is the way of the motion within the step."""
    model = make_effect(name, SETTING).apply(DRIVE)
    loads = np.array([0.7, -30.0, 4.0, 0.0, -2.0])
    f, A, _ = step(DRIVE)
    free = f + A[..., 0] * loads[:, None]
    expected = free.copy()
    for row, v in enumerate(SPEED - 0.3):
        force = (free[row, SPEED_ROW] - 0.3 - v) / STEP
        midway = 0.5 * (v + by_hand(v, force, size(v), STEP))
        expected[row, SPEED_ROW] = 0.3 + by_hand(v, force, size(midway), STEP)
    a, record = np.column_stack([SPEED, loads]), model.record(np.array(THETA + own))
    found = model.transition(a, np.array([FORCE]), 0.0, STEP, record)
    np.testing.assert_allclose(found[0], expected, rtol=1e-12, atol=1e-12)
    assert found[1].shape[-1] == 0
    same(np.broadcast_to(found[2], (5, 2, 2)), step(DRIVE)[2])


def excess(x, limit, side, zero):
    """What of x is beyond the limit, above it, below it, or on both sides alike."""
    if side:
        return side * np.maximum(side * (x - limit), 0.0)
    return beyond(x - zero, abs(limit - zero))


READINGS = [
    ("bias:reading", [0.5], lambda y, t: 0.5),
    ("drift:reading", [0.2, 0.5], lambda y, t: 0.2 * (t - 0.5)),
    ("step:reading", [0.6, 2.5], lambda y, t: 0.6 * (t >= 2.5)),
    ("pulse:reading", [0.6, 2.5, 0.1], lambda y, t: 0.6 * (t == 2.5)),
    (
        "harmonic:reading",
        [0.6, 0.2, 0.4, 0.3],
        lambda y, t: 0.6 * np.cos(0.8 * np.pi * (t - 0.3)) + 0.2 * np.sin(0.8 * np.pi * (t - 0.3)),
    ),
    ("gain:reading", [0.5, 0.3], lambda y, t: 0.5 * (y - 0.3)),
    ("cubic-sensor:reading", [0.2, 0.3], lambda y, t: 0.2 * (y - 0.3) ** 3),
    ("rectification:reading", [0.2, 0.3], lambda y, t: 0.4 * np.maximum(0.3 - y, 0.0)),
    ("saturation-sensor:reading", [0.8, 0.6, 0.0, 0.3], lambda y, t: -0.8 * excess(y, 0.6, 0, 0.3)),
    (
        "saturation-sensor:reading",
        [0.8, 0.6, 1.0, 0.3],
        lambda y, t: -0.8 * excess(y, 0.6, 1, 0.3),
    ),
    (
        "saturation-sensor:reading",
        [0.8, -0.6, -1.0, 0.3],
        lambda y, t: -0.8 * excess(y, -0.6, -1, 0.3),
    ),
]


@pytest.mark.parametrize(("name", "own", "added"), READINGS)
def test_an_error_of_the_sensor_is_added_to_the_reading_alone(name, own, added):
    model = make_effect(name, SETTING).apply(DRIVE)
    for t in TIMES:
        h, C, R = reading(DRIVE)
        same(reading(model, t, theta=THETA + own), (h + added(h, t), C, R))
        same(step(model, t, theta=THETA + own), step(DRIVE))


INPUTS = [
    ("input-offset:force", [0.4], lambda u: u + 0.4),
    ("input-gain:force", [0.4, 0.3], lambda u: u + 0.4 * (u - 0.3)),
    ("input-deadzone:force", [0.4, 0.3], lambda u: 0.3 + beyond(u - 0.3, 0.4)),
    ("input-saturation:force", [0.8, 0.6, 0.0, 0.3], lambda u: u - 0.8 * excess(u, 0.6, 0, 0.3)),
    ("input-saturation:force", [0.8, 0.6, 1.0, 0.3], lambda u: u - 0.8 * excess(u, 0.6, 1, 0.3)),
    (
        "input-saturation:force",
        [0.8, -0.6, -1.0, 0.3],
        lambda u: u - 0.8 * excess(u, -0.6, -1, 0.3),
    ),
]


@pytest.mark.parametrize(("name", "own", "seen"), INPUTS)
def test_the_model_is_driven_by_the_input_that_comes_through(name, own, seen):
    model = make_effect(name, SETTING).apply(DRIVE)
    for u in (-2.0, 0.1, 0.5, 0.65, 2.0):
        same(step(model, u=u, theta=THETA + own), step(DRIVE, u=seen(u)))


def off_the_line(s, sharpness):
    """How far exp(-sharpness s) is from the line through its values at -1/2 and 1/2, over that at 0."""
    course = lambda s: np.exp(-sharpness * s)  # noqa: E731
    line = lambda s: course(-0.5) + (s + 0.5) * (course(0.5) - course(-0.5))  # noqa: E731
    return (line(s) - course(s)) / (line(0.0) - course(0.0))


@pytest.mark.parametrize(
    ("name", "own", "damping"),
    [
        ("parameter-step:damping", [0.5, 2.5], lambda t: 1.0 + 0.5 * (t >= 2.5)),
        (
            "parameter-episode:damping",
            [0.5, 1.0, 2.5],
            lambda t: 1.0 + 0.5 * ((t >= 1.0) & (t < 2.5)),
        ),
        ("parameter-drift:damping", [0.5, 2.0, 4.0], lambda t: 1.0 + 0.5 * (t - 2.0) / 4.0),
        (
            "parameter-bend:damping",
            [0.5, 1.5, 2.0, 4.0],
            lambda t: 1.0 + 0.5 * off_the_line(0.25 * (t - 2.0), 1.5),
        ),
        ("parameter-step:damping", [-1.5, 2.5], lambda t: 1.0 * (t < 2.5)),  # not below its bound
    ],
)
def test_a_parameter_changes_with_time_within_its_bounds(name, own, damping):
    model = make_effect(name, SETTING).apply(DRIVE)
    for t in TIMES:
        same(step(model, t, theta=THETA + own), step(DRIVE, theta=[damping(t), 1.0]))


@pytest.mark.parametrize(
    ("own", "damping"),
    [([0.5, 0.3], 1.0 + 0.5 * (FORCE - 0.3)), ([-5.0, 0.3], 0.0)],  # not below its bound
)
def test_a_parameter_depends_on_an_input_within_its_bounds(own, damping):
    model = make_effect("parameter-slope:force->damping", SETTING).apply(DRIVE)
    same(step(model, theta=THETA + own), step(DRIVE, theta=[damping, 1.0]))


def test_a_parameter_that_was_held_moves_to_one_side_only_where_it_is_at_its_bound():
    for value, one_sided in ((0.0, True), (1.5, False)):
        record = Record({}, np.zeros(2), np.ones(2), np.array([value, 1.0]))
        effect = make_effect("held:damping", replace(SETTING, record=record, held=("damping",)))
        assert effect.one_sided is one_sided
        assert effect.size.bounds == (0.0 - value, 10.0 - value)
        model = effect.apply(DRIVE)
        same(step(model, theta=[value, 1.0, 0.5]), step(DRIVE, theta=[value + 0.5, 1.0]))


@pytest.mark.parametrize(
    ("name", "family"),
    [
        ("drag:speed", "state"),
        ("bias:reading", "measurement"),
        ("play:reading", "measurement"),
        ("play:force", "input"),
        ("input-offset:force", "input"),
        ("level:reading", "noise"),
        ("step:reading", "time"),
        ("held:damping", "parameter"),
    ],
)
def test_an_effect_says_where_it_enters(name, family):
    assert make_effect(name, replace(SETTING, held=("damping",))).family == family


def test_only_the_zero_is_set_free_and_only_jumps_are_sought():
    held = make_effect("variance:reading->speed", SETTING)
    size, per, zero = (p.name for p in held.parameters)
    assert (held.size.name, held.held) == (size, (per, zero))
    assert held.with_free_zero().held == (per,)
    assert held.sought == ()
    assert make_effect("step:speed", SETTING).sought == ("step_speed_time",)
    assert make_effect("parameter-step:damping", SETTING).sought == ("parameter_step_damping_time",)
    while_it_lasts = make_effect("parameter-episode:damping", SETTING)
    assert while_it_lasts.held == ()
    assert while_it_lasts.sought == (
        "parameter_episode_damping_time",
        "parameter_episode_damping_end",
    )


LOUDER = np.exp(0.4)


@pytest.mark.parametrize(
    ("name", "own", "factor"),
    [
        ("level:reading", [0.4], lambda t: LOUDER**2),
        ("quantisation:reading", [4e-4], lambda t: 1.4),
        ("variance:reading->speed", [0.7, 2.0, 0.3], lambda t: np.exp(0.35 * np.abs(SPEED - 0.3))),
        ("variance:reading->force", [0.7, 2.0, 0.3], lambda t: np.exp(0.35)),
        ("variance:reading->time", [0.7, 2.0, 1.0], lambda t: np.exp(0.35 * (t - 1.0))),
        ("relative-noise:reading", [0.04, 0.3], lambda t: 1.0 + 40.0 * (SPEED - 0.3) ** 2),
    ],
)
def test_noise_of_a_reading_has_this_variance(name, own, factor):
    model = make_effect(name, SETTING).apply(DRIVE)
    for t in TIMES:
        h, C, R = reading(DRIVE)
        same(reading(model, t, theta=THETA + own), (h, C, R * np.reshape(factor(t), (-1, 1, 1))))


def test_noise_of_a_state_has_this_variance_and_correlation():
    f, A, Q = step(DRIVE)
    for name, row in (("level:speed", 0), ("level:load", 1)):
        found = step(make_effect(name, SETTING).apply(DRIVE), theta=[*THETA, 0.4])
        wanted = np.array(Q)
        wanted[:, row, row] *= LOUDER**2
        same(found, (f, A, wanted))
    found = step(make_effect("correlation:speed,load", SETTING).apply(DRIVE), theta=[*THETA, 0.4])
    wanted = np.array(Q)
    wanted[:, 0, 1] = wanted[:, 1, 0] = 0.4 * np.sqrt(Q[:, 0, 0] * Q[:, 1, 1])
    same(found, (f, A, wanted))


@pytest.mark.parametrize(
    ("name", "own", "rate"),
    [
        ("force:air", [0.6], lambda x, z: 0.6),
        ("force:masonry", [0.6], lambda x, z: 0.6),
        ("step:air", [0.6, 1.0], lambda x, z: 0.6),
        ("drag:air", [0.3, 17.0], lambda x, z: -0.3 * (x - 17.0) * np.abs(x - 17.0)),
        ("coulomb:air", [0.3, 17.0], lambda x, z: -0.3 * np.sign(x - 17.0)),
        ("coulomb:air->masonry", [0.3, 17.0], lambda x, z: -0.3 * np.sign(x - 17.0)),
        ("linear:air", [0.3, 17.0], lambda x, z: 0.3 * (x - 17.0)),
        ("linear:masonry", [0.3, 17.0], lambda x, z: 0.3 * (z - 17.0)),
        ("coupling:air->masonry", [0.3, 17.0], lambda x, z: 0.3 * (x - 17.0)),
        ("coupling:masonry->air", [0.3, 17.0], lambda x, z: 0.3 * (z - 17.0)),
    ],
)
def test_in_a_short_step_of_a_continuous_model_a_force_is_its_rate(name, own, rate):
    """However it is divided between the step's beginning and its end."""
    base, dt, z = room(continuous=True), 1e-6, 19.0
    air, u = np.array([12.0, 16.0, 21.0, 25.0]), np.array([2.0, 5.0])
    effect = make_effect(name, Setting(base, span=(0.0, 5.0), dt=dt))
    model = effect.apply(base)
    theta = [0.1, 0.2, 0.5]
    ends = []
    for one, values in ((base, theta), (model, theta + own)):
        f, A, _ = one.transition(air[:, None], u, 1.5, dt, one.record(np.array(values)))
        ends.append(np.broadcast_to(f + A[..., 0] * z, (4, 2)))
    wanted = np.zeros((4, 2))
    wanted[:, int(name.endswith("masonry"))] = rate(air, z)
    np.testing.assert_allclose((ends[1] - ends[0]) / dt, wanted, rtol=1e-4, atol=1e-5)
