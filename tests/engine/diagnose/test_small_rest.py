"""A small rest that nothing names leaves the name of nearly all that was wrong; a large one does not."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import engine
from engine.diagnose import extend, make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.judging import small_rest
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.judging.small_rest import main_alone
from engine.diagnose.judging.verdict import doubts, patchwork, verdict_of
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import Round
from engine.diagnose.screening.screen import Screen
from engine.diagnose.search.pipeline import find_causes
from engine.estimation.quasi_ml import quasi_ml
from tests.engine.diagnose.test_friction import DT, body, by_hand, measured

FREE = ["q", "r"]


@pytest.fixture(scope="module")
def record():
    x, u = measured(T=200)
    noise = 1e-3 * np.random.default_rng(2).standard_normal(len(x))
    return engine.Series(x + noise, u, dt=DT, y_names=["y"], u_names=["force"])


def fitted(series, *names):
    """The fit of the model with these effects, from sizes that are near."""
    model = body()
    setting = setting_for(model, series, np.asarray(model.theta()))
    effects = [make_effect(name, setting) for name in names]
    extended = extend(model, list(names), setting)
    sizes = {e.size.name: 0.9 if e.kind == "coulomb" else 1e-3 for e in effects}
    fit = quasi_ml(extended, series, extended.theta(sizes), [*FREE, *sizes])
    return fit, effects


def found_in_turn(series, first, second):
    """As a search leaves it that found two effects, and something more beside them that nothing explains."""
    base, _ = fitted(series)
    rounds, before, names = [], base, []
    for name in (first, second):
        names.append(name)
        fit, effects = fitted(series, *names)
        gain = 2.0 * (fit.log_likelihood - before.log_likelihood)
        one, before = Refit(effects[-1], fit, gain, gain), fit
        rounds.append(Round(seen(name), (one,), None, (one,)))
    rounds.append(Round(seen("pole:x", 12.0), (), None, ()))
    return Search(base, before, tuple(rounds), True, begun=rounds[0])


def seen(name, statistic=40.0, p_value=0.002):
    traits = SimpleNamespace(unnamed=False, outliers=False)
    effect = SimpleNamespace(name=name, kind=name.partition(":")[0], traits=traits)
    score: Any = SimpleNamespace(effect=effect, p_value=1e-4, statistic=statistic)
    return Screen((score,), p_value, 0.01, np.eye(1), np.ones(499))


@pytest.mark.long
def test_nearly_all_that_is_wrong_has_its_name_whatever_the_rest_is(record):
    found = found_in_turn(record, "coulomb:v", "bias:y")
    assert verdict_of(found, 0.05) is Verdict.UNKNOWN
    alone = main_alone(found, record)
    assert alone is not None
    assert [one.effect.name for one in alone.named] == ["coulomb:v"]
    assert verdict_of(alone, 0.05) is Verdict.NAMED
    assert alone.final.theta["coulomb_v"] == pytest.approx(1.0, rel=0.02)
    assert "bias_y" not in alone.final.theta.names
    (said,) = doubts(alone, 0.05)
    assert said.startswith("Something more is seen beside coulomb:v (p <= 0.002), a small part")
    assert "most like bias:y" in said


@pytest.mark.long
def test_nearly_all_that_is_wrong_has_its_name_though_a_patch_was_found_before_it(record):
    """Behind fitted noise it did not lead."""
    found = found_in_turn(record, "bias:y", "coulomb:v")
    first = found.rounds[0]
    assert first.refits[0].gain < found.rounds[1].refits[0].gain
    found = replace(found, alarm_left=False)
    alone = main_alone(found, record)
    assert alone is not None
    assert [one.effect.name for one in alone.named] == ["coulomb:v"]
    assert "bias_y" not in alone.final.theta.names
    assert alone.rounds[0].screen is first.screen  # whose p-value is that of the alarm
    (said,) = doubts(alone, 0.05)
    assert "most like bias:y" in said


@pytest.mark.long
def test_a_name_for_a_part_of_what_is_wrong_is_not_kept(record, monkeypatch):
    monkeypatch.setattr(small_rest, "REST", 1e-6)
    assert main_alone(found_in_turn(record, "bias:y", "coulomb:v"), record) is None


@pytest.mark.long
def test_a_free_run_that_stays_as_wrong_is_not_explained(record, monkeypatch):
    """As of a patch on the noise, which gains one step ahead only."""
    errors = iter([0.5, 1.0])
    monkeypatch.setattr(small_rest, "_run_error", lambda *_: next(errors))
    assert main_alone(found_in_turn(record, "coulomb:v", "bias:y"), record) is None


def test_a_run_that_is_lost_tells_nothing(record, monkeypatch):
    """The rows before it is are not all of the record."""
    fit, _ = fitted(record)
    y = record.y.copy()
    y[100:] = np.inf
    monkeypatch.setattr(small_rest, "noise_free", lambda *_: (y, None))
    assert np.isnan(small_rest._run_error(fit, record))


def slide(ahead, T=1200, dt=0.02, fine=50):
    """18 kg that stick and slip by 25 N, led to and fro: exactly, or ``ahead`` as by semi-implicit steps."""
    rng, h = np.random.default_rng(1), dt / fine
    goals = np.repeat(rng.uniform(-0.4, 0.4, T // 50), 50)
    x = v = goal = 0.0
    y, u = np.empty(T), np.empty(T)
    for t in range(T):
        y[t] = x + 2e-4 * rng.standard_normal()
        goal += 0.1 * (goals[t] - goal)
        u[t] = np.clip(900.0 * (goal - y[t]) - 120.0 * v, -150.0, 150.0)
        for _ in range(fine):
            before, v = v, by_hand(v, u[t] / 18.0, 25.0 / 18.0, h)
            x += h * (v if ahead else 0.5 * (before + v))
    return engine.Series(y, u, dt=dt, y_names=["encoder"], u_names=["force"])


SLIDE = engine.continuous(
    name="slide",
    drift=lambda a, u, t, th: ([0.0, u[0] / th.m], [[0.0, 1.0], [0.0, 0.0]]),
    diffusion=lambda a, u, t, th: np.diag([1e-10, th.q]),
    measurement=lambda a, u, t, th: ([0.0], [[1.0, 0.0]], [[th.r]]),
    initial=lambda th: (
        engine.Gaussian(np.zeros(0), np.zeros((0, 0))),
        np.zeros(2),
        1e-4 * np.eye(2),
    ),
    nonlinear={},
    linear={"x": "m", "v": "m/s"},
    inputs={"force": "N"},
    outputs={"encoder": "m"},
    parameters=[
        engine.Parameter("m", 20.0, "kg", (1.0, 100.0)),
        engine.Parameter("q", 0.1, "m^2/s^3", (1e-9, 1e3)),
        engine.Parameter("r", 1e-7, "m^2", (1e-10, 1e-2)),
    ],
)


@pytest.mark.slow
@pytest.mark.parametrize("ahead", [False, True], ids=["exact", "semi-implicit"])
def test_a_slide_that_sticks_and_slips_is_named_whoever_made_its_record(ahead):
    kinds = ["coulomb", "stribeck", "deadzone", "pole", "mode", "delay", "hold"]
    found = find_causes(SLIDE, slide(ahead), effects=kinds, seed=1)
    assert found.verdict is Verdict.NAMED
    assert [one.effect.name for one in found.search.named] == ["coulomb:v"]
    assert found.search.small_rest is ahead
    assert found.search.final.theta["coulomb_v"] == pytest.approx(25.0 / 18.0, rel=0.005)
    assert found.search.final.theta["m"] == pytest.approx(18.0, rel=0.005)
    assert any("Something more is seen" in note for note in found.notes) is ahead


def drained(T=250, fine=50):
    """A tank filled by a pump that does nothing below 1.8 V, emptied by an orifice and a small leak."""
    rng = np.random.default_rng(31)
    u, h, y = np.repeat(rng.uniform(0.0, 10.0, T // 25), 25), 6.0, np.empty(T)
    for t in range(T):
        y[t] = h + 0.05 * rng.standard_normal()
        for _ in range(fine):
            flow = 3.2 * max(u[t] - 1.8, 0.0) - 5.0 * np.sqrt(max(h, 0.0)) - 0.05 * h
            h += flow / 15.5 / fine
    return engine.Series(y, u, dt=1.0)


def drain(a, u, t, dt, th):
    flow = th.kp * u[0] - th.co * np.sqrt(np.maximum(a[:, 0], 0.0))
    return [a[:, 0] + dt * flow / 15.5], np.zeros((1, 0)), [[th.q]]


TANK = engine.MixedModel(
    "tank",
    drain,
    lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[th.r]]),
    lambda th: (engine.Gaussian([6.0], [[0.1]]), np.zeros(0), np.zeros((0, 0))),
    {"level": "cm"},
    [
        engine.Parameter("kp", 3.0, "cm^3/s/V", (0.0, 50.0)),
        engine.Parameter("co", 4.0, "cm^2.5/s", (0.0, 50.0)),
        engine.Parameter("q", 1e-3, "cm^2", (1e-9, 10.0)),
        engine.Parameter("r", 1e-2, "cm^2", (1e-6, 10.0)),
    ],
    nonlinear={"h": "cm"},
    inputs={"pump": "V"},
)


@pytest.fixture(scope="module")
def emptied():
    """A search that found the dead zone, what steps of 1 s get wrong, and something small beside."""
    series, fits, effects = drained(), [quasi_ml(TANK, drained())], []
    sizes = {"input-deadzone:pump": 1.7, "time-step:dt": 1.5, "quadratic:h": -1e-4}
    for name, size in sizes.items():
        before = fits[-1]
        setting = setting_for(TANK, series, before.theta[: len(TANK.parameters)])
        effects.append(make_effect(name, setting.beside(before.model)))
        model = effects[-1].apply(before.model)
        theta = model.theta(before.theta.asdict() | {effects[-1].size.name: size})
        free = [*before.free, effects[-1].size.name]
        fits.append(quasi_ml(model, series, theta, free))
    refits = []
    for effect, fit, before in zip(effects, fits[1:], fits[:-1], strict=True):
        gain = 2.0 * (fit.log_likelihood - before.log_likelihood)
        refits.append(Refit(effect, fit, gain, gain))
    rounds = [Round(seen(one.effect.name), (one,), None, (one,)) for one in refits]
    rounds.append(Round(seen("pole:h", 1.0, 0.6), (), None, ()))
    return series, Search(fits[0], fits[-1], tuple(rounds), False, begun=rounds[0])


@pytest.mark.long
def test_what_the_steps_get_wrong_stays_beside_the_first(emptied):
    series, found = emptied
    alone = main_alone(found, series)
    assert alone is not None
    assert [one.effect.name for one in alone.named] == ["input-deadzone:pump", "time-step:dt"]
    assert "quadratic_h" not in alone.final.theta.names
    assert verdict_of(alone, 0.05) is Verdict.NAMED
    first, steps = alone.named
    assert first.gain > 5.0 * steps.gain > 0.0
    assert alone.final.theta["input_deadzone_pump"] == pytest.approx(1.8, rel=0.06)
    (said,) = doubts(alone, 0.05)
    assert said.startswith("Something more is seen beside input-deadzone:pump and time-step:dt")


@pytest.mark.long
def test_beside_the_first_and_the_steps_there_may_be_nothing_more(emptied):
    series, found = emptied
    two = replace(found, rounds=(*found.rounds[:2], found.rounds[-1]), final=found.named[1].fit)
    assert main_alone(two, series) is None


@pytest.mark.long
def test_an_error_of_the_steps_is_no_patch(emptied):
    _, found = emptied
    assert patchwork(found, 0.05) == ""
    steps = found.rounds[1]
    theta = steps.refits[0].fit.theta
    off = theta.asdict() | {"time_step_dt": 3.5}  # no size of an error of steps
    fit = replace(steps.refits[0].fit, theta=steps.refits[0].fit.model.theta(off))
    other = replace(steps.refits[0], fit=fit)
    rounds = (found.rounds[0], replace(steps, refits=(other,)), *found.rounds[2:])
    assert "more than 2 effects" in patchwork(replace(found, rounds=rounds), 0.05)


@pytest.mark.long
def test_a_shape_that_is_left_is_small_as_a_second_effect_is(record):
    """A tenth of the likelihood at most, where the free run keeps next to nothing; and not beside an alarm."""
    base, _ = fitted(record)
    fit, (effect,) = fitted(record, "coulomb:v")
    gain = 2.0 * (fit.log_likelihood - base.log_likelihood)
    one = Refit(effect, fit, gain, gain)
    found = Search(base, fit, (Round(seen("coulomb:v"), (one,), None, (one,)),), False)
    assert small_rest.is_small(0.09 * gain, found, record)
    assert not small_rest.is_small(0.11 * gain, found, record)
    assert not small_rest.is_small(0.09 * gain, replace(found, alarm_left=True), record)
    nowhere_near = replace(found, final=replace(fit, theta=[*base.theta, 0.0]))
    assert not small_rest.is_small(0.0, nowhere_near, record)
