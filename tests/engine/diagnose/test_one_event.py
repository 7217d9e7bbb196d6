"""A lift takes a load: three of its parameters step, and that is one event, not three patches."""

from types import SimpleNamespace

import numpy as np
import pytest

import engine
from engine.diagnose import diagnose, extend, make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.judging.one_event import as_between_samples, as_one_event
from engine.diagnose.judging.verdict import patchwork, verdict_of
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import Round
from engine.estimation.quasi_ml import quasi_ml

T, DT = 400, 0.1
NAMES = ["parameter-step:push", "parameter-step:drag", "parameter-step:weight"]
BEFORE, AFTER = np.array([2.0, 0.8, 1.0]), np.array([1.4, 0.5, 1.6])


def dynamics(a, u, t, dt, theta):
    step = dt * (theta.push * u[0] - theta.weight)
    return [step], [[1.0 - dt * theta.drag]], [[theta.q * dt]]


LIFT = engine.MixedModel(
    name="lift",
    dynamics=dynamics,
    measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r]]),
    initial=lambda theta: (None, [0.0], [[0.01]]),
    nonlinear={},
    linear={"speed": "m/s"},
    inputs={"motor": "V"},
    outputs={"reading": "m/s"},
    parameters=[
        engine.Parameter("push", 1.5, "m/s^2/V", (0.01, 10.0)),
        engine.Parameter("drag", 0.6, "1/s", (0.01, 5.0)),
        engine.Parameter("weight", 1.2, "m/s^2", (0.0, 10.0)),
        engine.Parameter("q", 1e-5, "m^2/s^3", (1e-9, 10.0)),
        engine.Parameter("r", 1e-4, "m^2/s^2", (1e-9, 10.0)),
    ],
)


def record(rows):
    """Each of the parameters steps at a row of its own."""
    rng = np.random.default_rng(5)
    u = np.repeat(rng.uniform(-1.0, 3.0, T // 10), 10)
    speed, y = 0.0, []
    for k in range(T):
        y.append(speed + 0.01 * rng.standard_normal())
        push, drag, weight = np.where(k >= np.array(rows), AFTER, BEFORE)
        speed += DT * (push * u[k] - drag * speed - weight)
        speed += np.sqrt(1e-5 * DT) * rng.standard_normal()
    return engine.Series(np.array(y), u=u, dt=DT)


def found(rows, times):
    """A search that found the three steps at these ``times``, its final fit begun there."""
    series, model = record(rows), extend(LIFT, NAMES)
    every = [make_effect(name, Setting(LIFT)) for name in NAMES]
    sizes = [effect.size.name for effect in every]
    start = dict(zip(["push", "drag", "weight"], BEFORE, strict=True))
    start |= {"q": 1e-5, "r": 1e-4} | dict(zip(sizes, AFTER - BEFORE, strict=True))
    start |= {f"{size}_time": t for size, t in zip(sizes, times, strict=True)}
    final = quasi_ml(model, series, start, ["push", "drag", "weight", *sizes])
    refits = [Refit(effect, final, 50.0, 50.0) for effect in every]
    seen = SimpleNamespace(p_value=0.6)
    rounds = [Round(seen, (refit,), None, (refit,)) for refit in refits]
    return Search(final, final, (*rounds, Round(seen, (), None, ())), False), series


@pytest.mark.long
@pytest.mark.parametrize("times", [(20.0, 20.1, 20.0), (20.1, 20.1, 20.2)])
def test_times_that_differ_by_chance_are_one(times):
    search, series = found((200, 200, 200), times)
    assert patchwork(search, 0.05) == "more than 2 effects are needed"
    search, said = as_one_event(search, series)
    assert search.at_once == tuple(NAMES)
    assert said.startswith(
        "parameter-step:push, parameter-step:drag and parameter-step:weight are one event"
    )
    assert "t = 20 s" in said
    assert patchwork(search, 0.05) == ""
    assert verdict_of(search, 0.05).value == "named"


@pytest.mark.long
def test_one_of_three_may_have_come_by_itself():
    search, series = found((200, 300, 200), (20.0, 30.0, 20.0))
    search, _ = as_one_event(search, series)
    assert search.at_once == (NAMES[0], NAMES[2])
    assert patchwork(search, 0.05) == ""  # two that are trusted


@pytest.mark.long
def test_times_that_differ_indeed_stay_three():
    search, series = found((100, 300, 200), (10.0, 30.0, 20.0))
    search, said = as_one_event(search, series)
    assert not search.at_once
    assert not said
    assert verdict_of(search, 0.05).value == "unknown"


@pytest.mark.slow
def test_a_load_is_named_by_what_it_alters():
    told = diagnose(
        LIFT, record((200, 200, 200)), seed=1, effects=["parameter-step", "drag", "bias"]
    )
    assert told.verdict.value in ("named", "set")
    assert {cause.effect for cause in told.causes} == set(NAMES)
    assert any("are one event" in note for note in told.notes)


@pytest.mark.parametrize(("second", "said"), [(2.003, ""), (1.8, "more than 2 effects are needed")])
def test_a_wave_and_its_overtone_are_one(second, said):
    """A season rises faster than it falls: two harmonics, one cause."""
    setting = Setting(engine.get_model("local-level"))
    names = ["harmonic:level", "harmonic:flow", "pole:level"]
    effects = [make_effect(name, setting) for name in names]
    first, other = (f"{effect.size.name}_frequency" for effect in effects[:2])
    fit = SimpleNamespace(
        theta={first: 1.001, other: second}, free=[first, other], standard_errors=[0.001, 0.002]
    )
    rounds = (SimpleNamespace(equivalent=("pole",)),)
    search = SimpleNamespace(
        named=[SimpleNamespace(effect=effect, fit=fit) for effect in effects],
        final=fit,
        at_once=(),
        rounds=rounds,
        of_the_steps="",
        has_noise_apart=False,
    )
    assert patchwork(search, 0.05) == said


@pytest.mark.parametrize(
    ("at", "width", "one"),
    [(19.9, 0.1, True), (20.1, 0.1, True), (19.7, 0.1, False), (20.0, 0.5, False)],
)
def test_a_pulse_of_one_sample_next_to_a_step_is_its_part(at, width, one):
    """A line trips between two samples: what it does in the rest of that sample looked like a second cause."""
    names = ["parameter-step:push", "pulse:speed", "drag:speed"]
    effects = [make_effect(name, Setting(LIFT)) for name in names]
    step, pulse = (effect.size.name for effect in effects[:2])
    values = {f"{step}_time": 20.0, f"{pulse}_time": at, f"{pulse}_width": width}
    fit = SimpleNamespace(theta=SimpleNamespace(asdict=lambda: values))
    refits = [Refit(effect, fit, 50.0, 50.0) for effect in effects]
    rounds = tuple(
        Round(SimpleNamespace(p_value=0.6), (refit,), None, (refit,)) for refit in refits
    )
    series = engine.Series(np.zeros(T), u=np.zeros(T), dt=DT)
    search, told = as_between_samples(Search(fit, fit, rounds, False), series)
    assert search.at_once == (tuple(names[:2]) if one else ())
    assert [note.startswith("pulse:speed lasts one sample") for note in told] == [True] * one
    assert patchwork(search, 0.05) == ("" if one else "more than 2 effects are needed")
