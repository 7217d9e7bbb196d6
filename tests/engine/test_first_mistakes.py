"""What a newcomer writes by mistake: taken as meant, or an error that says what to write."""

from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np
import pytest

import engine
from engine.errors import ModelError, OptionError, SeriesError
from engine.words import meant

Y = np.arange(6.0)


@pytest.mark.parametrize(
    ("dt", "unit", "step"),
    [
        (timedelta(minutes=30), "h", 0.5), (np.timedelta64(30, "m"), "hours", 0.5),
        (timedelta(days=7), "week", 1.0), (timedelta(hours=12), "d", 0.5), (2, "s", 2.0),
        (np.float64(0.1), "s", 0.1),
    ],
)  # fmt: skip
def test_a_step_may_be_a_duration(dt, unit, step):
    assert engine.Series(Y, dt=dt, time_unit=unit).dt == step


@pytest.mark.parametrize("dt", ["0.5", [0.5, 0.5], object(), timedelta(0), -1.0, np.nan])
def test_a_step_that_is_none(dt):
    with pytest.raises(SeriesError, match="positive"):
        engine.Series(Y, dt=dt)


def test_times_may_be_dates_in_words():
    dates = [f"2025-01-0{1 + k}T06:00:00" for k in range(6)]
    for given in (dates, np.array(dates), [datetime.fromisoformat(text) for text in dates]):
        for unit, step in (("d", 1.0), ("days", 1.0), ("hours", 24.0), ("week", 1.0 / 7.0)):
            assert engine.Series(Y, t=given, time_unit=unit).dt == pytest.approx(step)
    with pytest.raises(SeriesError, match="neither numbers nor dates"):
        engine.Series(Y, t=[*dates[:5], "tomorrow"])
    with pytest.raises(SeriesError, match="not known how many seconds"):
        engine.Series(Y, t=dates, time_unit="month")


def test_a_name_is_no_model():
    series = engine.Series(Y, dt=1.0)
    for ask in (engine.fit_simulation, engine.rbps_em, engine.rts_em, engine.diagnose):
        with pytest.raises(ModelError, match="the model is 'local-level', of type str"):
            ask("local-level", series)


def test_what_is_no_series_or_not_one(tmp_path):
    level, series = engine.get_model("local-level"), engine.Series(Y, dt=1.0)
    for ask in (
        lambda one: engine.rbpf(level, None, one, 10, 0),
        lambda one: engine.kalman_smoother(level, None, one),
        lambda one: engine.free_run(level, None, one),
    ):
        with pytest.raises(SeriesError, match="2 series were given; one is needed"):
            ask([series, series])
        with pytest.raises(SeriesError, match="of type ndarray; a series is needed"):
            ask(Y)
        assert ask([series])
    for several in (engine.rbps_em, engine.diagnose, engine.fit_simulation):
        with pytest.raises(SeriesError, match="of type NoneType; a series is needed"):
            several(level, None)
    with pytest.raises(ModelError, match="the model is 'ct', of type str"):
        engine.rbpf("ct", None, series, 10, 0)
    with pytest.raises(SeriesError, match="a whole number"):
        series.refined(1.5)
    with pytest.raises(OptionError, match="there is no such file"):
        engine.load(tmp_path / "none.json")


@pytest.mark.parametrize(
    ("parameter", "told"),
    [
        (engine.Parameter("q", "1"), "its default is '1'"),
        (engine.Parameter("q", None), "its default is None"),
        (engine.Parameter("q", 1.0, "", (0.0, "9")), "its upper bound is '9'"),
        (engine.Parameter(3, 1.0), "cannot be used"),
        (("q", 1.0), "no engine.Parameter"),
    ],
)
def test_a_parameter_that_is_not_a_number(parameter, told):
    level = engine.get_model("local-level")
    with pytest.raises(ModelError, match=told):
        engine.MixedModel(
            name="level", dynamics=level.dynamics, measurement=level.measurement, initial=level.initial,
            linear=level.linear, outputs=level.outputs, parameters=[parameter],
        )  # fmt: skip


def test_an_effect_that_is_not_known():
    level, series = engine.get_model("local-level"), engine.Series(np.sin(np.arange(50.0)))
    with pytest.raises(OptionError, match=r"a list is needed: \['bias'\]"):
        engine.diagnose(level, series, effects="bias")
    with pytest.raises(OptionError, match=r"'dely' is not known \(did you mean 'delay'\?\)"):
        engine.diagnose(level, series, effects=["dely"])
    assert meant("qqqq", ["delay"]) == ""


def cooling(rate, **more):
    """A cup that cools, by what ``rate`` makes of its temperature, its rate and the step."""

    def dynamics(a, u, t, dt, theta):
        return [rate(a[:, 0], -theta.k * (a[:, 0] - u[0]), dt)], np.zeros((1, 0)), [[1e-6]]

    return engine.MixedModel(
        "cup",
        dynamics,
        lambda a, u, t, theta: ([a[:, 0]], np.zeros((1, 0)), [[0.01]]),
        lambda theta: (engine.Gaussian([80.0], [[1.0]]), np.zeros(0), np.zeros((0, 0))),
        {"y": "degC"},
        [engine.Parameter("k", 0.01, "1/s", (1e-4, 1.0))],
        nonlinear={"T": "degC"},
        inputs={"room": "degC"},
        **more,
    )


def test_a_rate_is_no_step():
    series = engine.Series(80.0 - np.arange(40.0), np.full(40, 20.0), dt=5.0)
    wrong = cooling(lambda T, rate, dt: rate, continuous=True)
    for ask in (engine.fit_simulation, engine.rbps_em, engine.diagnose, engine.model_check):
        told = "continuous=True says that steps may be shorter.*engine.continuous"
        if ask is engine.model_check:
            assert "does not depend on dt" in ask(wrong)[0]
            continue
        with pytest.raises(ModelError, match=told):
            ask(wrong, series)


@pytest.mark.parametrize(
    "step",
    [
        lambda T, rate, dt: T + dt * rate,
        lambda T, rate, dt: T,  # does not move
        lambda T, rate, dt: T * np.exp(-0.01 * dt),
    ],
)
def test_a_step_may_be_short(step):
    assert not engine.model_check(cooling(step, continuous=True))[0].startswith("Cannot")


def test_a_step_that_is_given_needs_no_dt():
    assert not engine.model_check(cooling(lambda T, rate, dt: rate))[0].startswith("Cannot")
