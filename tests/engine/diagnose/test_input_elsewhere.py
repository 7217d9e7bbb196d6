"""An input that the model knows may drive a state where no equation says so."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import engine
from engine.diagnose import all_effects, hide
from engine.diagnose.effects.setting import Setting

KINDS = ["extra-input", "input-gain", "input-offset", "force", "bias", "gain", "path", "direct"]


def converter_drift(a, u, t, theta):
    """Currents and voltages of a boost converter, averaged over its cycles; no diode."""
    open_share = 1.0 - u[0] / 100.0
    A = [[-0.36, -open_share / theta.L], [open_share / 0.12, -1.0 / (0.12 * theta.R)]]
    return [theta.Vin / theta.L, 0.0], A


CONVERTER = engine.continuous(
    name="converter",
    drift=converter_drift,
    diffusion=lambda a, u, t, theta: np.diag([theta.q, theta.q]),
    measurement=lambda a, u, t, theta: (
        [0.0, 0.0],
        [[1.0, 0.0], [0.0, 1.0]],
        np.diag([1e-3, 2e-3]),
    ),
    initial=lambda theta: (None, [1.5, 18.0], np.diag([0.1, 0.1])),
    linear={"current": "A", "voltage": "V"},
    inputs={"duty": "%"},
    outputs={"amps": "A", "volts": "V"},
    parameters=[
        engine.Parameter("Vin", 11.0, "V", (5.0, 30.0)),
        engine.Parameter("L", 0.3, "mH", (0.05, 2.0)),
        engine.Parameter("R", 10.0, "ohm", (1.0, 100.0)),
        engine.Parameter("q", 1e-3, "1/ms", (1e-10, 1.0)),
    ],
)


def converter_record(drop, seed, T=250, dt=0.05):
    """A converter whose diode takes ``drop`` V, by another program's integrator."""
    rng = np.random.default_rng(seed)
    duty = np.repeat(rng.uniform(20.0, 60.0, T // 25), 25)
    x = [np.array([1.5, 18.0])]
    for percent in duty[:-1]:
        s = 1.0 - percent / 100.0

        def rates(t, x, s=s):
            i, v = x
            return [(12.0 - s * (v + drop)) / 0.22 - 0.36 * i, (s * i - v / 14.0) / 0.12]

        x.append(solve_ivp(rates, (0.0, dt), x[-1], rtol=1e-8, atol=1e-9).y[:, -1])
    y = np.array(x) + rng.standard_normal((T, 2)) * np.sqrt([1e-3, 2e-3])
    return engine.Series(y, u=duty, dt=dt, time_unit="ms")


@pytest.mark.long
def test_a_drop_that_comes_with_the_duty_is_no_offset_of_a_sensor():
    """A diode's drop acts for the share 1 - duty: it was named a force together with a sensor's offset."""
    found = engine.diagnose(CONVERTER, converter_record(0.7, 1), effects=KINDS, processes=1)
    (cause,) = found.causes
    assert cause.effect == "extra-input:duty->current"
    assert abs(cause.size - 0.7 / 22.0) < 4.0 * cause.standard_error
    assert "beside what the model has of it" in cause.title
    assert found.gain.adopt


def room(a, u, t, dt, theta):
    """A heater that the model has warm the air alone."""
    A = [[1.0 - dt / 30.0, dt / 30.0], [dt / 90.0, 1.0 - dt / 90.0]]
    return [dt * theta.heat * u[0], 0.0], A, dt * 1e-5 * np.eye(2)


ROOM = engine.MixedModel(
    name="room",
    dynamics=room,
    measurement=lambda a, u, t, theta: ([0.0], [[1.0, 0.0]], [[theta.r]]),
    initial=lambda theta: (None, [0.0, 0.0], 0.1 * np.eye(2)),
    linear={"air": "K", "wall": "K"},
    inputs={"heater": "kW"},
    outputs={"thermometer": "K"},
    parameters=[
        engine.Parameter("heat", 0.2, "K/min/kW", (0.0, 5.0)),
        engine.Parameter("r", 0.01, "K^2", (1e-8, 1.0)),
    ],
)


@pytest.mark.long
def test_a_heater_that_warms_the_wall_too():
    rng = np.random.default_rng(3)
    heater = np.repeat(rng.choice([0.0, 1.0, 2.0], 30), 10)
    name, values = "extra-input:heater->wall", {"extra_input_heater_wall": 0.06}
    series = hide(ROOM, [name], values, 300, rng, u=heater, dt=3.0).series
    found = engine.diagnose(ROOM, series, effects=[*KINDS, "pole", "linear"], processes=1)
    (cause,) = found.causes
    assert cause.effect == name
    assert abs(cause.size - 0.06) < 4.0 * cause.standard_error


def test_it_is_not_asked_about_states_that_hold_by_definition():
    """Nor about disturbances of their own, which no input moves."""
    names = {effect.name for effect in all_effects(Setting(engine.get_model("servo")))}
    assert {name for name in names if name.startswith("extra-input")} == {
        "extra-input:drive->velocity"
    }
