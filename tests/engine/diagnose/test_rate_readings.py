"""What pushes a state is in the readings of its rate, too: friction of a cage, with an accelerometer on it."""

from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.diagnose import make_effect
from engine.diagnose.effects.rate_readings import readings_of_rate
from engine.diagnose.effects.setting import Setting

own = engine.Parameter
NO_STATE = engine.Gaussian([], np.zeros((0, 0)))


# a cage on a rope that a drum winds: its acceleration is read, with an offset, and its speed
CAGE = engine.continuous(
    name="cage",
    drift=lambda a, u, t, th: ([u[0], th.c * u[0]], [[0.0, -1.0], [th.k, -th.c]]),
    diffusion=lambda a, u, t, th: np.diag([0.0, 1e-3]),
    measurement=lambda a, u, t, th: (
        [2.0 * th.c * u[0] + th.b, 0.0],
        [[2.0 * th.k, -2.0 * th.c], [0.0, 1.0]],
        1e-3 * np.eye(2),
    ),
    initial=lambda th: (NO_STATE, [0.0, 0.0], np.diag([1e-4, 1e-2])),
    nonlinear={},
    linear={"stretch": "m", "speed": "m/s"},
    inputs={"drum": "m/s"},
    outputs={"acc": "m/s^2", "encoder": "m/s"},
    reference={"speed": 0.0, "stretch": 0.0},
    parameters=[
        own("k", 44.0, "1/s^2", (1.0, 500.0)),
        own("c", 0.8, "1/s", (0.0, 50.0)),
        own("b", 0.1, "m/s^2", (-1.0, 1.0)),
    ],
)


@pytest.mark.long
def test_a_reading_of_a_rate_is_known_by_the_equations():
    assert readings_of_rate(CAGE, "speed") == {0: pytest.approx(2.0, rel=1e-3)}
    assert readings_of_rate(CAGE, "stretch") == {}
    assert readings_of_rate(replace(CAGE, continuous=False), "speed") == {}
    assert readings_of_rate(engine.get_model("oscillator"), "velocity") == {}


@pytest.mark.long
@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1e5])
def test_it_is_in_any_unit_of_time(unit):
    """The same cage in seconds / unit; its numbers are as large as they are then."""
    per = unit  # a speed, in m per that unit
    timed = engine.continuous(
        name="timed",
        drift=lambda a, u, t, th: ([u[0], th.c * u[0]], [[0.0, -1.0], [th.k, -th.c]]),
        diffusion=lambda a, u, t, th: np.diag([0.0, 1e-3 * per**3]),
        measurement=lambda a, u, t, th: ([th.c * u[0]], [[th.k, -th.c]], 1e-3 * np.eye(1)),
        initial=lambda th: (NO_STATE, [0.0, 0.0], np.diag([1e-4, 1e-2 * per**2])),
        nonlinear={},
        linear={"stretch": "m", "speed": "m/s"},
        inputs={"drum": "m/s"},
        outputs={"acc": "m/s^2"},
        parameters=[
            own("k", 44.0 * per**2, "1/s^2", (0.0, np.inf)),
            own("c", 0.8 * per, "1/s", (0.0, np.inf)),
        ],
    )
    assert readings_of_rate(timed, "speed") == {0: pytest.approx(1.0, rel=1e-3)}


@pytest.mark.parametrize(
    ("name", "rate"),
    [
        ("force:speed", lambda x, v: 0.3),
        ("coulomb:speed", lambda x, v: -0.3 * np.sign(v)),
        ("drag:speed", lambda x, v: -0.3 * v * abs(v)),
        ("cubic:stretch->speed", lambda x, v: 0.3 * x**3),
        ("linear:speed", lambda x, v: 0.3 * v),
        ("coupling:stretch->speed", lambda x, v: 0.3 * x),
        ("step:speed", lambda x, v: 0.0),  # it comes later
    ],
)
def test_a_push_on_a_state_is_in_the_readings_of_its_rate_alone(name, rate):
    effect = make_effect(name, Setting(CAGE))
    model = effect.apply(CAGE)
    theta = np.asarray(model.theta({effect.size.name: 0.3}))
    x = np.array([[0.4, 0.7], [-0.2, -0.5]])

    def read(model, theta):
        order = [[*model.nonlinear, *model.linear].index(s) for s in ("stretch", "speed")]
        there = np.empty_like(x)
        there[:, order] = x
        a, z = there[:, : model.na], there[:, model.na :]
        h, C, _ = model.observation(
            np.ascontiguousarray(a), np.array([0.6]), 0.0, model.record(theta)
        )
        return h + np.einsum("...ij,...j->...i", C, z)

    more = read(model, theta) - read(CAGE, theta[:3])
    expected = [[2.0 * rate(*row), 0.0] for row in x]
    np.testing.assert_allclose(more, expected, rtol=1e-3, atol=1e-9)
