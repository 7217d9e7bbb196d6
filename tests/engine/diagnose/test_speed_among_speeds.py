"""A speed that a model knows only beside another speed: friction counts from rest all the same."""

import numpy as np
import pytest

import engine
from engine.diagnose import diagnose
from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.units import is_per_time

DT, ROWS, FINE = 0.02, 500, 20
WANTED = (1.5, 1.5, 1.5, 1.2, 1.5, 0.0, 0.0, 1.5, -1.5, 0.0)  # m/s, of the drum


def hung(unit="m/s"):
    """A load on a rope from a drum: wherever both speeds count from, the equations are the same."""
    return engine.continuous(
        name="hung",
        drift=lambda a, u, t, theta: (
            [u[0], theta.c * u[0]],
            [[0.0, -1.0], [theta.k, -theta.c]],
        ),
        diffusion=lambda a, u, t, theta: np.diag([0.0, theta.q]),
        measurement=lambda a, u, t, theta: ([0.0], [[0.0, 1.0]], [[theta.r]]),
        initial=lambda theta: (None, [0.0, 0.0], np.diag([1e-4, 1e-3])),
        linear={"stretch": "m", "load": unit},
        inputs={"drum": unit},
        outputs={"speed": unit},
        kinematic=["stretch"],
        parameters=[
            engine.Parameter("k", 50.0, "1/s^2", (1.0, 1000.0)),
            engine.Parameter("c", 1.0, "1/s", (0.0, 100.0)),
            engine.Parameter("q", 1e-3, "m^2/s^3", (0.0, 1.0)),
            engine.Parameter("r", 1e-4, "m^2/s^2", (1e-8, 1.0)),
        ],
    )


def readings(friction, seed=1):
    """Of a load that its guides rub, too, m/s^2; it stands for a while and is mostly on its way up."""
    rng = np.random.default_rng(seed)
    wanted = np.repeat(WANTED, ROWS // len(WANTED))
    drum, u = 0.0, np.empty(ROWS)
    for k, speed in enumerate(wanted):
        drum += np.clip(speed - drum, -0.03, 0.03)
        u[k] = drum
    v, stretch, y, h = 0.0, 0.0, np.empty(ROWS), DT / FINE
    for k in range(ROWS):
        y[k] = v + 0.012 * rng.standard_normal()
        for _ in range(FINE):
            stretch += h * (u[k] - v)
            free = v + h * (45.0 * stretch + 0.8 * (u[k] - v))
            v = np.sign(free) * max(abs(free) - h * friction, 0.0)
            v += 0.02 * np.sqrt(h) * rng.standard_normal()
    return engine.Series(y, u, dt=DT)


@pytest.mark.slow
def test_friction_of_a_load_on_a_rope_is_found_at_rest():
    asked = ["coulomb", "drag", "linear", "episode", "force"]
    found = diagnose(hung(), readings(0.1), effects=asked, seed=1)
    (cause,) = found.causes
    assert cause.effect == "coulomb:load"
    assert cause.size == pytest.approx(0.1, rel=0.3)
    (zero,) = (value for of, value in cause.parameters.items() if of.endswith("_zero"))
    assert zero == pytest.approx(0.0, abs=0.05)
    assert not diagnose(hung(), readings(0.0), effects=asked, seed=1).causes


@pytest.mark.parametrize(("unit", "places"), [("m/s", 2), ("rpm", 2), ("K", 1), ("degC", 1)])
def test_only_of_what_goes_or_flows_the_zero_of_its_unit_is_looked_at(unit, places):
    model = hung(unit)
    setting = setting_for(model, readings(0.0), np.asarray(model.theta()))
    probes = make_effect("coulomb:load", setting).probes
    assert len(probes) == places
    assert (0.0 in [probe[-1] for probe in probes]) == (places == 2)


def test_which_units_are_per_time():
    known = ("m/s", "rpm", "L/min", "kg/h", "1/s", "m", "degC", "V", "bar", "N", "")
    assert [is_per_time(unit) for unit in known] == [True] * 5 + [False] * 6
