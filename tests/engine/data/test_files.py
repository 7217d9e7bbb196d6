"""Reading and writing series: what is read, and every error with its message."""

from __future__ import annotations

import io
import pickle
import struct
import time
import warnings
import zipfile
from contextlib import suppress
from csv import field_size_limit
from datetime import datetime

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from engine.data import nile
from engine.data.array_files import read_mat
from engine.data.files import read_series, read_table, series_from, write_series
from engine.data.series import Series
from engine.errors import ReadingWarning, SeriesError


def read_series_bytes(data, filename, **columns):
    """What an upload makes of a file."""
    return series_from(read_table(data, filename), **columns)


def npz(**arrays):
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def mat(**arrays):
    out = io.BytesIO()
    savemat(out, arrays)
    return out.getvalue()


def test_default_channels_are_columns_named_y_and_u():
    text = b"t_s,u_V,Y2,year,y_m\n0,1,2,1900,3\n0.5,4,5,1901,6\n"
    series = read_series_bytes(text, "a.csv")
    assert series.y_names == ("Y2", "y_m")
    assert series.u_names == ("u_V",)
    np.testing.assert_array_equal(series.y, [[2, 3], [5, 6]])
    np.testing.assert_array_equal(series.u, [[1], [4]])
    assert series.dt == 0.5


def test_a_column_is_found_without_the_unit_in_its_name():
    text = b"clock [min],indoor [degC],heat (kW)\n0,20,1\n1,21,2\n"
    series = read_series_bytes(text, "a.csv", y=["indoor"], u=["heat"], t="clock")
    assert (series.y_names, series.u_names) == (("indoor",), ("heat",))
    np.testing.assert_array_equal(series.y, [[20], [21]])
    np.testing.assert_array_equal(series.u, [[1], [2]])
    assert series.units == {"indoor": "degC", "heat": "kW"}
    np.testing.assert_array_equal(series.t, [0, 1])
    assert (
        series.time_unit
        == read_series_bytes(text, "a.csv", y=["indoor"], t="clock [min]").time_unit
    )
    mapped = read_series_bytes(text, "a.csv", y={"y1": "indoor"}, t="clock")
    assert mapped.y_names == ("y1",)
    full = read_series_bytes(text, "a.csv", y=["indoor [degC]"], t="clock")
    assert full.y_names == ("indoor [degC]",)


def test_a_name_that_several_columns_have_but_for_the_unit_is_refused():
    text = b"t,p [bar],p [Pa]\n0,1,2\n1,3,4\n"
    for asked in (
        {"y": ["p"]},
        {"y": {"y": "p"}},
        {"y": ["p [bar]"], "u": ["p"]},
        {"y": [], "t": "p"},
    ):
        with pytest.raises(SeriesError, match=r"may be any of p \[bar\] or p \[Pa\]"):
            read_series_bytes(text, "a.csv", **asked)
    exact = read_series_bytes(b"t,p,p [Pa]\n0,1,2\n1,3,4\n", "a.csv", y=["p"])
    np.testing.assert_array_equal(exact.y, [[1], [3]])


def test_channels_by_list_and_by_mapping():
    text = b"time,pump,level,other\n10,1,2,3\n12,4,5,6\n"
    listed = read_series_bytes(text, "a.csv", y=["other", "level"], u=["pump"], t="time")
    np.testing.assert_array_equal(listed.y, [[3, 2], [6, 5]])
    assert listed.y_names == ("other", "level")
    np.testing.assert_array_equal(listed.t, [10, 12])
    mapped = read_series_bytes(text, "a.csv", y={"y1": "level"}, u={"drive": "pump"}, dt=2.0)
    assert mapped.y_names == ("y1",)
    assert mapped.u_names == ("drive",)
    assert mapped.dt == 2.0


@pytest.mark.parametrize("cell", ["", " ", "NaN", "nan", "null", "NA", "None", "-"])
def test_missing_cells(cell):
    series = read_series_bytes(f"y1,y2,u\n1,2,3\n{cell},5,6\n".encode(), "a.csv")
    assert np.isnan(series.y[1, 0])
    assert series.y[1, 1] == 5


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_decimal_commas_are_read_where_they_part_no_cells(delimiter):
    rows = [["t", "u [V]", "y"], ["0", "1,250", "-0,5"], ["1", "-2,5e-3", ""], ["2", "3", ",75"]]
    text = "\n".join(delimiter.join(row) for row in rows)
    series = read_series_bytes(text.encode(), "a.csv")
    np.testing.assert_array_equal(series.u[:, 0], [1.25, -2.5e-3, 3.0])
    np.testing.assert_array_equal(series.y[:, 0], [-0.5, np.nan, 0.75])


def test_empty_line_in_one_column_is_missing():
    series = read_series_bytes(b"y\n1\n\n3\n", "a.csv")
    np.testing.assert_array_equal(series.y[:, 0], [1, np.nan, 3])


def test_semicolons_tabs_comments_quotes_and_byte_order_mark():
    for text in (b"\xef\xbb\xbfu;y\r\n1;2\r\n3;4\r\n", b"# made by hand\nu\ty\n1\t2\n3\t4\n"):
        series = read_series_bytes(text, "a.csv")
        np.testing.assert_array_equal(series.y[:, 0], [2, 4])
    quoted = read_series_bytes(b'"u [V]","y [mm]"\n"1","2"\n"3","4"\n', "a.csv")
    assert quoted.y_names == ("y [mm]",)


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        (b"u,y\n1,2\n3,x4\n", {}, r"a.csv, line 3, column 'y': 'x4' is not a number$"),
        (b"u;y\n1.5;2\n3;4,5\n", {}, r"line 3, column 'y': '4,5' is not a number; .*decimal comma"),
        (b"u;y\n1;1,250\n3;2,500\n", {}, r"line 2, column 'y': '1,250' is not a number; .*decimal"),
        (b"u;y\n1;0,5\n3;1,2,5\n", {}, r"line 3, column 'y': '1,2,5' is not a number$"),
        (b"u,y\n1,5,2,5\n", {}, r"line 2: 4 cells for 2 columns \(u, y\); are these decimal comm"),
        (b"u,y\n1,2\n3\n", {}, r"line 3: 1 cells for 2 columns \(u, y\)$"),
        (b"1,2\n3,4\n", {}, r"line 1: the first line holds numbers; it must name the columns"),
        (b"u,,y\n1,2,3\n", {}, r"line 1: column 2 has no name"),
        (b"y,y\n1,2\n", {}, r"line 1: two columns are named 'y'"),
        (b"", {}, r"a.csv is empty"),
        (b"u,y\n", {}, r"a.csv has a header and no rows"),
        (b"u,y\n1,2\n3,\x81\n", {}, r"line 3: not UTF-8 text"),
        (b"u,y\n1,2\n3,\xff\x01\n", {}, r"line 3: not UTF-8 text"),
        (b"u,y\n1,2\n3,\xff\n", {}, r"line 3, column 'y': '\u00ff' is not a number"),
        (b"u,y\n\0", {}, r"not a text file"),
        (b"a,b\n1,2\n", {}, r"no column is named y.*There are 'a', 'b'"),
        (b"u,y\n1,2\n", {"y": ["z"]}, r"no column 'z' \(asked for as y\); there are 'u', 'y'"),
        (b"u,y\n1,2\n", {"u": {"v": "q"}}, r"no column 'q' \(asked for as u\); there are 'u'"),
        (b"u,y\n1,2\n", {"t": "time"}, r"no column 'time' \(asked for as t\)"),
        (b"u,y\n1,2\n,4\n", {}, r"a.csv: u is not finite at line 3, channel 'u'"),
        (b"u,y\n1,inf\n2,4\n", {}, r"a.csv: y is infinite at line 2, channel 'y'"),
        (b"u,y\n1,2\n", {}, r"a.csv: y has 1 samples; at least 2"),
        (b"t,y\n0,1\n0,2\n", {}, r"a.csv: t repeats at line 3 \(0\); .*one time give the mean"),
        (b"t,y\n2350,1\n0,2\n", {}, r"t decreases at line 3 \(0\); .*if this is the time of day"),
        (b"t,y\n0,1\n-1,2\n", {}, r"a.csv: t decreases at line 3"),
        (b"t,y\n0,1\n,2\n", {}, r"a.csv: t is not finite at line 3"),
        (b"u,y\n1,2\n3,4\n", {"dt": -1.0}, r"a.csv: dt = -1.0; a positive time step"),
    ],
)
def test_csv_errors(text, options, message):
    with pytest.raises(SeriesError, match=message):
        read_series_bytes(text, "a.csv", **options)


def test_missing_file_and_unknown_ending(tmp_path):
    with pytest.raises(SeriesError, match=r"nothing\.csv cannot be read: No such file"):
        read_series(tmp_path / "nothing.csv")
    with pytest.raises(SeriesError, match=r"a\.xls: the ending must be \.csv, \.mat or \.npz"):
        read_series_bytes(b"", "a.xls")
    with pytest.raises(SeriesError, match=r"the ending must be"):
        write_series(Series([1.0, 2.0]), tmp_path / "a.xls")


@pytest.mark.long
def test_arrays_of_npz_and_mat():
    y, u = np.arange(6.0).reshape(3, 2), np.arange(3.0)
    for data, name in ((npz(y=y, u=u, dt=0.1), "a.npz"), (mat(y=y, u=u, dt=0.1), "a.mat")):
        series = read_series_bytes(data, name)
        np.testing.assert_array_equal(series.y, y)
        np.testing.assert_array_equal(series.u[:, 0], u)
        assert series.y_names == ("y1", "y2")
        assert series.dt == pytest.approx(0.1)
        second = read_series_bytes(data, name, y=["y2"], dt=2.0)
        np.testing.assert_array_equal(second.y[:, 0], y[:, 1])
        assert second.dt == 2.0
        with pytest.raises(SeriesError, match=r"'y' has 2 columns .y1, y2.; name one of them"):
            read_series_bytes(data, name, y={"level": "y"})


@pytest.mark.long
def test_arrays_of_other_names_and_of_unequal_length():
    data = mat(qm=np.arange(3.0)[:, None], vir=np.arange(3.0)[:, None], note="text")
    series = read_series_bytes(data, "a.mat", y=["qm"], u={"drive": "vir"}, dt=1e-3)
    assert series.u_names == ("drive",)
    with pytest.raises(SeriesError, match=r"no column is named y.*'qm', 'vir' .not usable: 'note'"):
        read_series_bytes(data, "a.mat")
    with pytest.raises(SeriesError, match="differ in length: 'y1' 3, 'y2' 4"):
        read_series_bytes(npz(y1=np.zeros(3), y2=np.zeros(4)), "a.npz")
    with pytest.raises(SeriesError, match="u has 4 rows and y has 3"):
        read_series_bytes(npz(y=np.zeros(3), u=np.zeros(4)), "a.npz")


def test_object_arrays_are_never_unpickled():
    class Bomb:
        def __reduce__(self):
            return (pytest.fail, ("unpickled",))

    out = io.BytesIO()
    np.savez(out, y=np.array([Bomb(), None], dtype=object), v=np.zeros(2))
    with pytest.raises(SeriesError, match="not usable: 'y' is not a table of real numbers"):
        read_series_bytes(out.getvalue(), "a.npz")
    with pytest.raises(SeriesError, match=r"a\.npz is not a readable \.npz archive"):
        read_series_bytes(pickle.dumps([1.0, 2.0]), "a.npz")


def test_broken_and_too_new_matlab_files():
    with pytest.raises(SeriesError, match=r"MATLAB 7\.3 file; save it with -v7"):
        read_series_bytes(b"MATLAB 7.3 MAT-file, Platform: x".ljust(512) + b"\x89HDF\r\n", "a.mat")
    with pytest.raises(SeriesError, match=r"a\.mat is not a readable MATLAB file"):
        read_series_bytes(b"not a matlab file at all, but long enough to be tried" * 9, "a.mat")


@pytest.mark.long
@pytest.mark.parametrize("ending", ["csv", "mat", "npz"])
def test_what_is_written_is_read_back(tmp_path, ending):
    rng = np.random.default_rng(0)
    y = rng.standard_normal((50, 2))
    y[3, 1] = y[7, 0] = np.nan
    t = np.cumsum(rng.uniform(0.1, 1.0, 50))
    series = Series(y, rng.standard_normal(50), t=t, y_names=["y_a", "y_b"], u_names=["u_V"])
    path = tmp_path / f"series.{ending}"
    write_series(series, path)
    back = Series.read(path)
    np.testing.assert_array_equal(back.y, series.y)
    np.testing.assert_array_equal(back.u, series.u)
    np.testing.assert_array_equal(back.t, series.t)
    assert back.y_names == series.y_names
    assert back.u_names == series.u_names


def test_written_csv_gives_unrecognised_names_a_prefix(tmp_path):
    write_series(Series([1.0, 2.0], y_names=["flow"]), tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text().startswith("t,y_flow\n")
    assert read_series(tmp_path / "a.csv").y_names == ("y_flow",)


@pytest.mark.long
def test_hundred_thousand_rows_take_about_as_long_as_numpy_does(tmp_path):
    """In time of the processor, of which others who use it take none."""
    path = tmp_path / "long.csv"
    rng = np.random.default_rng(0)
    y = rng.standard_normal(100_000)
    y[::10] = np.nan
    write_series(Series(y, rng.standard_normal(100_000)), path)
    began = time.process_time()
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    numpy_took, began = time.process_time() - began, time.process_time()
    back = read_series(path)
    took = time.process_time() - began
    np.testing.assert_array_equal(np.column_stack((back.t, back.y, back.u)), table)
    assert int((~back.observed).sum()) == 10_000
    assert took < 20.0 * numpy_took  # twice as long where nothing else runs


def test_nile():
    series = nile()
    assert len(series) == 100
    assert series.t[0] == 1871
    assert series.y[0, 0] == 1120
    assert series.y.mean() == pytest.approx(919.35)
    assert series.dt == 1.0


def claiming(shape):
    """An .npz whose array has eight bytes and claims to have more."""
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}"
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        text = header.ljust(117) + "\n"
        archive.writestr(
            "y.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", 118) + text.encode() + bytes(8)
        )
    return out.getvalue()


@pytest.mark.parametrize("limit", [131_072, 1 << 30])  # of the process, which others may change
@pytest.mark.parametrize(
    ("data", "name", "words"),
    [
        (b"y\n" + b"1" * 200_000, "a.csv", "a.csv, line 2: a cell has more than 131072"),
        (b'y,u\n"' + b"1,1\n" * 50_000, "a.csv", "a.csv, line .*: a cell has more than 131072"),
        (b"y" * 200_000 + b"\n1\n", "a.csv", "a.csv, line 1: a cell has more"),
        (claiming("(1000000000000,)"), "a.npz", "claims 8000000000000 bytes and has fewer"),
        (claiming("(2,)"), "a.npz", "claims 16 bytes"),
        (b"y\n1_000\n2\n", "a.csv", "line 2, column 'y': '1_000' is not a number"),
        (b"y\nx\n1_000\n", "a.csv", "line 2, column 'y': 'x' is not a number"),
        (b"1_0,u\n1,2\n3,4\n", "a.csv", "no column is named y"),  # a name, and no number
    ],
)
def test_cells_and_arrays_that_are_not_what_they_seem(data, name, words, limit):
    usual = field_size_limit(limit)
    try:
        with pytest.raises(SeriesError, match=words):
            read_series_bytes(data, name)
    finally:
        field_size_limit(usual)


@pytest.mark.parametrize("end", ["", "\n", "\n\n\n", "\n \n\r\n"])
def test_empty_lines_at_the_end_are_no_samples(end):
    assert read_series_bytes(f"y\n1\n\n3{end}".encode(), "a.csv").y.tolist()[::2] == [[1.0], [3.0]]
    assert len(read_series_bytes(f"y\n1\n\n3{end}".encode(), "a.csv")) == 3
    assert len(read_series_bytes(f"y,u\n1,2\n3,4{end}".encode(), "a.csv")) == 2


FILES = {
    "a.csv": b'# made\nt;y;u\n0;1;"2"\n1;;3\n2;3;4\n',
    "a.npz": npz(y=np.arange(12.0).reshape(6, 2), t=np.arange(6)),
    "a.mat": mat(y=np.arange(6.0)[:, None], dt=0.5),
}


@pytest.mark.parametrize(
    ("at", "value"), [(145, 8), (156, 1), (176, 20), (177, 11), (280, 0)], ids=str
)
def test_wrong_types_within_a_matlab_file_are_an_error(at, value):
    """SciPy trusts them: such a byte once ended the process."""
    broken = bytearray(FILES["a.mat"])
    broken[at] = value
    with pytest.raises(SeriesError, match=r"a\.mat is not a readable MATLAB file"):
        read_series_bytes(bytes(broken), "a.mat")


def test_of_a_matlab_file_other_things_than_tables_are_left_out():
    cell, nested = np.empty(1, dtype=object), np.empty(1, dtype=object)
    cell[0], nested[0] = "level", cell
    things = {"s": {"a": 1.0}, "n": nested, "c": np.array([1j]), "text": "x", "w": np.eye(2)}
    table = read_mat(mat(y=np.arange(3.0)[:, None], y_names=cell, **things), "a.mat")
    assert list(table.columns) == ["level", "w1", "w2"]
    assert {text.split("'")[1] for text in table.ignored} == {"s", "n", "c", "text"}


def read_damaged(name, data):
    """A file with some bytes changed, cut off or repeated: a series or a SeriesError, nothing else."""
    whole = bytearray(FILES[name])
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(whole) - 1))
        whole[at] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(1, len(whole)))
    piece = bytes(whole[:cut]) if data.draw(st.booleans()) else bytes(whole) + bytes(whole[cut:])
    with suppress(SeriesError), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read_series_bytes(piece, name)


@given(st.sampled_from(["a.csv", "a.npz"]), st.data())
@settings(max_examples=200, deadline=None)
def test_whatever_the_bytes_they_are_a_series_or_a_series_error(name, data):
    read_damaged(name, data)


@pytest.mark.slow
@given(st.data())
@settings(max_examples=12, deadline=None)
def test_whatever_the_bytes_of_a_matlab_file(data):
    read_damaged("a.mat", data)


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("import os; os.abort()", "a.mat is not a readable MATLAB file: its reader crashed on it"),
        ("import sys; sys.exit('odd')", "a.mat is not a readable MATLAB file: odd"),
        ("x = bytearray(1 << 40)", "a.mat is not a readable MATLAB file: MemoryError"),
    ],
)
def test_a_file_that_crashes_scipy_s_reader_crashes_nobody_else(
    program, words, tmp_path, monkeypatch
):
    """Damaged bytes made it read memory that is not its own, in what was then the service itself."""
    crashing = tmp_path / "crashing.py"
    crashing.write_text(program)
    monkeypatch.setattr("engine.data.array_files.MAT_TO_NPZ", crashing)
    with pytest.raises(SeriesError, match=words):
        read_series_bytes(FILES["a.mat"], "a.mat")


@pytest.mark.long
def test_a_step_beside_a_column_of_times_must_be_their_step():
    """Once it was taken and the times were not: a frequency twice as large, "converged"."""
    regular, gaps = b"t,y\n0,1\n0.02,2\n0.04,3\n", b"t,y\n0,1\n0.02,2\n0.06,3\n"
    assert read_series_bytes(regular, "a.csv", dt=0.02).dt == 0.02
    for data in (regular, gaps):
        with pytest.raises(SeriesError, match=r"a\.csv: t and dt are both given and differ"):
            read_series_bytes(data, "a.csv", dt=0.05)
    t = np.array([0.0, 0.02, 0.06])
    for data, name in ((npz(y=t, t=t, Ts=0.02), "a.npz"), (mat(y=t, t=t, Ts=0.02), "a.mat")):
        with pytest.raises(SeriesError, match="give one of them"):
            read_series_bytes(data, name)
        np.testing.assert_array_equal(read_series_bytes(data, name, t="t").t, t)


@pytest.mark.parametrize(
    ("stamps", "step"),
    [
        (["2024-03-30 22:00", "2024-03-30 23:00", "2024-03-31 00:00"], 3600.0),
        (["2024-03-30", "2024-03-31", "2024-04-01"], 86400.0),
        (["2024-01-01T00:00:00.000Z", "2024-01-01T00:00:00.500Z", "2024-01-01T00:00:01Z"], 0.5),
        (["2024-03-31T01:00+01:00", "2024-03-31T03:00+02:00", "2024-03-31T04:00+02:00"], 3600.0),
        (["31-Mar-2024 23:59:59.5", "01-Apr-2024 00:00:00", "01-Apr-2024 00:00:00.5"], 0.5),
        (["31 March 2024 01:00", "31 March 2024 02:00", "31 March 2024 03:00"], 3600.0),
        (["2024-03-31 01:00:00 UTC", "2024-03-31 02:00:00 UTC", "2024-03-31 03:00:00 UTC"], 3600.0),
        (["2024-03-31 01:00 +0100", "2024-03-31 03:00 +0200", "2024-03-31 04:00 +0200"], 3600.0),
        (["2024-03-01Z", "2024-03-02 UTC", "2024-03-03 +0000"], 86400.0),
    ],
)
def test_a_logger_writes_dates(tmp_path, stamps, step):
    path = tmp_path / "logged.csv"
    path.write_text("t,y\n" + "".join(f"{one},{k}\n" for k, one in enumerate(stamps)))
    series = read_series(path)
    np.testing.assert_allclose(series.t, step * np.arange(3), rtol=1e-12)
    hours = read_series(path, time_unit="h")
    np.testing.assert_allclose(hours.t, step / 3600.0 * np.arange(3), rtol=1e-12)


def test_of_several_columns_of_times_it_is_said_which_is_taken(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time [h],Time,t,T,y\n0,0,0,20,1\n1,3,2,21,2\n")
    told = r"a\.csv: times are those of column 't', not of 'time \[h\]' and 'Time'"
    with pytest.warns(ReadingWarning, match=told):
        series = read_series(path)
    assert (series.dt, series.time_unit) == (2.0, "s")
    assert read_series(path, t="Time").dt == 3.0
    assert read_series(path, y=["y"], u=["t", "Time"]).time_unit == "h"


def test_a_date_that_is_none_is_named_with_its_line(tmp_path):
    path = tmp_path / "logged.csv"
    path.write_text("t,y\n2024-03-30 22:00,1\n30/03/2024 23:00,2\n")
    with pytest.raises(
        SeriesError, match=r"line 3, column 't': '30/03/2024 23:00' is not a date such"
    ):
        read_series(path)
    path.write_text("t,y\n28/02/2024 22:00,1\n29/02/2024 22:00,1\n30/02/2024 22:00,1\n")
    with pytest.raises(
        SeriesError, match=r"line 4, column 't': '30/02/2024 22:00' is not a date such"
    ):
        read_series(path)


@pytest.mark.parametrize(
    ("head", "rows", "names", "y"),
    [
        ('"t";"flow, m3/s"', ["0;1100,5", "1;1107,5"], ["t", "flow, m3/s"], [1100.5, 1107.5]),
        ("t;flow, m3/s", ["0;1100,5", "1;1107,5"], ["t", "flow, m3/s"], [1100.5, 1107.5]),
        ("t\ta, b, c, d", ["0\t1,5", "1\t2,5"], ["t", "a, b, c, d"], [1.5, 2.5]),
        ('t,"a;b;c;d"', ["0,1.5", "1,2.5"], ["t", "a;b;c;d"], [1.5, 2.5]),
        ("t;a, b", ["0;1,5", "", "1;2"], ["t", "a, b"], [1.5, 2.0]),
        ('t,"a, b"', ['0,"1.5"', "1,2"], ["t", "a, b"], [1.5, 2.0]),
        ("sep=;\nt;a,b;c", ["0;1,5;3,25", "1;2,5;4"], ["t", "a,b", "c"], [1.5, 2.5]),
        ('"sep=,"\nt,a', ["0,1.5", "1,2.5"], ["t", "a"], [1.5, 2.5]),
        ("t;a;", ["0;1,5;", "1;2;"], ["t", "a"], [1.5, 2.0]),
        ("t,a,", ["0,1.5,", "1,2,"], ["t", "a"], [1.5, 2.0]),
        ("t;a;b;c", ["s;mm;;-", "0;1,5;1;2", "1;2;1;2"], ["t [s]", "a [mm]", "b", "c"], [1.5, 2.0]),
        ("t,a [m]", ["[min],(m)", "0,1.5", "1,2"], ["t [min]", "a [m]"], [1.5, 2.0]),
        ("t,a", ["NA,-", "0,1.5", "1,2"], ["t", "a"], [np.nan, 1.5, 2.0]),  # is a row
    ],
)  # fmt: skip
def test_what_parts_cells_is_told_by_all_rows(head, rows, names, y):
    """Once the decimals behind a comma became the measurement, as a name had a comma too."""
    table = read_table("\n".join([head, *rows]).encode(), "a.csv")
    assert list(table.columns) == names
    np.testing.assert_array_equal(table.column(names[1]), y)


def test_a_line_of_units_is_that_of_the_columns():
    series = read_series_bytes(b"# log\nt;flow\nmin;L/s\n0;1,5\n2;2,5\n", "a.csv", y=["flow"])
    assert (series.time_unit, series.units, series.dt) == ("min", {"flow": "L/s"}, 2.0)
    with pytest.raises(
        SeriesError, match=r"line 5, column 'flow \[L/s\]': 'x' is not a number; write a number, or"
    ):
        read_series_bytes(b"# log\nt;flow\nmin;L/s\n0;1,5\n2;x\n", "a.csv", y=["flow"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"t;y\ns;furlongs\n0;1\n", r"line 2, column 't': 's' is not a number; if this line holds units"),
        (b"t;y\n0;furlongs\n0;1\n", r"line 2, column 'y': 'furlongs' is not a number$"),
        (b"t;y\n0;1;\n1;2;\n", r"line 2: 3 cells for 2 columns \(t, y\); the line ends with a separator"),
        (b"t;y;\n0;1;\n1;2;5\n", r"line 1: column 3 has no name"),
        (b"t;y;\n0;1\n1;2\n", r"line 2: 2 cells for 3 columns"),
        (b"sep=|\nt|y\n0|1\n", r"line 1: separated by '\|'; a comma, semicolon or tab is needed"),
        (b"sep=;\n", r"a\.csv is empty"),
        (b"t;y\ns;m\n", r"has a header and no rows of numbers"),
    ],
)  # fmt: skip
def test_heads_that_are_odd(text, message):
    with pytest.raises(SeriesError, match=message):
        read_series_bytes(text, "a.csv")


@pytest.mark.parametrize(
    ("stamps", "message"),
    [
        (["2024-03-01T00:00+01:00", "2024-03-01T00:01+01:00", "2024-03-01 00:02"],
         r"^a\.csv, line 5, column 't': '2024-03-01 00:02' has no time zone, and those before have one: "),
        (["2024-03-01 00:00", "2024-03-01 00:01Z", "2024-03-01 00:02"],
         r"^a\.csv, line 4, column 't': '2024-03-01 00:01Z' has a time zone, and those before have none: "),
        (["2024-10-27 02:30", "2024-10-27 02:45", "2024-10-27 02:00", "2024-10-27 02:15"],
         r"^a\.csv: t decreases at line 5 \(2024-10-27 02:00:00\); time must increase; if the clock was"),
        (["2024-10-27 01:00", "2024-10-27 02:00", "2024-10-27 02:00", "2024-10-27 03:00"],
         r"t repeats at line 5 \(2024-10-27 02:00:00\); .* winter time here, write the time stamps"),
        (["2024-10-27 02:30", "2024-10-27 02:31", "2024-10-27 02:30", "2024-10-27 02:31"],
         r"t decreases at line 5 \(2024-10-27 02:30:00\); time must increase; if several records.*by itself$"),
        (["2024-10-26 02:30:00", "2024-10-26 02:30:00", "2024-10-26 02:30:01", "2024-10-26 02:30:01"],
         r"t repeats at line 4 \(2024-10-26 02:30:00\); .* if its stamps are rounded, .*step, dt$"),
    ],
)  # fmt: skip
def test_dates_whose_zone_or_summer_time_is_not_told(stamps, message):
    """Once those without a zone were taken for UTC: a jump of an hour."""
    text = "# by hand\nt,y\n" + "".join(f"{one},{k}\n" for k, one in enumerate(stamps))
    with pytest.raises(SeriesError, match=message):
        read_series_bytes(text.encode(), "a.csv")


def test_zones_that_come_and_go_are_refused_in_the_library_too():
    mixed = ["2024-03-01T00:00+01:00", "2024-03-01 00:01"]
    with pytest.raises(SeriesError, match="t: 2024-03-01 00:01:00 at row 1 has no time zone"):
        Series([1.0, 2.0], t=mixed)
    with pytest.raises(SeriesError, match="at row 1 has no time zone"):
        Series([1.0, 2.0], t=[datetime.fromisoformat(one) for one in mixed])


def test_errors_name_the_file_once():
    with pytest.raises(SeriesError, match=r"^a\.csv, line 3, column 'y': '1;5' is not a number"):
        read_series_bytes(b"t,y\n0,1\n1,1;5\n", "a.csv")
    with pytest.raises(
        SeriesError, match=r"a\.csv: t and dt .*: from line 3 to line 4 t goes on by"
    ):
        read_series_bytes(b"t,y\n0,1\n1,2\n3,2\n", "a.csv", dt=1.0)


def of(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    return tmp_path / "a.csv"


def test_the_only_column_of_dates_has_the_times(tmp_path):
    rows = "".join(f"2024-05-01 00:00:{k}0,{k % 2}\n" for k in range(5))
    path = of(tmp_path, f"Zeitstempel,y\n{rows}")
    assert read_series(path).t.tolist() == [0.0, 10.0, 20.0, 30.0, 40.0]
    assert read_series(path, dt=0.5).dt == 0.5  # who gives a step wants no other
    same = "".join(f"2024-05-01,{k % 2}\n" for k in range(5))  # that of a delivery, say
    with pytest.warns(ReadingWarning, match="as 'made' holds dates, give t='made', or dt"):
        assert read_series(of(tmp_path, f"made,y\n{same}")).dt == 1.0
    two = "".join(f"2024-05-01 00:00:{k}0,2024-05-01 00:00:{k}1,0\n" for k in range(5))
    with pytest.warns(ReadingWarning, match="a step of 1 s is assumed; as 'from' holds dates"):
        read_series(of(tmp_path, f"from,to,y\n{two}"))


def test_a_row_of_words_that_end_in_a_unit_of_time_is_no_line_of_units(tmp_path):
    """It was taken for one, and the row passed over."""
    for words in ("-,-,valve_s", "-,pump h,valve_s"):
        with pytest.raises(SeriesError, match="is not a number"):
            read_series(of(tmp_path, f"t,y,u\n{words}\n1,2,3\n2,3,4\n"))
    spelled = read_series(of(tmp_path, "t,y\nhours,m\n1,2\n2,3\n"), y=["y"])
    assert (spelled.time_unit, spelled.units) == ("h", {"y": "m"})


def test_times_over_their_unit(tmp_path):
    for name in ("time/ms", "t/ms", "Time / ms"):
        series = read_series(of(tmp_path, f"{name},y\n0,1\n20,2\n40,1\n"))
        assert (series.dt, series.time_unit) == (20.0, "ms")


def test_a_step_that_is_assumed_beside_what_looks_like_times_is_told(tmp_path):
    with pytest.warns(
        ReadingWarning, match="a step of 1 s is assumed; as 'hours' counts up evenly"
    ):
        read_series(of(tmp_path, "hours,y\n0,1\n2,2\n4,1\n"))
    assert read_series(of(tmp_path, "hours,y\n0,1\n2,2\n4,1\n"), dt=2.0).dt == 2.0
    assert read_series(of(tmp_path, "u,y\n0,1\n1,2\n2,1\n")).dt == 1.0  # plain, and silent


@pytest.mark.parametrize("cell", ["{}. März 2024", "0 days 00:00:0{}", "0{}:30.5"])
def test_a_step_that_is_assumed_beside_dates_that_are_not_read_is_told(tmp_path, cell):
    rows = "".join(f"{cell.format(k)},{k % 2}\n" for k in range(1, 5))
    with pytest.warns(ReadingWarning, match="a step of 1 s is assumed; as 'Zeit' may hold dates"):
        read_series(of(tmp_path, f"Zeit,y\n{rows}"))
    rows = "".join(f"V{k % 2}.A{k % 2},{k % 2}\n" for k in range(1, 5))  # names of something
    assert read_series(of(tmp_path, f"sensor,y\n{rows}")).dt == 1.0
    rows = "".join(f"{k % 3 + k / 10}e-01,{k % 2}\n" for k in range(1, 5))  # numbers
    assert read_series(of(tmp_path, f"p,y\n{rows}")).dt == 1.0


@pytest.mark.parametrize(("parts", "unit"), [(10**3, "ms"), (10**6, "us"), (10**9, "ns")])
def test_parts_of_seconds_since_1970(tmp_path, parts, unit):
    """The clock of a computer: 20 ms were taken for 20 s, or for more."""
    rows = "".join(f"{1_700_000_000 * parts + k * parts // 50},{k % 3}\n" for k in range(5))
    with pytest.warns(ReadingWarning, match=rf"look like {unit} since 1970.*'time \[{unit}\]'"):
        read_series(of(tmp_path, f"time,y\n{rows}"))
    with pytest.warns(ReadingWarning, match=f"converted from {unit} to s"):
        series = read_series(of(tmp_path, f"time [{unit}],y\n{rows}"), time_unit="s")
    assert series.usual_step == pytest.approx(0.02, abs=1e-6)
    seconds = "".join(f"{1_700_000_000 + k},{k % 3}\n" for k in range(5))
    assert read_series(of(tmp_path, f"time,y\n{seconds}")).dt == 1.0


@pytest.mark.parametrize("seconds", ["", "00"])
def test_dates_in_digits_with_their_time_of_day(tmp_path, seconds):
    rows = "".join(f"2024030107{k}{seconds},{k % 3}\n" for k in range(50, 55))
    with pytest.warns(
        ReadingWarning, match="look like dates, as 202403011430 for 2024-03-01 14:30"
    ):
        read_series(of(tmp_path, f"time,y\n{rows}"))


@pytest.mark.parametrize("row", [10.0, 9.0, 0.0])
def test_a_column_of_times_that_falls_once_is_told(tmp_path, row):
    """A logger that wrote a row twice, or began anew: all rows were taken for 1 s apart, without a word."""
    elapsed = [*np.arange(11.0), *(row + np.arange(12.0))]
    rows = "".join(f"{0.5 * t},{k % 3}\n" for k, t in enumerate(elapsed))
    with pytest.warns(ReadingWarning, match="as 'elapsed' rises like times at most rows"):
        read_series(of(tmp_path, f"elapsed,y\n{rows}"))


def test_dates_that_leave_out_an_hour(tmp_path):
    """Where summer time begins; other gaps, other days and times with a zone are none of it."""
    before = [f"2024-03-31 01:{k}:00" for k in range(50, 60)]
    after = [f"2024-03-31 03:0{k}:00" for k in range(5)]

    def read(stamps):
        return read_series(of(tmp_path, "time,y\n" + "".join(f"{one},1\n" for one in stamps)))

    told = r"a gap of 3660 s ends at line 12 \(2024-03-31 03:00:00\).*write the time stamps with their zone"
    with pytest.warns(ReadingWarning, match=told):
        read([*before, *after])
    read([*before[:-2], *after])
    read([one.replace("03-31", "04-03") for one in [*before, *after]])
    zoned = [*(f"{one}+01:00" for one in before), *(f"{one}+02:00" for one in after)]
    assert read(zoned).dt == 60.0


def test_days_of_a_spreadsheet(tmp_path):
    def read(times, name="time"):
        return read_series(of(tmp_path, f"{name},y\n" + "".join(f"{t!r},1\n" for t in times)))

    for step in (10, 600, 3600):
        days = [round(45382.0 + k * step / 86400.0, 7) for k in range(50)]
        with pytest.warns(ReadingWarning, match=f"days of a spreadsheet, one row every {step} s"):
            read(days)
    assert read(days, "time [day]").time_unit == "day"
    for dt in (1e-4, 1e-3, 0.01, 0.02, 1.0 / 60.0, 1.0 / 1024.0, 1.0 / 12800.0, 1.0, 10.0):
        read([45382.0 + k * dt for k in range(50)])  # seconds of a day


def _of_the_day(minutes, day=24 * 60):
    return [k // 60 * 100 + k % 60 for k in minutes if k < day]


@pytest.mark.parametrize(
    ("times", "words"),
    [
        (_of_the_day(range(840, 1200, 10)), "the time of day"),
        ([*_of_the_day(range(480, 620, 4)), *_of_the_day(range(760, 960, 4))], "the time of day"),
        ([int(f"{k // 3600}{k // 60 % 60:02}{k % 60:02}") for k in range(30000, 31000, 20)], "the time of day"),
        ([year * 100 + month for year in (2001, 2002, 2003) for month in range(1, 13)], "months"),
        ([20010125, 20010201, 20010208, 20010215, 20010222, 20010301], "dates"),
        ([20010101, 20010220, 20010301, 20010430], "dates"),
    ],
)  # fmt: skip
def test_a_clock_in_the_digits_of_a_number(tmp_path, times, words):
    """Read as plain numbers, with jumps of 41 from 1459 to 1500 or of 8870 from one year to the next."""
    path = of(tmp_path, "time,y\n" + "".join(f"{t},1\n" for t in times))
    with pytest.warns(ReadingWarning, match=f"look like {words}, as .* count as plain numbers"):
        read_series(path, time_unit="min")


@pytest.mark.parametrize(
    "times",
    [
        range(0, 3000, 10),
        range(0, 2400, 100),
        range(1821, 1935),
        [0, 5, 10, 20, 30, 45, 100, 115, 130, 200, 230, 300],
        [0, 10, 20, 30, 50, 100, 200, 300, 500, 1000],
        range(20000000, 20001000, 10),
    ],
)
def test_numbers_that_count(tmp_path, times):
    """Rounded or even, and none of a clock: nothing is said."""
    read_series(of(tmp_path, "time,y\n" + "".join(f"{t},1\n" for t in times)))


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        (["2024-01-01", "2024-01-02", "2024-01-01"], "one below the other, give each by itself"),
        (["2024-01-03", "2024-01-02", "2024-01-01"], "measured first: turn their order around"),
        ([3, 2, 1], "measured first: turn their order around"),
        ([3, 4, 3], "one below the other, give each by itself"),
    ],
)
def test_times_that_fall_back(tmp_path, stamps, words):
    with pytest.raises(SeriesError, match=words):
        read_series(of(tmp_path, "time,y\n" + "".join(f"{one},1\n" for one in stamps)))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Operator\tMeyer\n\nt\tu\ty\n0\t1\t2\n1\t1\t2\n", "if line 3 has the names, delete the lines above"),
        ("LabVIEW\t\nSeparator\tTab\nt\ty\n0\t1\n1\t2\n", "no name; if line 3 has the names"),
        ("t,y\n0,1\nt,y\n1,2\n", "line 3, column 't': 't' is not .*repeats the names of the columns, delete"),
        ("time,y\n2024-01-01,1\ntime,y\n", "line 3, .*if this line repeats the names of the columns"),
        ("Date,Time,y\n2024-01-01,00:00:10,1\n2024-01-01,00:00:20,1\n", "with their date, both in one column"),
        ("t,y\n01/03/2024 12:00,1\n02/03/2024 12:00,1\n", "day or its month first.*: write dates as"),
        ("t,y\n1. März 2024,1\n2. März 2024,1\n", "'1. März 2024' is not a number; dates of .* are read as"),
    ],
)  # fmt: skip
def test_what_to_do_about_a_file(tmp_path, text, words):
    with pytest.raises(SeriesError, match=words):
        read_series(of(tmp_path, text))


def test_dates_without_the_time_of_day_beside_them(tmp_path):
    path = of(tmp_path, "day,clock,y\n2024-01-01,00:10,1\n2024-01-01,00:20,1\n")
    with pytest.raises(
        SeriesError, match="if another column has the time of day, write both in one"
    ):
        read_series(path, t="day")


def test_names_of_rows_have_no_name_of_their_own(tmp_path):
    """R's write.csv and to_csv of pandas put them first, numbers that count or dates."""
    by_r = of(tmp_path, '"","t","y"\n"1",0,5\n"2",2,6\n')
    series = read_series(by_r)
    assert (series.dt, series.y_names) == (2.0, ("y",))
    assert read_series(by_r, t="column 1").dt == 1.0
    by_pandas = of(tmp_path, ",co2\n1958-03-29,316.1\n1958-04-05,\n1958-04-12,317.6\n")
    assert read_series(by_pandas, y=["co2"], time_unit="d").dt == 7.0
    logger = of(tmp_path, ",Station 12\nt,y\n0,1\n1,2\n")
    with pytest.raises(SeriesError, match="column 1 has no name; if line 2 has the names"):
        read_series(logger)


def test_a_logger_that_writes_as_old_windows_does_is_read(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes("t;Temperatur [°C];Öffnung [µm]\n0;1,5;2\n1;2,5;3\n".encode("cp1252"))
    with pytest.warns(ReadingWarning, match="a.csv: not UTF-8 text, but read as such of Windows"):
        series = read_series(path, y=["Temperatur"], u=["Öffnung"])
    assert series.units == {"Temperatur": "°C", "Öffnung": "µm"}
    assert series.y.ravel().tolist() == [1.5, 2.5]


def test_empty_columns_at_the_end_and_utf_16(tmp_path):
    assert read_series(of(tmp_path, "t,y,,\n0,1,,\n2,2,,\n")).dt == 2.0
    with pytest.raises(SeriesError, match="line 1: column 4 has no name"):
        read_series(of(tmp_path, "t,y,,\n0,1,,\n2,2,,7\n"))
    for encoding in ("utf-16", "utf-16-be"):
        text = "\ufeff" * (encoding != "utf-16") + "t\ty\n0\t1,5\n2\t2,5\n"
        (tmp_path / "b.txt").write_bytes(text.encode(encoding))
        assert read_series(tmp_path / "b.txt").y[:, 0].tolist() == [1.5, 2.5]
    (tmp_path / "b.txt").write_bytes("t\ty\n".encode("utf-16") + b"x")
    with pytest.raises(SeriesError, match="not UTF-16 text"):
        read_series(tmp_path / "b.txt")


def test_a_date_in_another_order_is_named_where_a_step_is_assumed(tmp_path):
    path = of(tmp_path, "Stamp;y\n31-03-2024 12:00;1\n31-03-2024 12:01;2\n")
    with pytest.warns(ReadingWarning, match="as 'Stamp' holds dates"):
        read_series(path)


@pytest.mark.parametrize(
    ("stamps", "t"),
    [
        (("31/03/2024 23:59", "1/4/2024 0:00:30"), [0.0, 90.0]),  # no month is the 31st
        (("3/31/2024 11:59 PM", "4/1/2024 12:00:30 AM"), [0.0, 90.0]),
        (("03/04/2024 12:00", "03/04/2024 12:01:00,5"), [0.0, 60.5]),  # the same either way
        (("2024/03/04 7:00", "2024/03/05 7:00"), [0.0, 86400.0]),
        (("11/02/2024 12:59:59 AM", "11/02/2024 1:00:00 am"), [0.0, 1.0]),
    ],
)
def test_dates_with_slashes_whose_order_the_column_tells(tmp_path, stamps, t):
    text = "stamp;y\n" + "".join(f"{stamp};{k}\n" for k, stamp in enumerate(stamps))
    assert read_series(of(tmp_path, text)).t.tolist() == t
    assert Series([0.0, 1.0], t=list(stamps)).t.tolist() == t


@pytest.mark.parametrize(
    ("stamps", "order"),
    [
        (
            ("11/02/2024", "12/02/2024", "01/03/2024"),
            "day/month/year",
        ),  # time goes back in the other
        (("3/4/2024 23:00", "3/4/2024 23:30", "3/5/2024 0:00"), "month/day/year"),  # even steps
    ],
)
def test_an_order_that_only_the_steps_tell_is_said(tmp_path, stamps, order):
    text = "stamp,y\n" + "".join(f"{stamp},{k}\n" for k, stamp in enumerate(stamps))
    with pytest.warns(ReadingWarning, match=f"'stamp' are read as {order}"):
        assert read_series(of(tmp_path, text)).t[1] < 90000.0


def test_what_says_that_there_is_no_reading(tmp_path):
    marks = [
        "---",
        "-",
        "?",
        ".",
        "#DIV/0!",
        "#N/A",
        "#NV",
        "#BEZUG!",
        "#N/D",
        "#¡VALOR!",
        "#DĚLENÍ_NULOU!",
        "1.#QNAN",
        "-nan(ind)",
        "n.a.",
        "NaT",
        "missing",
        "NULL",
        "",
    ]
    text = "t,y\n" + "".join(f"{k},{mark}\n" for k, mark in enumerate(["1.5", *marks, "2.5"]))
    y = read_series(of(tmp_path, text)).y[:, 0]
    assert (y[0], y[-1], np.isnan(y[1:-1]).all()) == (1.5, 2.5, True)


def test_a_date_with_dots_has_its_day_first(tmp_path):
    """As loggers in much of Europe write them: once a step of 1 was assumed instead."""
    text = "Zeitstempel;y [m]\r\n29.02.2024 23:59:30;1,5\r\n1.3.2024 0:00:00;2,5\r\n"
    series = read_series(of(tmp_path, text))
    assert (series.dt, series.t.tolist()) == (30.0, [0.0, 30.0])
    assert read_series(of(tmp_path, "t,y\n01.03.2024,1\n02.03.2024,2\n")).dt == 86400.0
    with pytest.raises(SeriesError, match=r"'30\.02\.2024' is not a number; dates"):
        read_series(of(tmp_path, "t,y\n30.02.2024,1\n01.03.2024,2\n"))


def test_hours_that_go_on_after_a_day(tmp_path):
    """As simulators of networks and stop watches print them."""
    text = "{},level\n23:30:00,1\n24:00:00,2\n24:30:00,1\n"
    assert read_series(of(tmp_path, text.format("time")), y=["level"]).dt == 1800.0
    minutes = read_series(of(tmp_path, text.format("time [min]")), y=["level"])
    assert (minutes.dt, minutes.time_unit) == (30.0, "min")
    called = of(tmp_path, text.format("Hours"))
    with pytest.warns(ReadingWarning, match="'Hours' holds hours and minutes, give t='Hours'"):
        read_series(called, y=["level"])  # a step of a second was assumed without a word
    assert read_series(called, y=["level"], t="Hours", time_unit="h").dt == 0.5
    midnight = of(tmp_path, "time,y\n23:59:50,1\n0:00:00,2\n")
    with pytest.raises(SeriesError, match=r"line 3, column 'time': '0:00:00' is earlier.*midnight"):
        read_series(midnight)
    with pytest.raises(SeriesError, match=r"'0:30' is not a number; times of day .*with seconds"):
        read_series(of(tmp_path, "time,y\n0:30,1\n1:00,2\n"))  # or minutes and seconds


def test_columns_between_blanks(tmp_path):
    """Simulators print tables so; names of one column may have blanks in them."""
    text = " time            v(out)  \n 0.00000e+00 -9.34e-09 \n 5.00000e-05 -1.54e-02 \n"
    series = read_series(of(tmp_path, text), y=["v(out)"])
    assert (series.dt, series.y[1, 0]) == (5e-5, -1.54e-2)
    one = read_series(of(tmp_path, "my flow\n1\n2\n"), y=["my flow"])
    assert one.y.shape == (2, 1)


def test_the_index_of_a_table_may_hold_the_times(tmp_path):
    path = of(tmp_path, ",y\n0,1\n3600,2\n7200,2\n")
    with pytest.warns(ReadingWarning, match="as 'column 1' counts up evenly, give t='column 1'"):
        assert read_series(path, y=["y"]).dt == 1.0
    assert read_series(path, y=["y"], t="column 1").dt == 3600.0


@pytest.mark.parametrize("ending", [".dat", ".tsv", ".txt", ".out", ".PRN"])
@pytest.mark.parametrize("delimiter", [" ", "\t", ",", ";"])
def test_names_in_a_comment(tmp_path, ending, delimiter):
    """As ``numpy.savetxt`` writes a header."""
    path, rows = tmp_path / f"run{ending}", np.arange(12.0).reshape(4, 3)
    np.savetxt(path, rows, delimiter=delimiter, header=delimiter.join(("t", "u", "y")))
    if delimiter == " ":  # words of a comment might be anything
        with pytest.warns(ReadingWarning, match="named as the comment above them says: t u y"):
            series = read_series(path)
    else:
        series = read_series(path)
    np.testing.assert_array_equal(np.column_stack([series.t, series.u, series.y]), rows)


def test_names_in_a_comment_above_dates_and_above_other_comments(tmp_path):
    """As stations' records have them: names first, then who measured it, then rows that begin with a date."""
    rows = b"2014-01-01 00:00:00,0.25\n2014-01-01 01:00:00,0.5\n"
    series = read_series_bytes(b"# time,flow\n" + rows, "a.csv", y=["flow"])
    assert series.t.tolist() == [0.0, 3600.0]
    assert series.y[:, 0].tolist() == [0.25, 0.5]
    far = b"# time,flow\n#\n# by the chair of hydrology\n" + rows
    (tmp_path / "a.csv").write_bytes(far)
    with pytest.warns(ReadingWarning, match="named as the comment above them says: time,flow"):
        again = read_series(tmp_path / "a.csv", y=["flow"])
    np.testing.assert_array_equal(again.y, series.y)


def test_comments_between_the_names_and_the_rows():
    rows = b"1.1.1979,0.25\n2.1.1979,#N/A\n3.1.1979,0.75\n"
    for below in (b"#\n# a station at a brook\n#, two, commas\n", b"#,mm/d\n", b"# d,mm/d\n\n"):
        series = read_series_bytes(b"date,rain\n" + below + rows, "a.csv", y=["rain"])
        np.testing.assert_array_equal(series.y[:, 0], [0.25, np.nan, 0.75])
    missing = read_series_bytes(b"y,t\n#N/A,0\n1,1\n", "a.csv")  # a cell, and no comment
    np.testing.assert_array_equal(missing.y[:, 0], [np.nan, 1])
    np.testing.assert_array_equal(read_series_bytes(b"y\n#N/A\n1\n", "a.csv").y[:, 0], [np.nan, 1])


def test_days_and_months_in_each_others_place_are_told():
    """As a spreadsheet leaves them that takes 12.1. for the first of December, and 13.1. for no date at all."""
    rows = "".join(f"2014-{d:02d}-01 {h:02d}:00:00,1\n" for d in (11, 12) for h in (0, 12))
    rows += "2014-01-13 00:00:00,1\n2014-01-13 12:00:00,1\n"
    with pytest.raises(
        SeriesError, match=r"line 6 .*; it follows on 2014-01-12, which the row before"
    ):
        read_series_bytes(b"time,y\n" + rows.encode(), "a.csv")
    plain = b"time,y\n2014-12-01 12:00:00,1\n2014-12-02 00:00:00,1\n2014-01-17 00:00:00,1\n"
    with pytest.raises(SeriesError, match=r"time must increase; if several records.*by itself$"):
        read_series_bytes(plain, "a.csv")


def test_columns_that_the_model_does_not_use(tmp_path):
    (tmp_path / "a.csv").write_text("t,flow,rain,wind [m/s]\n0,1,2,3\n2,4,,6\n")
    series = Series.read(tmp_path / "a.csv", y=["flow"], extra=["wind"])
    assert (series.u_names, series.extra_names) == ((), ("wind",))
    np.testing.assert_array_equal(series.extra[:, 0], [3, 6])
    assert any(line.split()[:2] == ["extra", "wind"] for line in str(series).splitlines())
    with pytest.raises(SeriesError, match="no column 'snow' \\(asked for as extra\\)"):
        read_series(tmp_path / "a.csv", y=["flow"], extra=["snow"])
    with pytest.raises(SeriesError, match="extra"):
        read_series(tmp_path / "a.csv", y=["flow"], extra=["rain"])  # a gap in an input


def test_several_records_in_one_file_are_told():
    with pytest.raises(
        SeriesError, match=r"t decreases .*one below the other, give each by itself"
    ):
        read_series_bytes(b"ID,t,y\n1,0,1\n1,1.5,2\n2,0,1\n2,2,3\n", "a.csv")


def test_comments_that_name_no_columns():
    for comment in (b"# hold: foh", b"# three words here and more", b"# 1 2 3", b"# t u u", b"#"):
        with pytest.raises(SeriesError, match="the first line holds numbers"):
            read_series_bytes(comment + b"\n0 1 2\n3 4 5\n", "a.txt")
