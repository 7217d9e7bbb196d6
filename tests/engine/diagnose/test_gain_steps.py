"""A heater that loses a third of its power, a thermometer that was set anew: gains that change at a time."""

import numpy as np
import pytest

import engine
from engine.diagnose import diagnose, extend, make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.estimation.quasi_ml import quasi_ml

T, DT, WHEN = 400, 60.0, 240  # rows, seconds, the row at which it happens
CAPACITY, LOSS = 50e3, 15.0  # J/K, W/K
KINDS = ["input-gain-step", "gain-step", "parameter-step", "step", "episode", "input-gain"]


def dynamics(a, u, t, dt, theta):
    decay = np.exp(-dt * theta.loss / theta.capacity)
    return [(u[1] + 1e3 * u[0] / theta.loss) * (1.0 - decay)], [[decay]], [[theta.q**2 * dt]]


# the heater's power is taken for what is recorded: no parameter stands for it
BOILER = engine.MixedModel(
    name="boiler",
    dynamics=dynamics,
    measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r**2]]),
    initial=lambda theta: (None, [20.0], [[25.0]]),
    nonlinear={},
    linear={"water": "degC"},
    inputs={"heater": "kW", "ambient": "degC"},
    outputs={"thermometer": "degC"},
    parameters=[
        engine.Parameter("loss", 12.0, "W/K", (1.0, 100.0)),
        engine.Parameter("capacity", 40e3, "J/K", (1e3, 1e6)),
        engine.Parameter("q", 0.003, "K/s^0.5", (1e-6, 1.0)),
        engine.Parameter("r", 0.1, "K", (1e-4, 5.0)),
    ],
)


def record(heater=0.0, thermometer=0.0, seed=1, most=1.0):
    """Water by twenty Euler steps a sample; relative changes of the two gains from ``WHEN`` on.

    ``most`` is the power (kW) of the heater.
    """
    rng = np.random.default_rng(seed)
    power = most * np.repeat(rng.choice([0.0, 0.3, 0.6, 1.0], T // 10), 10)
    ambient = 18.0 + 3.0 * np.sin(0.02 * np.arange(T))
    x, y = 25.0, np.zeros(T)
    for k in range(T):
        on = k >= WHEN
        y[k] = x * (1.0 + thermometer * on) + 0.1 * rng.standard_normal()
        heat = 1e3 * power[k] * (1.0 + heater * on)
        for _ in range(20):
            x += DT / 20.0 * (heat - LOSS * (x - ambient[k])) / CAPACITY
            x += 0.003 * np.sqrt(DT / 20.0) * rng.standard_normal()
    return engine.Series(y, u=np.column_stack([power, ambient]), dt=DT, hold="zoh")


@pytest.mark.long
@pytest.mark.parametrize(
    ("gains", "name"),
    [
        ({"heater": -0.3}, "input-gain-step:heater"),
        ({"thermometer": 0.1}, "gain-step:thermometer"),
    ],
)
def test_a_gain_that_changes_at_a_time_is_named_with_its_size_and_time(gains, name):
    """A weaker heater was a step of the loss and another one of the capacity before: the same by arithmetic."""
    found = diagnose(BOILER, record(**gains), effects=KINDS, seed=1, held_out=0, processes=1)
    assert [cause.effect for cause in found.causes] == [name]
    (cause,), (size,) = found.causes, gains.values()
    assert abs(cause.size - size) < 3.0 * cause.standard_error
    assert cause.standard_error < 0.1 * abs(size)
    (when,) = (value for key, value in cause.parameters.items() if key.endswith("_time"))
    assert abs(when - WHEN * DT) <= 3.0 * DT


@pytest.mark.long
def test_a_gain_counts_from_a_zero_far_below_the_record():
    """Looked for about the middle of the record it came at another row, beside a step of the reading."""
    series = record(thermometer=0.06, seed=2, most=0.6)
    found = diagnose(BOILER, series, effects=["gain-step", "step"], seed=1, held_out=0, processes=1)
    assert [cause.effect for cause in found.causes] == ["gain-step:thermometer"]
    (cause,) = found.causes
    assert abs(cause.size - 0.06) < 3.0 * cause.standard_error < 0.03
    assert abs(cause.parameters["gain_step_thermometer_time"] - WHEN * DT) <= 3.0 * DT
    assert abs(cause.parameters["gain_step_thermometer_zero"]) < 10.0  # below 25 to 48 degC


@pytest.mark.long
def test_a_step_of_the_reading_is_no_gain_that_changes():
    series = record(most=0.6)
    y = series.y + 1.5 * (np.arange(T) >= WHEN)[:, None]
    found = diagnose(
        BOILER, series.replace(y=y), effects=["gain-step", "step"], held_out=0, processes=1
    )
    assert found.verdict.value == "named"
    assert [cause.effect for cause in found.causes] == ["step:thermometer"]


@pytest.mark.long
def test_gains_that_stay_are_left_alone():
    found = diagnose(BOILER, record(), effects=KINDS, seed=1, held_out=0, processes=1)
    assert not found.causes


@pytest.mark.parametrize(
    ("step", "whole"),
    [
        ("input-gain-step:heater", "input-gain:heater"),
        ("gain-step:thermometer", "gain:thermometer"),
    ],
)
def test_from_the_first_sample_on_it_is_the_gain_error_that_is_always_there(step, whole):
    series = record()
    setting = setting_for(BOILER, series, BOILER.theta())

    def likelihood(name, size):
        effect = make_effect(name, setting)
        model = extend(BOILER, [name], setting)
        theta = model.theta(
            {effect.size.name: size, **({effect.timing.name: 0.0} if name == step else {})}
        )
        return quasi_ml(model, series, theta, ["q"], max_iterations=0).log_likelihood

    assert likelihood(step, 0.0) == likelihood(whole, 0.0)
    assert likelihood(step, 0.2) == pytest.approx(likelihood(whole, 0.2), rel=1e-9)
    assert likelihood(step, 0.2) < likelihood(step, 0.0) - 1.0
