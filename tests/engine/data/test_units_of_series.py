"""Units of a series' times and channels: labels that are printed, kept and compared, and change no number."""

import re
from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.data import nile
from engine.data.files import write_series
from engine.errors import OptionError, ReadingWarning, SeriesError
from engine.statespace.clock import about_clock
from engine.units import alike, clock_of, differ, frequency_in, is_per, named_with_unit
from tests.engine.clear_step import clear_flows

pd = pytest.importorskip("pandas")


@pytest.mark.parametrize(
    ("column", "unit"),
    [
        ("time [min]", "min"), ("t_ms", "ms"), ("t (h)", "h"), ("Time_hours", "h"), ("year", "year"),
        ("Days", "day"), ("t_s", "s"), ("time [d]", "day"), ("t (hrs)", "h"), ("t", ""), ("time", ""),
        ("level", ""), ("tank", ""), ("y", ""), ("Zeit [ms]", "ms"), ("Timestamp (ms)", "ms"),
        ("elapsed_ms", "ms"), ("Zeit/h", "h"), ("uptime hours", "h"), ("Zeit [Tage]", ""), ("day_of_year", ""),
        ("items", ""), ("_s", ""),
    ],
)  # fmt: skip
def test_the_unit_that_a_column_of_times_tells(column, unit):
    assert clock_of(column) == unit


@pytest.mark.parametrize(
    "column", ["time [h]", "t (min)", "time_min", "Time days", "time [d]", "t/d", "t_ms", "T [s]"]
)
def test_a_column_of_times_is_found_with_its_unit(column, tmp_path):
    (tmp_path / "a.csv").write_text(f"{column},y\n0,1\n0.5,2\n1,3\n")
    series = engine.Series.read(tmp_path / "a.csv")
    assert series.dt == 0.5
    assert series.time_unit == clock_of(column) != ""


@pytest.mark.parametrize(
    "column", ["t_min", "t_h", "t_d", "time_of_flight", "T [K]", "year", "T", "Ts", "T_s", "T sec"]
)
def test_other_columns_are_none_of_times(column, tmp_path):
    (tmp_path / "a.csv").write_text(f"{column},y\n0,1\n0.5,2\n1,3\n")
    with pytest.warns(engine.ReadingWarning, match="counts up evenly"):  # but it is told
        assert engine.Series.read(tmp_path / "a.csv").dt == 1.0


def test_units_as_they_are_written():
    assert (frequency_in("s"), frequency_in("year")) == ("Hz", "1/year")
    assert named_with_unit("pressure [bar]") == ("pressure", "bar")
    assert named_with_unit("flow (m^3/(h bar))") == ("flow", "m^3/(h bar)")
    assert named_with_unit("y") == ("y", "")
    assert alike("N*s/m", "N s / m")
    assert not alike("bar", "Pa")
    assert [is_per(one, "s") for one in ("rad/s", "1/s^1.5", "Hz", "samples", "m")] == [
        True, True, True, False, False,
    ]  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("ending", ["csv", "npz", "mat"])
def test_the_unit_of_time_is_kept_in_files(tmp_path, ending):
    series = engine.Series([1.0, 2.0, np.nan], dt=0.5, time_unit="day")
    write_series(series, tmp_path / f"a.{ending}")
    read = engine.Series.read(tmp_path / f"a.{ending}")
    assert read.time_unit == "day"
    with pytest.warns(ReadingWarning, match="converted from day to h"):
        hours = engine.Series.read(tmp_path / f"a.{ending}", time_unit="h")
    assert (hours.time_unit, hours.t.tolist()) == ("h", [0.0, 12.0, 24.0])
    write_series(engine.Series([1.0, 2.0]), tmp_path / f"s.{ending}")
    assert engine.Series.read(tmp_path / f"s.{ending}").time_unit == "s"
    if ending == "csv":
        assert "unit" not in (tmp_path / "s.csv").read_text()


@pytest.mark.parametrize("column", ["t [ms]", "time_ms", "t,ms"])
def test_times_of_another_unit_than_asked_for_are_converted(tmp_path, column):
    """A label alone made a logger's milliseconds seconds, and every rate wrong by a thousand."""
    name, _, below = column.partition(",")
    unit = f"{below},V\n" if below else ""
    file = tmp_path / "a.csv"
    file.write_text(f"{name},y\n{unit}0,1\n20,2\n60,4\n")
    assert engine.Series.read(file).time_unit == "ms"
    with pytest.warns(ReadingWarning, match="times are converted from ms to s"):
        series = engine.Series.read(file, time_unit="s")
    assert (series.time_unit, series.t.tolist()) == ("s", [0.0, 0.02, 0.06])
    with pytest.warns(
        ReadingWarning, match="times count ms by the file, and are taken for fortnight"
    ):
        assert engine.Series.read(file, time_unit="fortnight").t.tolist() == [0.0, 20.0, 60.0]


def test_a_stored_step_of_another_unit_than_asked_for_is_converted(tmp_path):
    np.savez(tmp_path / "a.npz", y=[1.0, 2.0, 4.0], dt=30.0, time_unit="min")
    with pytest.warns(ReadingWarning, match="from min to h"):
        assert engine.Series.read(tmp_path / "a.npz", time_unit="h").dt == 0.5
    with pytest.warns(ReadingWarning, match="from min to s"):
        assert engine.Series.read(tmp_path / "a.npz", time_unit="s").dt == 1800.0


def test_the_nile_is_in_years():
    series = nile()
    assert series.time_unit == "year"
    assert "every 1 year, t = 1871 ... 1970 year" in str(series)
    assert series.part(3, 40).time_unit == series.refined(2).time_unit == "year"


def test_series_of_one_call_have_one_unit_of_time():
    model = engine.get_model("local-level")
    one, other = (engine.Series([1.0, 2.0, 3.0], time_unit=unit) for unit in ("s", "day"))
    with pytest.raises(SeriesError, match="in s, of another in day"):
        engine.rts_em(model, [one, other])
    with pytest.raises(OptionError, match="time_unit"):
        engine.Series([1.0, 2.0], time_unit=" ")


def test_a_unit_that_is_not_the_models_is_refused():
    model = engine.get_model("servo")
    y, u = np.zeros(5), np.ones(5)
    arguments = {"y_names": ["position"], "u_names": ["drive"]}
    engine.Series(y, u, **arguments, units={"position": "m"}).check(model)
    with pytest.raises(
        SeriesError, match=r"'position' is in mm; model 'servo' takes y channel 'y' in m"
    ):
        engine.Series(y, u, **arguments, units={"position": "mm"}).check(model)
    with pytest.raises(SeriesError, match="no channel 'pos'"):
        engine.Series(y, units={"pos": "m"})


# ---- pandas -------------------------------------------------------------------------------------


@pytest.fixture
def table():
    frame = pd.DataFrame(
        {"pressure [bar]": [1.0, np.nan, 3.0], "valve (%)": [0.0, 50.0, 100.0], "n": 1.0}
    )
    frame.index = pd.Index([0.0, 0.5, 1.5], name="time [min]")
    return frame


def test_units_behind_the_names_of_columns_where_asked(table):
    series = engine.Series.from_frame(table, ["pressure"], ["valve"], units="names", extra=["n"])
    assert (series.y_names, series.u_names, series.extra_names) == (
        ("pressure",),
        ("valve",),
        ("n",),
    )
    assert series.units == {"pressure": "bar", "valve": "%"}
    assert (series.time_unit, series.t.tolist()) == ("min", [0.0, 0.5, 1.5])
    assert "bar" in str(series)
    with pytest.warns(ReadingWarning, match="count min by its name, and are taken for s"):
        plain = engine.Series.from_frame(table, ["pressure [bar]"])
    assert (plain.y_names, plain.units, plain.time_unit) == (("pressure [bar]",), {}, "s")


def test_units_from_attrs_and_as_given(table):
    table = table.rename(columns={"pressure [bar]": "pressure"})
    table.attrs = {"units": {"pressure": "kPa"}, "time_unit": "h"}
    series = engine.Series.from_frame(table, ["pressure"], units="attrs")
    assert (series.units, series.time_unit) == ({"pressure": "kPa"}, "h")
    with pytest.warns(ReadingWarning, match="times are converted from h to day") as told:
        given = engine.Series.from_frame(
            table, ["pressure"], units={"pressure": "MPa"}, time_unit="day"
        )
    assert len(told) == 1
    assert (given.units, given.time_unit) == ({"pressure": "MPa"}, "day")
    assert given.t.tolist() == pytest.approx([0.0, 0.5 / 24.0, 1.5 / 24.0])  # attrs count hours
    with pytest.raises(SeriesError, match="units: there is no column 'p'"):
        engine.Series.from_frame(table, ["pressure"], units={"p": "MPa"})
    with pytest.raises(SeriesError, match="no column 'p'; there are pressure, "):
        engine.Series.from_frame(table, ["p"])
    with pytest.raises(OptionError, match="units = 'name'"):
        engine.Series.from_frame(table, ["pressure"], units="name")


def test_an_index_that_counts_rows_is_no_times_to_convert(table):
    table = table.reset_index(drop=True)
    table.attrs["time_unit"] = "ms"
    for dt in (0.5, None):
        series = engine.Series.from_frame(
            table, ["pressure"], ["valve"], units="names", time_unit="s", dt=dt
        )
        assert (series.dt, series.time_unit) == (dt or 1.0, "s")


def test_an_index_whose_name_has_a_unit_of_time_has_times(table):
    table.index = pd.Index([0, 10, 20], name="time [ms]")
    for unit, dt in ((None, 10.0), ("ms", 10.0)):
        series = engine.Series.from_frame(table, ["pressure"], units="names", time_unit=unit)
        assert (series.dt, series.time_unit) == (pytest.approx(dt), unit or "ms")
    with pytest.warns(ReadingWarning, match="times are converted from ms to s"):
        series = engine.Series.from_frame(table, ["pressure"], units="names", time_unit="s")
    assert (series.dt, series.time_unit) == (pytest.approx(0.01), "s")
    table.index = pd.Index(["Mon", "Tue", "Wed"], name="day")
    assert engine.Series.from_frame(table, ["pressure"], ["valve"], units="names").dt == 1.0


@pytest.mark.filterwarnings("ignore:times are converted")
def test_numbers_as_text_are_converted_and_dates_are_not(table):
    table["t [ms]"] = ["0", "10", "20"]
    table["when [ms]"] = [f"2026-01-01 00:00:0{k}" for k in range(3)]
    for column, dt in (("t [ms]", 0.01), ("when [ms]", 1.0)):
        series = engine.Series.from_frame(
            table, ["pressure"], t=column, units="names", time_unit="s"
        )
        assert series.dt == pytest.approx(dt)


def test_dates_are_seconds_whatever_the_index_is_called(table):
    table.index = pd.date_range("2026-01-01", periods=3, freq="min", name="time [min]")
    series = engine.Series.from_frame(table, ["pressure"], units="names")
    assert (series.time_unit, series.t.tolist()) == ("s", [0.0, 60.0, 120.0])
    table["when"] = table.index
    again = engine.Series.from_frame(
        table.reset_index(drop=True), ["pressure"], t="when", units="names"
    )
    assert (again.time_unit, again.t.tolist()) == ("s", [0.0, 60.0, 120.0])


def test_there_and_back(table):
    series = engine.Series.from_frame(table, ["pressure"], ["valve"], units="names")
    back = engine.Series.from_frame(series.to_frame(), ["pressure"], ["valve"], units="attrs")
    assert (back.units, back.time_unit) == (series.units, "min")
    np.testing.assert_array_equal(back.y, series.y)


# ---- what is printed, and that no number changes ----------------------------------------------


@pytest.fixture(scope="module")
def found():
    """The same diagnosis of the Nile with its times in years and in seconds."""
    model = engine.get_model("local-level")
    kinds = ["step", "ramp"]
    return {
        unit: engine.diagnose(model, clear_flows(400.0).replace(time_unit=unit), effects=kinds)
        for unit in ("year", "s")
    }


def numbers(value):
    """All numbers of a document in order, but for what took how long."""
    if isinstance(value, dict):
        return [x for key, one in value.items() if key != "seconds" for x in numbers(one)]
    if isinstance(value, list):
        return [x for one in value for x in numbers(one)]
    return [value] if isinstance(value, float) else []


@pytest.mark.long
def test_the_unit_of_time_changes_printed_units_and_no_number(found):
    by_year, by_second = (found[unit].to_dict() for unit in ("year", "s"))
    assert numbers(by_year) == numbers(by_second)
    assert by_year["time_unit"] == "year"
    assert by_year["extension"]["model"]["setting"]["time_unit"] == "year"


@pytest.mark.long
def test_a_diagnosis_in_years_speaks_of_years(found):
    text = str(found["year"])
    assert "time 1899 year" in text
    units = {one.effect: one.unit for one in found["year"].detectable}
    assert units["ramp:level"] == "1e8 m^3/year^2"
    assert {p.name: p.unit for p in found["year"].extended.parameters}["step_flow_time"] == "year"
    body = text.split("Notes")[0]
    assert not re.search(r"\d s\b|/s\b|Hz", body), body
    assert "time 1899 s" in str(found["s"])


def test_a_report_in_years_has_years_on_its_axes(found, tmp_path):
    html = found["year"].report(tmp_path / "a.html").read_text()
    assert "time [year]" in html
    assert "frequency [1/year]" in html
    assert "[s]" not in html
    assert "Hz" not in html
    figure = found["year"].plot()["gain"]
    assert "time [year]" in [panel.get_xlabel() for panel in figure.axes]


@pytest.mark.long
def test_a_saved_diagnosis_keeps_the_unit_of_time(found, tmp_path):
    loaded = engine.load(found["year"].save(tmp_path / "a.json"))
    assert loaded.series.time_unit == "year"


def test_an_estimate_in_years(tmp_path):
    fit = engine.rts_em(engine.get_model("local-level"), nile(), n_iterations=3)
    document = engine.examine(fit, nile(), n_particles=10).to_dict()
    assert document["time_unit"] == "year"
    html = engine.examine(fit, nile(), n_particles=10).report(tmp_path / "a.html").read_text()
    assert "time [year]" in html
    assert "[s]" not in html


def test_times_that_do_not_fit_the_models_units_are_noted():
    from engine.diagnose.symptoms.data_checks import check_data

    model = engine.get_model("oscillator")
    rng = np.random.default_rng(0)
    series = engine.simulate(model, None, 200, rng, u=np.sin(np.arange(200) / 9), dt=0.05).series
    (note,) = (
        n for n in check_data(model, series.replace(time_unit="min")) if "Times are in min" in n
    )
    assert "omega in rad/s" in note or "1/s" in note
    assert not any("Times are" in one for one in check_data(model, series))
    assert not any("Times are" in n for n in check_data(engine.get_model("local-level"), nile()))


@pytest.mark.parametrize(
    ("one", "other", "apart"),
    [
        ("m", "mm", True), ("kW", "W", True), ("degC", "F", True), ("C", "degC", False), ("°C", "degC", False),
        ("N m", "Nm", False), ("J", "Nm", False), ("km/h", "m/s", True), ("1/s", "Hz", False),
        ("rpm", "rad/s", True), ("V", "A", True), ("L/min", "m^3/s", True), ("bar", "1e5 Pa", False),
        ("counts", "ticks", True), ("counts", "V", False), ("measured", "N", False), ("%", "1", True),
        ("mm/s2", "m/s^2", True), ("mm/s²", "mm/s^2", False), ("m³/h", "m^3/s", True), ("m3", "1e8 m^3", True),
        ("m3", "m³", False), ("cm²", "m^2", True), ("m s-1", "m/s", False), ("m·s⁻²", "m/s^2", False),
        ("\u03bcm", "\u00b5m", False), ("\u03bcm", "m", True), ("°", "deg", False), ("°", "rad", True),
        ("Ω", "Ohm", False), ("k\u2126", "Ohm", True), ("kohm", "kOhm", False), ("inch", "in", False),
        ("in", "m", True), ("ft", "m", True), ("psi", "Pa", True), ("kWh", "J", True),
        ("kWh", "3.6e6 J", False),
        ("U/min", "rpm", False), ("U/min", "rad/s", True), ("U/min", "m", True), ("t", "kg", True),
        ("Nmm", "Nm", True), ("‰", "%", True), ("atm", "bar", True), ("torr", "Pa", True), ("mAh", "Ah", True),
        ("H2O", "m", False), ("counts2", "counts^2", True),
        ("deg", "rad", True), ("rpm", "1/min", False), ("deg C", "degC", False), ("g", "m/s^2", True),
    ],
)  # fmt: skip
def test_units_that_are_surely_not_the_same(one, other, apart):
    assert differ(one, other) is differ(other, one) is apart


def furnace():
    return engine.MixedModel(
        name="furnace",
        dynamics=lambda a, u, t, dt, th: (
            [0.9 * a[:, 0] + th.g * u[0]],
            np.zeros((1, 0)),
            [[1e-4]],
        ),
        measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[0.04]]),
        initial=lambda th: (engine.Gaussian([20.0], [[4.0]]), [], np.zeros((0, 0))),
        nonlinear={"inside": "degC"},
        inputs={"heat": "kW"},
        outputs={"room": "degC"},
        parameters=[engine.Parameter("g", 1.0, "degC/kW", (0.0, 50.0))],
    )


@pytest.mark.parametrize(
    ("head", "wrong"),
    [
        ("time [min],heat [kW],room [degC]", None),
        ("t,heat (measured),room (upper)", None),  # no units
        ("t,u[0],y[0]", None),
        ("t,motor (A),room (V)", None),
        ("t,heat [W],room [degC]", "channel 'heat' is in W; model 'furnace' takes u channel 'heat' in kW"),
        ("t,heat [kW],room [F]", "channel 'room' is in F; model 'furnace' takes y channel 'room' in degC"),
    ],
)  # fmt: skip
def test_units_in_the_head_of_a_file_are_those_of_the_model(head, wrong, tmp_path):
    (tmp_path / "a.csv").write_text(f"{head}\n" + "".join(f"{k},1,20\n" for k in range(9)))
    columns = head.split(",")
    named = engine.Series.read(tmp_path / "a.csv", y={"room": columns[2]}, u={"heat": columns[1]})
    plain = engine.Series.read(tmp_path / "a.csv", y=[columns[2]], u=[columns[1]])
    for series in (named, plain):
        if wrong is None:
            assert series.check(furnace()) is series
        else:
            with pytest.raises(
                SeriesError, match=wrong.partition(";")[2].strip().replace("(", ".")
            ):
                series.check(furnace())


@pytest.mark.parametrize(
    ("columns", "wrong"),
    [
        ("y_mm,drive_V", "'y' is in mm; model 'servo' takes y channel 'y' in m"),
        ("y/mm,drive", "'y' is in mm"), ("y in mm,drive", "'y' is in mm"), ("Y_V,drive", None),
        ("y mm,drive", "'y' is in mm"), ("y,u_drive_mV", "'drive' is in mV"), ("y,drive_h", None),
        ("y_m,drive/V", None), ("y_cam,drive_in", None), ("y_t,drive_raw", None), ("y (in),drive", None),
        ("y (mm),drive", "'y' is in mm"),
    ],
)  # fmt: skip
def test_a_unit_behind_a_name_counts_as_in_brackets(columns, wrong, tmp_path):
    """Once ``y_mm`` was read as metres: the unit was dropped to find the column, and forgotten.

    One of another kind may be a part of the name: ``T_h`` of the hot one.
    """
    (tmp_path / "a.csv").write_text(f"t,{columns}\n0,1,2\n1,2,3\n2,3,2\n")
    y, u = columns.split(",")
    model = engine.get_model("servo")
    series = engine.Series.read(tmp_path / "a.csv", y={"y": y}, u={"drive": u})
    if wrong is None:
        series.check(model)
        return
    with pytest.raises(SeriesError, match=wrong):
        series.check(model)


def test_a_unit_behind_a_name_counts_in_the_names_of_a_series():
    model = engine.get_model("servo")
    for names, wrong in ((["y_mm"], True), (["y_m"], False), (["position_mm"], False)):
        series = engine.Series(np.zeros(5), np.ones(5), y_names=names, u_names=["drive"])
        if wrong:
            with pytest.raises(SeriesError, match="channel 'y_mm' is in mm"):
                series.check(model)
        else:
            series.check(model)


def test_channels_called_like_others_of_the_model_are_refused():
    y = np.ones((9, 2))
    model = engine.get_model("servo")
    (own,), (drive,) = model.outputs, model.inputs
    engine.Series(y[:, 0], y[:, 1], dt=1.0, y_names=["angle"], u_names=["voltage"]).check(model)
    with pytest.raises(SeriesError, match=f"'{drive}' would be used as '{own}'"):
        engine.Series(y[:, 0], y[:, 1], dt=1.0, y_names=[drive], u_names=[own]).check(model)
    two = furnace()
    two = engine.MixedModel(
        name="two", dynamics=two.dynamics, initial=two.initial, nonlinear=two.nonlinear, inputs=two.inputs,
        measurement=lambda a, u, t, th: ([a[:, 0], a[:, 0]], np.zeros((2, 0)), 0.04 * np.eye(2)),
        outputs={"room": "degC", "y1": "degC"}, parameters=two.parameters,
    )  # fmt: skip
    engine.Series(y, y[:, 0], dt=1.0).check(two)  # nobody called them y1 and y2
    engine.Series(y, y[:, 0], dt=1.0, y_names=["room", "y1"]).check(two)
    with pytest.raises(SeriesError, match="takes room, y1, in this order, and 'y1' would be used"):
        engine.Series(y, y[:, 0], dt=1.0, y_names=["y1", "room"]).check(two)
    for names in (["room_measured", "y1.a"], ["Room", "Y1"], ["a room beside y1", "b"]):
        engine.Series(y, y[:, 0], dt=1.0, y_names=names).check(two)
    for names in (["y1_measured", "a"], ["a", "Room [degC]"]):
        with pytest.raises(SeriesError, match="would be used as"):
            engine.Series(y, y[:, 0], dt=1.0, y_names=names).check(two)


@pytest.mark.parametrize(
    ("unit", "clock", "told"),
    [
        ("1/min", "s", "g in 1/min"), ("degC/(kW min)", "s", "times in min"), ("1/min", "min", ""),
        ("1/d", "s", "times in d"), ("1/d", "day", ""), ("1/day", "d", ""),
        ("A h", "s", ""), ("1/s", "s", ""), ("1/s", "min", "times in s"), ("1/h", "year", "times in h"),
        ("1/h", "day", "times in h"),
    ],
)  # fmt: skip
def test_a_model_that_counts_time_in_another_unit(unit, clock, told):
    model = replace(furnace(), parameters=[engine.Parameter("g", 1.0, unit)])
    series = engine.Series(np.arange(9.0), np.ones(9), dt=1.0, time_unit=clock)
    said = about_clock(model, [series])
    assert told in said
    assert bool(told) == bool(said)
    fits = (
        engine.fit_simulation(model, series, n_starts=0),
        engine.rbps_em(model, series, n_iterations=1),
    )
    for fitted in fits:
        assert said in fitted.message
        assert ("Times are in" in fitted.message) == bool(said)


@pytest.mark.parametrize(
    ("units", "told"), [(["1/d"], False), (["1"], True), (["1/d", "1/s"], True)]
)
def test_rates_in_the_records_unit_of_time_are_enough(units, told):
    """A flow may well be counted per second by equations whose rates are per day, if all of them are."""
    parameters = [engine.Parameter(f"g{i}", 1.0, unit) for i, unit in enumerate(units)]
    model = replace(furnace(), parameters=parameters)
    model = replace(model, outputs=dict.fromkeys(model.outputs, "m^3/s"))
    for day in ("d", "day"):
        series = engine.Series(np.arange(9.0), np.ones(9), dt=1.0, time_unit=day)
        assert bool(about_clock(model, [series])) == told


@pytest.mark.parametrize(
    ("unit", "told"), [("W s/m^3/K", False), ("W s^2/m^3/K", True), ("N/s", True)]
)
def test_a_coefficient_of_an_input_per_second_may_have_its_seconds(unit, told):
    """A heat loss that grows with a wind in m/s is in W s/m^3/K, whatever the equations' rates count."""
    parameters = [engine.Parameter("g", 1.0, "1/min"), engine.Parameter("loss", 1.0, unit)]
    model = replace(furnace(), parameters=parameters)
    model = replace(model, inputs=dict.fromkeys(model.inputs, "m/s"))
    series = engine.Series(np.arange(9.0), np.ones(9), dt=1.0, time_unit="min")
    assert bool(about_clock(model, [series])) == told
