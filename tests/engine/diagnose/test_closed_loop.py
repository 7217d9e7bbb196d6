"""Records in closed loop: a controller that sees a reading before it sets the input of that row."""

from __future__ import annotations

from types import SimpleNamespace as Of

import numpy as np
import pytest

import engine
from engine.diagnose.effects.catalogue import all_effects, extend
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.judging.feedback import answering, foretold, of_own_row, switched
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import Round
from engine.diagnose.search import pipeline, search
from engine.estimation.quasi_ml import quasi_ml

P = engine.Parameter
Q, R, DT = 0.4, 1.0, 0.5


def dynamics(a, u, t, dt, theta):
    keep = np.exp(-theta.rate * dt)
    return [theta.gain * (1.0 - keep) * u[0]], [[keep]], [[theta.q * dt]]


TANK = engine.MixedModel(
    name="heated-tank",
    nonlinear={},
    linear={"excess": "K"},
    inputs={"heater": "kW"},
    outputs={"probe": "K"},
    reference={"excess": 0.0, "probe": 0.0, "heater": 0.0},
    parameters=[
        P("rate", 0.08, "1/s", (0.01, 1.0)),
        P("gain", 5.0, "K/kW", (0.1, 50.0)),
        P("q", 0.3, "K^2/s", (0.0, 100.0)),
        P("r", 0.7, "K^2", (1e-3, 100.0)),
    ],
    dynamics=dynamics,
    measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r]]),
    initial=lambda theta: (engine.Gaussian([], np.zeros((0, 0))), [0.0], [[4.0]]),
)


def record(seed: int, closed: bool, direct: float = 0.0, later: bool = False) -> engine.Series:
    """Of a PI controller of the same row (or the next), or of the heater's steps as given."""
    rng = np.random.default_rng(seed)
    n, keep = 400, np.exp(-0.1 * DT)
    wanted = np.repeat(rng.uniform(10.0, 30.0, n // 40), 40)
    given = np.repeat(rng.uniform(1.0, 5.0, n // 8), 8)
    x, total, u, y = 0.0, 0.0, np.zeros(n), np.zeros(n)
    for t in range(n):
        y[t] = x + np.sqrt(R) * rng.standard_normal()
        if closed:
            error = wanted[t] - y[t]
            total += error * DT
            now = np.clip(0.6 * error + 0.08 * total, 0.0, 12.0)
            u[t] = u[t] if later else now
            if later and t + 1 < n:
                u[t + 1] = now
        else:
            u[t] = given[t]
            y[t] += direct * u[t]
        noise = np.sqrt(Q * (1.0 - keep**2) / 0.2) * rng.standard_normal()
        x = keep * x + 6.0 * (1.0 - keep) * u[t] + noise
    return engine.Series(y[:, None], u[:, None], dt=DT, y_names=["probe"], u_names=["heater"])


def thermostat(seed: int, closed: bool, direct: float = 0.0) -> engine.Series:
    """A heater that a reading switches on below 18 K and off above 22 K, or that is switched at given times."""
    rng = np.random.default_rng(seed)
    n, keep = 400, np.exp(-0.1 * DT)
    given = np.repeat(np.arange(n) % 2, rng.integers(3, 20, n))[:n]
    x, u, y, on = 20.0, np.zeros(n), np.zeros(n), 0.0
    for t in range(n):
        y[t] = x + np.sqrt(R) * rng.standard_normal()
        on = 1.0 if y[t] < 18.0 else 0.0 if y[t] > 22.0 else on
        u[t] = 6.0 * (on if closed else given[t])
        y[t] += direct * u[t]
        x = keep * x + 6.0 * (1.0 - keep) * u[t] + 0.1 * rng.standard_normal()
    return engine.Series(y[:, None], u[:, None], dt=DT, y_names=["probe"], u_names=["heater"])


def errors_of(series: engine.Series, direct: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """What a Kalman filter that knows all expects of the readings of :func:`thermostat`, and how surely."""
    keep, mean, P = np.exp(-0.1 * DT), 20.0, 0.0
    expected, sd = np.zeros_like(series.y), np.zeros_like(series.y)
    for t, (y, u) in enumerate(zip(series.y[:, 0], series.u[:, 0], strict=True)):
        expected[t], sd[t] = mean + direct * u, np.sqrt(P + R)
        gain = P / (P + R)
        mean = keep * (mean + gain * (y - expected[t, 0])) + 6.0 * (1.0 - keep) * u
        P = keep**2 * (1.0 - gain) * P + 0.1**2
    return expected, sd


@pytest.mark.long
def test_a_thermostat_answers_and_a_switch_by_the_clock_does_not():
    """Past errors foretell little of a thermostat, in 2 of 40 series with as much noise as here."""
    closed, given = [], []
    for seed in range(20):
        series = thermostat(seed, True)
        closed.append(switched(series.u[:, 0], series.y, *errors_of(series)))
        series = thermostat(seed, False, direct=0.2 * (seed % 2))
        given.append(switched(series.u[:, 0], series.y, *errors_of(series, 0.2 * (seed % 2))))
    assert max(closed) < 0.005
    assert sum(p < 0.01 for p in given) < 3
    assert (
        switched(np.arange(400.0), series.y, *errors_of(series)) == 1.0
    )  # of more than two levels


@pytest.mark.long
def test_errors_smaller_than_is_thought_are_no_thermostat():
    """About a cycle by the clock, errors as large as is thought would mix what the readings keep apart."""
    values = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        u = (np.arange(300) % 20 < 10).astype(float)
        expected = np.cumsum(np.where(np.roll(u, 1) > 0.0, 0.1, -0.1))[:, None]
        y = expected + 0.05 * rng.standard_normal((300, 1))
        values.append(switched(u, y, expected, np.full((300, 1), 0.5)))
    assert sum(p < 0.01 for p in values) < 3


def test_where_readings_are_missing_a_thermostat_still_answers():
    series = thermostat(1, True)
    expected, sd = errors_of(series)
    y = np.where(np.random.default_rng(0).random(series.y.shape) < 0.2, np.nan, series.y)
    assert switched(series.u[:, 0], y, expected, sd) < 0.005


@pytest.mark.long
def test_a_thermostat_is_no_direct_path():
    """It was one, with p = 0.003: where a reading is low by chance the heater goes on."""
    found = engine.diagnose(TANK, thermostat(5, True), effects=["direct", "bias", "gain"])
    assert "direct" not in " ".join(cause.effect for cause in found.causes)
    assert "closed loop" in " ".join(found.notes)


def test_a_model_that_is_not_quite_right_is_no_controller():
    """Its errors depend on earlier inputs, which say what the input will be.

    Of 40 series at a level of 0.01, three or more have probability 0.75 %.
    """
    p_values = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        u = np.convolve(rng.standard_normal(202), np.ones(3) / 3.0, "valid")
        errors = rng.standard_normal((200, 1))
        errors[2:, 0] += 1.5 * (u[1:-1] - u[:-2])
        p_values.append(foretold(u, errors))
    assert sum(p < 0.01 for p in p_values) < 3


@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_errors_that_hold_a_part_of_their_own_row_s_input_are_no_controller(memory):
    """An input that is given changes from where it was, and such errors say where that is."""
    p_values = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        u, errors = np.zeros(300), rng.standard_normal((300, 1))
        for t, news in enumerate(rng.standard_normal(300)):
            u[t] = memory * u[t - 1] + news
        errors[:, 0] += 0.5 * u
        p_values.append(foretold(u, errors))
    assert sum(p < 0.01 for p in p_values) < 3


@pytest.mark.parametrize(
    "part",
    [
        lambda u, half: 0.7 * u**2,
        lambda u, half: np.clip(u, -0.5, 0.5),
        lambda u, half: 0.7 * u * half,
    ],
)
def test_nor_are_those_that_hold_some_function_of_it_or_for_some_of_the_time(part):
    """A sensor or a resistance that is bent, or changed half way; of inputs that walk, and that are held."""
    p_values = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        steps = np.repeat(rng.uniform(-1.7, 1.7, 400), rng.integers(3, 30, 400))[:400]
        u = (np.cumsum(rng.standard_normal(400)) if seed % 2 else steps).copy()
        errors = rng.standard_normal((400, 1))
        errors[:, 0] += part((u - u.mean()) / u.std(), np.arange(400) >= 180)
        p_values.append(foretold(u, errors))
    assert sum(p < 0.01 for p in p_values) < 3


@pytest.mark.long
@pytest.mark.parametrize("later", [False, True])
def test_a_controller_is_no_direct_path(later, monkeypatch):
    series = record(3, closed=True, later=later)
    begun, rounds = search.refit_best, []
    monkeypatch.setattr(search, "refit_best", lambda *a, **k: rounds.append(1) or begun(*a, **k))
    found = engine.diagnose(TANK, series, effects=["direct", "bias", "gain", "coulomb"])
    assert found.verdict.value == "nothing"
    # nothing is looked for beside what may be the controller
    assert len(rounds) == (0 if later else 1)
    assert (" closed loop" in " ".join(found.notes)) is not later


@pytest.mark.long
def test_where_nothing_else_is_asked_for_no_cause_is_named():
    found = engine.diagnose(TANK, record(3, closed=True), effects=["direct"])
    assert found.verdict.value == "unknown"
    assert "closed loop" in " ".join(found.notes)
    assert "closed loop" in found.why[0]
    assert found.gain is None or not found.gain.adopt


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
def test_a_direct_path_is_named_where_the_input_is_given(seed):
    found = engine.diagnose(
        TANK, record(seed, False, direct=0.6), effects=["direct", "bias", "gain"]
    )
    assert [cause.effect for cause in found.causes] == ["direct:heater->probe"]
    assert "closed loop" not in " ".join(found.notes)


@pytest.mark.long
def test_the_level_is_kept_where_the_input_is_given_from_outside():
    """Inputs of several kinds seem to answer as rarely as the level says."""
    rng = np.random.default_rng(0)
    n, values = 300, []
    for k in range(400):
        u = (
            np.repeat(rng.standard_normal(30), 10),
            np.cumsum(rng.standard_normal(n)),
            np.sin(0.001 * np.arange(n) ** 1.5),
            np.sign(np.sin(0.11 * np.arange(n))),
        )[k % 4]
        values.append(foretold(u, rng.standard_normal((n, 1))))
    assert min(values) > 1e-4
    assert np.mean(np.array(values) < 0.05) < 0.07


@pytest.mark.long
def test_inputs_that_answer_are_known():
    for closed in (False, True):
        for seed in range(6):
            series = record(seed, closed, direct=0.6)
            model = extend(TANK, ["direct:heater->probe"], setting_for(TANK, series, TANK.theta()))
            fit = quasi_ml(model, series)
            assert answering(fit, series) == (["heater"] if closed else [])


@pytest.mark.long
def test_effects_that_compare_a_reading_with_the_input_of_its_row():
    series = record(1, False)
    setting = setting_for(TANK, series, TANK.theta())
    kinds = {e.name for e in all_effects(setting) if of_own_row(e, setting, ["heater"])}
    assert {"direct:heater->probe", "hold:heater", "variance:probe->heater"} <= kinds
    assert not kinds & {
        "bias:probe",
        "gain:probe",
        "delay:heater",
        "input-offset:heater",
        "pole:excess",
    }


@pytest.mark.long
def test_errors_are_not_sorted_by_an_input_that_saw_them():
    found = engine.diagnose(TANK, record(3, closed=True), effects=["bias"])
    assert "whenever the input" not in str(found)


@pytest.mark.parametrize("unit", [1e-15, 1e15])
def test_errors_foretell_an_input_in_any_unit(unit):
    """In mF or in fF: small numbers were lost beside the clock's."""
    rng = np.random.default_rng(2)
    errors = rng.standard_normal((400, 1))
    u = np.cumsum(rng.standard_normal(400)) + np.r_[0.0, 0.3 * errors[:-1, 0]]
    assert foretold(unit * u, errors) == pytest.approx(foretold(u, errors), rel=1e-6)


def answered(seed: int, wide: float) -> tuple[np.ndarray, np.ndarray]:
    """An input of a controller whose set point steps by ``wide`` errors of a reading, and these errors."""
    rng = np.random.default_rng(seed)
    n, keep, x, total = 300, 0.9, 0.0, 0.0
    wanted = np.repeat(rng.uniform(0.0, wide, n // 30), 30)
    errors, u = rng.standard_normal(n), np.zeros(n)
    for t in range(n):
        error = wanted[t] - x - errors[t]
        total += 0.05 * error
        u[t] = np.clip(2.0 * (error + total), 0.0, 2.0 * wide)
        x = keep * x + (1.0 - keep) * u[t]
    return u, errors[:, None]


@pytest.mark.parametrize("wide", [20.0, 100.0, 1000.0])
def test_a_set_point_that_steps_does_not_hide_the_controller(wide):
    """Beside steps that are large, what it makes of errors is little of an input's power."""
    found, given = 0, 0
    for seed in range(20):
        u, errors = answered(seed, wide)
        _, others = answered(seed + 20, wide)
        found += foretold(u, errors) < 0.005
        given += foretold(u, others) < 0.005
    assert found >= 18
    assert given <= 1


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_it_is_told_in_any_units(scale):
    u, errors = answered(1, 100.0)
    assert foretold(scale * u, errors) == pytest.approx(foretold(u, errors), rel=1e-6)


def test_the_errors_without_a_path_that_undoes_the_controller_are_asked_too(monkeypatch):
    """Beside it, and what else was found, nothing is left of the errors that a controller answers."""
    series = record(3, closed=True)
    setting = setting_for(TANK, series, TANK.theta())
    direct = next(e for e in all_effects(setting) if e.name == "direct:heater->probe")
    led = Refit(direct, None, 50.0, 50.0)
    base, final = Of(name="base"), Of(name="final")
    found = Search(base, final, (Round(None, (led,), None, (led,)),), False)
    asked = []

    def answering(fit, series):
        asked.append(fit.name)
        return ["heater"] if fit is base else []

    monkeypatch.setattr(pipeline, "answering", answering)
    aside = pipeline._seen_by_a_controller(found, series, setting, None)
    assert asked == ["final", "base"]
    assert "closed loop" in aside.note
    assert direct.name not in aside.others
