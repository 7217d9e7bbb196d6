"""What print shows of results: short tables; and pandas on both sides."""

import builtins
import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

import engine
from engine.data import nile
from engine.data.clock import times_in
from engine.errors import OptionError, SeriesError
from engine.presentation.examination import estimate_document
from engine.presentation.report.estimate import estimates
from engine.presentation.report.parts import plus_minus
from engine.words import ends
from service.cli.fit import table as fit_table

LEVEL = engine.get_model("local-level")
EM = engine.rbps_em(LEVEL, nile(), free=["q"], n_particles=10, n_iterations=2, seed=1)
RNG = np.random.default_rng(0)


def results():
    growth = engine.get_model("oscillator")
    u = np.sin(np.arange(60.0))
    run = engine.simulate(growth, None, 60, RNG, u=u, dt=0.1)
    filtered = engine.rbpf(LEVEL, None, nile(), 10, RNG)
    return [
        (EM, ["local-level: 2 iterations", "Log-likelihood before the last", "fixed"]),
        (nile(), ["100 samples", "flow", "919.4"]),
        (
            engine.fit_simulation(LEVEL, nile()),
            ["simulation-error fit", "no influence", "1e16 m^6"],
        ),
        (LEVEL, ["z' = z + w", "variance of the measurement"]),
        (run, ["60 samples", "every 0.1 s"]),
        (engine.free_run(growth, None, run.series), ["free run over 60 samples"]),
        (filtered, ["filtered by 10 particles", "Log-likelihood", "Effective sample size"]),
        (engine.rb_ffbsi(filtered, 10, RNG), ["smoothed by 10 trajectories"]),
        (engine.kalman_smoother(LEVEL, None, nile()), ["KalmanSmoothed"]),
    ]


@pytest.mark.parametrize(("result", "words"), results(), ids=lambda one: type(one).__name__)
def test_short_tables(result, words):
    text = str(result)
    assert len(text.splitlines()) < 25
    assert max(map(len, text.splitlines())) <= 120
    for word in words:
        assert word in text
    assert len(repr(result)) < 200
    assert "\n" not in repr([result])


def test_columns_stand_beneath_their_names():
    lines = str(EM).splitlines()
    head = next(line for line in lines if line.startswith("parameter"))
    (q,) = (line for line in lines if line.startswith("q "))
    assert q.split()[1] == f"{EM.theta['q']:.4g}"
    assert q[: head.index("estimate") + len("estimate")].endswith(q.split()[1])


# ---- times --------------------------------------------------------------------------------------


BEGIN = datetime(2024, 3, 31, 0, 30, tzinfo=UTC)


@pytest.mark.parametrize(
    "times",
    [
        np.datetime64("2024-03-31T00:30") + np.arange(4) * np.timedelta64(90, "s"),
        [BEGIN + timedelta(seconds=90 * k) for k in range(4)],
        [(BEGIN + timedelta(seconds=90 * k)).replace(tzinfo=None) for k in range(4)],
        np.arange(4) * np.timedelta64(90, "s"),
        [0, 90, 180, 270],
    ],
    ids=["datetime64", "with a zone", "without one", "timedelta64", "numbers"],
)
def test_dates_become_seconds_from_the_first(times):
    np.testing.assert_array_equal(times_in(times, "s"), [0.0, 90.0, 180.0, 270.0])
    assert engine.Series(np.arange(4.0), t=times).dt == 90.0


def test_what_is_no_time_is_refused():
    with pytest.raises(SeriesError, match="t is neither numbers nor dates"):
        engine.Series(np.arange(2.0), t=["yesterday", "today"])
    gap = np.array(["2024-01-01", "NaT", "2024-01-03"], dtype="datetime64[s]")
    with pytest.raises(SeriesError, match="t is not finite at row 1"):
        engine.Series(np.arange(3.0), t=gap)
    with pytest.raises(SeriesError, match="t decreases at row 1"):
        engine.Series(
            np.arange(2.0), t=np.array(["2024-01-02", "2024-01-01"], dtype="datetime64[D]")
        )


# ---- large values with small errors --------------------------------------------------------------

NEAR = replace(
    LEVEL,
    parameters=[
        replace(p, default=v, bounds=(0.0, np.inf))
        for p, v in zip(LEVEL.parameters, (131.4902, 20004.3, 3e7), strict=True)
    ],
)
SURE = engine.StandardErrors(
    NEAR,
    NEAR.theta(),
    tuple(NEAR.parameter_names),
    np.diag([0.0061, 3.8, 20.0]) ** 2,
    *np.zeros((3, 3)),
)
ENDS = (("131.478", "131.502"), ("19996.9", "20011.7"), ("29999961", "30000039"))


def test_intervals_are_shown_to_the_digits_of_their_width():
    ratio = engine.LikelihoodIntervals(
        NEAR, NEAR.theta(), 0.95, SURE.interval(), np.zeros((3, 2)), np.array(NEAR.theta())
    )
    for (low, high), value in zip(
        ENDS, ("131.4902 +- 0.0061", "20004.3 +- 3.8", "30000000 +- 20"), strict=True
    ):
        assert f", 95 %: {low} to {high}" in str(SURE)
        assert value in str(SURE)
        assert f">{low}</td>" in SURE._repr_html_()
        assert re.search(rf"{low} +{high}", str(ratio))
        assert f">{high}</td>" in ratio._repr_html_()


def test_what_a_command_prints_and_a_report_show_intervals_so_too():
    document = estimate_document(NEAR, NEAR.theta(), NEAR.parameter_names, SURE)
    printed = fit_table(NEAR, [], {"estimate": document, "message": ""})
    assert len({line.index(" to ") for line in printed[2:]}) <= 2
    shown = estimates({"estimate": document})
    for low, high in ENDS:
        assert f"{low} to {high}" in "\n".join(printed)
        assert f"{low} to {high}" in shown
    assert "131.4902" in shown
    assert plus_minus(131.4902, 0.0061) == "131.4902 ± 0.0061"


def test_the_ends_of_any_interval():
    assert ends(0.52, 0.58) == ("0.52", "0.58")
    assert ends(0.9996, 1.0002, "N") == ("0.9996 N", "1.0002 N")
    assert ends(131.49, np.inf) == ("131.5", "inf")
    assert ends(None, None) == ends(np.nan, np.nan) == ("?", "?")
    assert ends(-1e-9, 2.0) == ("-1e-09", "2")
    assert ends(1.0 / 3.0, 1.0 / 3.0) == ("0.3333", "0.3333")


# ---- pandas -------------------------------------------------------------------------------------


def test_pandas_tables_bring_names_and_times():
    pandas = pytest.importorskip("pandas")
    index = pandas.date_range(
        "2024-03-31", periods=8, freq="30min", tz="Europe/Berlin"
    )  # over a change of clocks
    y = pandas.DataFrame({"level": np.arange(8.0), "flow": 1.0}, index=index)
    u = pandas.Series(np.ones(8), index=index, name="pump")
    series = engine.Series(y, u)
    assert series.dt == 1800.0
    assert series.t[0] == 0.0
    assert (series.y_names, series.u_names) == (("level", "flow"), ("pump",))
    assert engine.Series(y, u, dt=2.0).dt == 2.0  # what is said goes before what is found
    assert engine.Series(y, y_names=["a", "b"]).y_names == ("a", "b")
    with pytest.raises(SeriesError, match="y and u have different indices"):
        engine.Series(y, u.set_axis(index + pandas.Timedelta("1s")))
    decimal = pandas.DataFrame({"flow": [1.0, 2.0, 3.0]}, index=[0.0, 0.02, 0.04])
    assert engine.Series(decimal).dt == pytest.approx(0.02)
    assert engine.Series(decimal.reset_index(drop=True)).dt == 1.0  # row numbers say nothing


@pytest.mark.parametrize(
    ("index", "other", "said"),
    [
        ([0, 1, 2, 3], [3, 2, 1, 0], r"\(row 0 is 0 in y and 3 in u\); join them first"),
        ([0, 1, 2, 3], [1, 2, 3, 4], r"row 0 is 0 in y and 1 in u"),
        ([0, 1, 3, 2], [0, 1, 2, 3], r"row 2 is 3 in y and 2 in u"),
        ("abcd", "abdc", "row 2 is c in y and d in u"),
        ("dates", [4, 5, 6, 7], "row 0 is 2026-.* in y and 4 in u"),
        ([4, 5, 6, 7], [4, 5, 6, 7], ""),
        ([0, 1, 0, 1], [0, 1, 0, 1], ""),
        ("dates", None, ""),
        (None, "dates", ""),
        ("abcd", None, ""),
        (None, None, ""),
    ],
)
@pytest.mark.filterwarnings("ignore:the index goes from")  # as two of these do
def test_rows_of_pandas_tables_are_those_of_one_index(index, other, said):
    pandas = pytest.importorskip("pandas")
    dates = pandas.date_range("2026-01-01", periods=4, freq="s")
    index, other = (
        dates if one == "dates" else None if one is None else list(one) for one in (index, other)
    )
    y, u = pandas.Series(np.arange(4.0), index), pandas.Series(np.ones(4), other)
    clock = pandas.Series(np.arange(4.0), other)
    for given in ({"u": u}, {"u": u, "t": np.arange(4.0)}, {"extra": u, "dt": 1.0}, {"t": clock}):
        if said:
            which = next(iter(given))
            with pytest.raises(SeriesError, match=said.replace("in u", f"in {which}")):
                engine.Series(y, **given)
        else:
            np.testing.assert_array_equal(engine.Series(y, **given).t, np.arange(4.0))
    np.testing.assert_array_equal(engine.Series(y, u.to_numpy()).t, np.arange(4.0))


def test_tables_for_pandas():
    pandas = pytest.importorskip("pandas")
    series = engine.Series(
        [1.0, np.nan], [[0.0], [1.0]], dt=0.5, y_names=["flow"], u_names=["pump"]
    )
    frame = series.to_frame()
    assert isinstance(frame, pandas.DataFrame)
    assert (list(frame.columns), list(frame.index), frame.index.name) == (
        ["flow", "pump"],
        [0.0, 0.5],
        "t",
    )
    again = engine.Series(frame[["flow"]], frame[["pump"]])
    np.testing.assert_array_equal(again.y, series.y)
    assert again.dt == 0.5
    trace = EM.to_frame()
    assert list(trace.columns) == ["q", "r", "level", "log_likelihood"]
    assert trace["q"].iloc[-1] == EM.theta["q"]
    assert np.isnan(trace["log_likelihood"].iloc[-1])
    fit = engine.fit_simulation(LEVEL, nile()).to_frame()
    assert fit.loc["r", "unit"] == "1e16 m^6"


def test_without_pandas_it_says_what_to_do(monkeypatch):
    monkeypatch.setattr("engine.views.import_module", _without_pandas)
    with pytest.raises(
        OptionError, match="needs pandas, which is not installed: pip install pandas"
    ):
        nile().to_frame()


def _without_pandas(name):
    if name == "pandas":
        raise ImportError(name)
    return builtins.__import__(name)


def test_the_package_says_that_it_is_typed():
    for package in ("engine", "service"):
        assert (Path(engine.__file__).parents[1] / package / "py.typed").is_file()
