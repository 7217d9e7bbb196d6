"""Tables of pandas are told about as files are: times that may be others, rows that were left out, dates."""

import warnings

import numpy as np
import pytest

import engine
from engine.data.counters import uneven, uneven_counter
from engine.errors import ReadingWarning, SeriesError

pd = pytest.importorskip("pandas")

BERLIN = pd.date_range("2024-03-30 23:00", periods=30, freq="10min", tz="Europe/Berlin")
SPRING = BERLIN.tz_localize(None)  # clocks are set forward at 2 o'clock


@pytest.fixture
def table():
    n = 30
    rng = np.random.default_rng(0)
    return pd.DataFrame({"y": rng.standard_normal(n), "u": rng.standard_normal(n)})


def read(table, **options):
    """The series of a table, and what was said of it."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        series = engine.Series.from_frame(table, ["y"], ["u"], **options)
    assert all(issubclass(one.category, ReadingWarning) for one in told)
    return series, " ".join(str(one.message) for one in told)


@pytest.mark.parametrize("name", ["t", "time [min]", "elapsed"])
def test_a_column_of_times_that_is_not_named_is_told(table, name):
    table[name] = 0.5 * np.arange(30)
    series, told = read(table)
    assert series.dt == 1.0
    assert f"no column of times: a step of 1 s is assumed; as '{name}'" in told
    assert read(table, t=name)[0].dt == 0.5
    assert not read(table, dt=0.5)[1]


def test_dates_in_a_column_that_is_not_named_are_told(table):
    table["when"] = pd.date_range("2024-03-01", periods=30, freq="min")
    assert "as 'when' holds dates" in read(table)[1]
    table["when"] = table["when"].astype(str)
    assert "as 'when' holds dates" in read(table)[1]


def test_without_a_hint_of_times_nothing_is_said(table):
    assert read(table)[1] == ""
    assert read(table.assign(note="a", flag=True, k=3))[1] == ""


@pytest.mark.parametrize("how", ["column", "index", "series"])
def test_a_unit_of_time_in_a_name_that_is_not_asked_for_is_told(table, how):
    table["time [min]"] = 0.5 * np.arange(30)
    if how == "column":
        series, told = read(table, t="time [min]")
    elif how == "index":
        series, told = read(table.set_index("time [min]"))
    else:
        with pytest.warns(ReadingWarning) as said:
            series = engine.Series(table["y"], table["u"], t=table["time [min]"])
        told = str(said[0].message)
    assert (series.time_unit, series.dt) == ("s", 0.5)
    assert "'time [min]' count min by its name, and are taken for s" in told
    assert "time_unit='min'" in told
    by_name = table.set_index("time [min]")
    assert read(by_name, time_unit="min")[1] == ""
    assert read(by_name, time_unit="minutes")[1] == ""


def test_what_times_were_converted_to_is_told(table):
    table["time [ms]"] = 20.0 * np.arange(30)
    series, told = read(table, t="time [ms]", units="names", time_unit="s")
    assert series.dt == pytest.approx(0.02)
    assert "times are converted from ms to s" in told
    told = read(table, t="time [ms]", units="names", time_unit="cycle")[1]
    assert "times count ms by the table, and are taken for cycle" in told
    assert read(table, t="time [ms]", units="names")[1] == ""


@pytest.mark.parametrize(
    ("times", "words"),
    [
        (45000 + np.arange(30) / 1440, "days of a spreadsheet"),
        (1.7e12 + 1000.0 * np.arange(30), "ms since 1970"),
        (np.array([1000 + k // 60 * 100 + k % 60 for k in range(0, 300, 10)]), "the time of day"),
        (SPRING, "summer time"),
    ],
)
def test_times_that_may_be_others_are_told(table, times, words):
    table["t"] = times
    assert words in read(table, t="t")[1]
    assert words in read(table, t="t", units="names")[1]
    if words not in ("the time of day", "ms since 1970"):
        assert words in read(table.set_index("t"))[1]


def test_an_index_of_dates_as_text_and_one_of_periods_have_times(table):
    table.index = [f"2024-03-01 00:{k:02d}:00" for k in range(30)]
    assert read(table)[1] == ""
    assert read(table)[0].dt == 60.0
    table.index = pd.period_range("2024-03-01", periods=30, freq="D")
    assert read(table, time_unit="day")[0].dt == 1.0
    assert engine.Series(table["y"], table["u"], time_unit="h").dt == 24.0
    table.index = [f"run {k}" for k in range(30)]
    assert read(table)[0].dt == 1.0


@pytest.mark.parametrize("dt", [None, 0.5])
def test_rows_that_were_left_out_or_moved_are_told_by_the_index(table, dt):
    words = "index goes from 2 to 5 at row 3"
    assert words in read(table.drop(index=[3, 4, 10]), dt=dt)[1]
    moved = table.sample(frac=1.0, random_state=1)
    assert "at row 1, and rows are taken as one step apart" in read(moved, dt=dt)[1]
    twice = pd.concat([table[:15], table[:15]])
    assert "index goes from 14 to 0 at row 15" in read(twice, dt=dt)[1]
    with pytest.warns(ReadingWarning, match=words):
        engine.Series(*(table.drop(index=[3, 4, 10])[name] for name in "yu"), dt=dt)
    # times of their own say it all
    table["t"] = 0.5 * np.arange(30)
    assert read(table.drop(index=[3, 4, 10]), t="t")[1] == ""


def test_an_index_that_was_thinned_needs_a_step(table):
    told = read(table[::3])[1]
    assert "index counts 0, 3, 6: no times, and a step of 1 s is assumed" in told
    assert read(table[::3], dt=1.5)[1] == ""
    assert read(table[10:])[1] == ""
    assert read(table.set_axis([7] * 30))[1] == ""  # a subject, say


def test_dates_are_no_readings(table):
    for values in (
        pd.date_range("2024-03-01", periods=30),
        pd.to_timedelta(np.arange(30), unit="s"),
    ):
        with pytest.raises(SeriesError, match="y holds dates or durations, no numbers"):
            engine.Series.from_frame(table.assign(y=values), ["y"], ["u"], dt=1.0)
        with pytest.raises(SeriesError, match="u holds dates or durations, no numbers"):
            engine.Series(table["y"], pd.DataFrame({"u": values}), dt=1.0)


def test_a_counter_beside_a_step_tells_rows_that_are_missing(table, tmp_path):
    table.insert(0, "sample", np.arange(30))
    missing = table.drop(index=[3, 4, 10])
    words = "'sample' goes up by 1, but from 2 to 5"
    path = tmp_path / "log.csv"
    missing.to_csv(path, index=False)
    with pytest.warns(ReadingWarning, match=words):
        engine.Series.read(path, dt=0.5)
    missing[["y", "u"]].to_csv(path)  # with an index that has no name
    with pytest.warns(ReadingWarning, match="'column 1' goes up by 1, but from 2 to 5 at line 5"):
        engine.Series.read(path, dt=0.5)
    assert words in read(missing.reset_index(drop=True), dt=0.5)[1]
    table.to_csv(path, index=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        engine.Series.read(path, dt=0.5)


def test_what_a_counter_is():
    n = np.arange(40.0)
    assert uneven_counter(n) is None
    assert uneven_counter(np.delete(n, [7, 20])) == 7
    assert uneven_counter(10 * np.delete(n, 7) + 1990) == 7
    assert uneven_counter(np.delete(n, 7) + 0.5) is None  # no whole numbers
    assert uneven_counter(np.tile(n[:10], 4)) is None  # as hours of a day: no rows are missing
    assert uneven_counter(np.cumsum(np.random.default_rng(1).poisson(2.0, 40))) is None
    assert uneven_counter(np.zeros(40)) is None
    assert uneven(np.array([3, 1, 2])) == 1
    assert uneven(np.array([1, 2, 4])) == 2
    assert uneven(np.array([1, 3, 5])) is None
