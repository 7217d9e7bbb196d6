"""What begins and is over again, as a door that stands open for an hour, is found with both of its times."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import engine
from engine.diagnose import diagnose
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.screening.episodes import NEAR, lengths, near, promising, strides
from engine.diagnose.screening.screening import screen_effects
from engine.estimation.quasi_ml import quasi_ml
from tests.engine.hidden_effects import case

T, BEGIN, END = 200, 90, 105


def room():
    """A room, its heater and the weather; minutes."""

    def dynamics(a, u, t, dt, theta):
        stays = np.exp(-dt / theta.tau)
        return [(1.0 - stays) * (u[1] + theta.gain * u[0])], [[stays]], [[theta.q]]

    return engine.MixedModel(
        name="room",
        dynamics=dynamics,
        measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r]]),
        initial=lambda theta: (None, [18.0], [[4.0]]),
        nonlinear={},
        linear={"air": "degC"},
        inputs={"heater": "kW", "outside": "degC"},
        outputs={"thermometer": "degC"},
        parameters=[
            engine.Parameter("tau", 40.0, "min", (1.0, 1e3)),
            engine.Parameter("gain", 12.0, "K/kW", (0.0, 100.0)),
            engine.Parameter("q", 0.01, "K^2", (1e-9, 10.0)),
            engine.Parameter("r", 0.04, "K^2", (1e-9, 10.0)),
        ],
    )


def record(seed, cold, begin=BEGIN, end=END):
    """Readings every 2 minutes; the air loses ``cold`` kelvin a minute while a door is open."""
    rng = np.random.default_rng(seed)
    heater = np.repeat(rng.choice([0.0, 1.0], T // 20), 20)
    outside = 5.0 + 3.0 * np.sin(np.arange(T) / 40.0)
    x, y = 18.0, np.empty(T)
    for k in range(T):
        y[k] = x + 0.2 * rng.standard_normal()
        stays = np.exp(-2.0 / 45.0)
        x = stays * x + (1.0 - stays) * (outside[k] + 11.0 * heater[k])
        x += 0.1 * rng.standard_normal() - 2.0 * cold * (begin <= k < end)
    u = np.column_stack([heater, outside])
    names = {"y_names": ("thermometer",), "u_names": ("heater", "outside")}
    return engine.Series(y, u, dt=2.0, time_unit="min", **names)


@pytest.mark.long
def test_an_open_door_has_a_beginning_and_an_end():
    kinds = ["episode", "step", "pulse", "variance", "level"]
    found = diagnose(room(), record(1, 0.12), effects=kinds, seed=1, held_out=0)
    (cause,) = found.causes
    assert found.verdict.value == "named"
    assert cause.effect == "episode:air"
    values = cause.parameters
    assert values["episode_air_time"] == pytest.approx(2.0 * BEGIN, abs=4.0)
    assert values["episode_air_end"] == pytest.approx(2.0 * END, abs=4.0)
    assert abs(cause.size + 0.12) < 3.0 * cause.standard_error
    assert "end 2" in str(found).partition("1. What")[0]


@pytest.mark.parametrize("seed", [1, 2])
def test_the_screen_sees_both_ends_of_what_lasts_for_half_of_the_record(seed):
    series = record(seed, 0.12, 50, 150)
    fit = quasi_ml(room(), series)
    setting = setting_for(fit.model, series, np.asarray(fit.theta))
    seen = screen_effects(fit, series, setting, ["episode"], 0.05, 1, lambda *_: None)
    (air,) = (score for score in seen.scores if score.effect.name == "episode:air")
    assert air.at == pytest.approx((100.0, 300.0), abs=6.0)


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_both_ends_of_what_a_good_sensor_reads_are_found_to_the_sample(seed):
    """One sample off, and nothing is seen of it: windows of some lengths only were asked."""
    model, series, name = case("episode", seed)
    fit = quasi_ml(model, series)
    setting = setting_for(model, series, np.asarray(fit.theta))
    seen = screen_effects(fit, series, setting, [name], 0.05, 1, lambda *_: None)
    assert seen.scores[0].at == pytest.approx((16.0, 17.5))


def test_windows_of_a_good_sensor_are_more_chances():
    """Where one sample changes everything each pair of ends is one; else those that are far apart are."""
    n = 400
    scores, information = np.random.default_rng(1).standard_normal(n), np.ones(n)
    of_force = promising(scores, information, [], lambda ws: np.diff(ws)[:, 0].astype(float))[1]
    of_reading = promising(scores, information, [], lambda ws: np.full(len(ws), 2.0))[1]
    assert 2.0 * n < of_force < 20.0 * n
    assert of_reading == pytest.approx(0.5 * n * 0.8 * n, rel=0.02)


def cold_store():
    """A cold store by Euler steps of a minute; a parameter says what its walls lose per kelvin."""
    none = np.zeros((1, 0))
    return engine.MixedModel(
        name="store",
        dynamics=lambda a, u, t, dt, theta: (
            [a[:, 0] + dt * (theta.loss * (u[1] - a[:, 0]) - u[0]) / theta.store],
            none,
            [[theta.q * dt]],
        ),
        measurement=lambda a, u, t, theta: ([a[:, 0]], none, [[theta.r]]),
        initial=lambda theta: (engine.Gaussian([-15.0], [[9.0]]), [], np.zeros((0, 0))),
        nonlinear={"air": "degC"},
        linear={},
        inputs={"cooling": "kW", "outside": "degC"},
        outputs={"thermometer": "degC"},
        parameters=[
            engine.Parameter("loss", 0.2, "kW/K", (0.0, 5.0)),
            engine.Parameter("store", 60.0, "kW min/K", (1.0, 1e3)),
            engine.Parameter("q", 1e-3, "K^2/min", (1e-9, 10.0)),
            engine.Parameter("r", 0.01, "K^2", (1e-9, 10.0)),
        ],
    )


def measured_store(seed, opened):
    """Readings every minute by steps of 3 s; through an open door the loss is ``opened`` kW/K larger."""
    rng, n = np.random.default_rng(seed), 500
    cooling = np.repeat(rng.choice([3.0, 13.0], n // 20), 20)
    outside = 20.0 + 4.0 * np.sin(np.arange(n) / 80.0)
    x, y, dt = -15.0, np.empty(n), 0.05
    for k in range(n):
        y[k] = x + 0.1 * rng.standard_normal()
        loss = 0.2 + opened * (200 <= k < 280)
        for _ in range(20):
            x += dt * (loss * (outside[k] - x) - cooling[k]) / 50.0
            x += 0.03 * np.sqrt(dt) * rng.standard_normal()
    return engine.Series(y, np.column_stack([cooling, outside]), dt=1.0, time_unit="min")


@pytest.mark.slow
def test_what_a_door_lets_in_depends_on_how_cold_it_is():
    """As a force that is always the same it needed a stiffness beside it that is not there."""
    (cause,) = (found := diagnose(cold_store(), measured_store(1, 0.3), seed=1)).causes
    assert found.verdict.value == "named"
    assert cause.effect == "parameter-episode:loss"
    values = cause.parameters
    assert values["parameter_episode_loss_time"] == pytest.approx(200.0, abs=2.0)
    assert values["parameter_episode_loss_end"] == pytest.approx(280.0, abs=2.0)
    assert cause.size == pytest.approx(0.3, abs=0.03)


@pytest.mark.long
def test_the_screen_tells_a_larger_loss_from_a_force():
    model, series = cold_store(), measured_store(2, 0.3)
    fit = quasi_ml(model, series)
    setting = setting_for(fit.model, series, np.asarray(fit.theta))
    kinds = ["episode", "parameter-episode"]
    seen = screen_effects(fit, series, setting, kinds, 0.05, 1, lambda *_: None)
    assert seen.scores[0].effect.name == "parameter-episode:loss"
    assert seen.scores[0].at == pytest.approx((200.0, 280.0), abs=3.0)


@pytest.mark.slow
def test_a_door_open_for_half_of_the_record_is_no_step_beside_another_episode():
    kinds = ["episode", "step", "pulse", "variance", "level"]
    begin, end = 50, 150
    found = diagnose(room(), record(1, 0.12, begin, end), effects=kinds, seed=1, held_out=0)
    (cause,) = found.causes
    assert found.verdict.value == "named"
    assert cause.effect == "episode:air"
    assert cause.parameters["episode_air_time"] == pytest.approx(2.0 * begin, abs=8.0)
    assert cause.parameters["episode_air_end"] == pytest.approx(2.0 * end, abs=8.0)
    assert abs(cause.size + 0.12) < 3.0 * cause.standard_error


@pytest.mark.long
def test_none_is_seen_where_none_was():
    p_values = []
    for seed in range(8):
        series = record(seed, 0.0)
        fit = quasi_ml(room(), series)
        setting = setting_for(fit.model, series, np.asarray(fit.theta))
        seen = screen_effects(fit, series, setting, ["episode"], 0.05, 1, lambda *_: None)
        p_values.append(seen.p_value)
    assert np.sort(p_values)[1] > 0.02  # of eight two below it would be one in a hundred


def test_windows_of_a_record():
    n = 100
    scores, information = np.zeros(n), np.ones(n)
    scores[40:52] = 1.0
    known = lambda windows: np.array([end - begin for begin, end in windows], dtype=float)  # noqa: E731
    windows, _ = promising(scores, information, [], known)
    begin, end = max(windows, key=lambda w: scores[w[0] : w[1]].sum() ** 2 / (w[1] - w[0]))
    assert abs(begin - 40) + abs(end - 52) <= 3
    assert (40, 52) in near((begin, end), n, 1.0)
    for begin, end in promising(scores, information, [46], known)[0]:  # another record begins there
        assert not begin < 46 < end
    assert lengths(n)[0] == 2
    assert 50 < lengths(n)[-1] <= 80
    assert not lengths(2)


def test_ends_of_a_long_window_are_tried_to_the_row():
    every = strides((100, 500))
    assert every[-1] == 1.0
    assert all(2.0 * NEAR * few >= wide for wide, few in pairwise(every))
    assert strides((3, 7)) == [1.0]
