"""Columns become channels alike on the command line, in an upload and on the page."""

import io
import json

import numpy as np
import pytest

from engine import get_model
from engine.data.array_files import read_npz
from engine.data.csv_files import read_csv
from service.cli.files import Columns, series_of
from service.cli.references import model_of
from service.columns import match

CASES = {  # columns, outputs, inputs, what is found
    "names": ("a,b", "a", "b", {"a": "a", "b": "b"}),
    "case": ("Level,LEVEL2", "level", "", {"level": "Level"}),
    "both cases": ("Level,level", "level", "", {"level": "level"}),
    "as written": ("t,y_level,u_pump", "level", "pump", {"level": "y_level", "pump": "u_pump"}),
    "unit": ("voltage_V,current [A]", "voltage", "current", {"voltage": "voltage_V", "current": "current [A]"}),
    "no unit": ("voltages,other", "voltage", "", {}),
    "two units": ("flow_in,flow_out", "flow", "", {}),
    "called y and u": ("t,y1,y2,u", "a b", "c", {"a": "y1", "b": "y2", "c": "u"}),
    "too many called y": ("y1,y2", "a", "", {}),
    "only one left": ("year,flow", "level", "", {"level": "flow"}),
    "two left": ("year,flow,rain", "level", "", {}),
    "none left": ("year,t", "level", "", {}),
    "only for outputs": ("year,flow,level", "level", "pump", {"level": "level"}),
    "two open": ("year,flow", "level rate", "", {}),
    "an exact name first": ("flow_in,flow", "flow", "", {"flow": "flow"}),
    "time is time": ("time,level_V", "level", "", {"level": "level_V"}),
    "time with its unit": ("time [h],level_V", "level", "", {"level": "level_V"}),
    "time, its unit by a line": ("time_min,t_ms,T [days],level", "level", "", {"level": "level"}),
    "time over its unit": ("time/ms,level", "level", "", {"level": "level"}),
    "a temperature": ("t,T,y", "T", "y", {"T": "T", "y": "y"}),
    "a temperature that is no channel": ("T,t,y_V,T_s,Ts", "y", "", {"y": "y_V"}),
    "no temperature": ("t,P", "T", "P", {"P": "P"}),
    "a channel called as times are": ("t,time,y", "y", "time", {"y": "y", "time": "time"}),
    "a least temperature": ("t_min,t_h", "t_min t_h", "", {"t_min": "t_min", "t_h": "t_h"}),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_match(name):
    columns, outputs, inputs, expected = CASES[name]
    table = read_csv(text(columns).encode(), "a.csv")
    assert match(table, outputs.split(), inputs.split(), {}) == expected


def text(columns):
    """A file of these columns; year and t count, the others measure something."""
    names = columns.split(",")
    rows = [[i if one in ("year", "t") else (7 * i) % 5 for one in names] for i in range(4)]
    return "\n".join([columns, *(",".join(map(str, row)) for row in rows)])


def test_arrays_of_a_file_are_channels_in_their_order():
    stream = io.BytesIO()
    np.savez(stream, y=np.ones((3, 2)), u=np.ones((3, 2)), y_names=["p", "q"])
    table = read_npz(stream.getvalue(), "a.npz")
    found = match(table, ["a", "b"], ["c", "d"], {})
    assert found == {"a": "p", "b": "q", "c": "u1", "d": "u2"}


def test_what_is_given_is_used_and_not_given_twice():
    table = read_csv(text("a,b,c").encode(), "x.csv")
    assert match(table, ["a", "b"], [], {"a": "b"}) == {"a": "b"}
    assert match(table, ["a"], [], {}, other=["a"]) == {}


def test_the_service_takes_its_own_example(client, ended):
    """As in the README: flows of the Nile beside their years."""
    example = client.get("/examples/nile.csv").content
    assert example.startswith(b"year,flow")
    for name in ("flows.csv", "nile.csv"):
        request = {"kind": "estimate", "model": "local-level", "options": {"iterations": 2}}
        answer = client.post(
            "/jobs/upload", data={"request": json.dumps(request)}, files={"file": (name, example)}
        )
        assert answer.status_code == 201, answer.text
        body = client.get(f"{answer.headers['location']}/request").json()
        assert body["series"][0]["y"][:3] == [[1120.0], [1160.0], [963.0]]
        client.post(f"{answer.headers['location']}/stop")


def test_units_behind_names_are_compared_with_those_of_the_model(client):
    files = {"file": ("a.csv", b"time [year],flow [m^3]\n1871,1120\n1872,1160\n1873,963\n")}
    request = {"kind": "smooth", "model": "local-level"}
    answer = client.post("/jobs/upload", data={"request": json.dumps(request)}, files=files)
    assert answer.status_code == 422
    (error,) = answer.json()["errors"]
    assert (
        "channel 'flow' is in m^3; model 'local-level' takes y channel 'flow' in 1e8 m^3"
        in error["message"]
    )


@pytest.mark.parametrize("columns", [["y2", "y1"], ["top", "floor y1"]])
def test_columns_in_a_list_that_are_called_like_another_channel_are_refused(client, columns):
    rows = "\n".join(f"{i},{i}.5,{-i},0" for i in range(5))
    text = f"t,{','.join(columns)},force\n{rows}\n"
    request = {
        "kind": "estimate",
        "model": "structure",
        "series": [{"file": "a.csv", "y": columns}],
    }
    file = ("file", ("a.csv", text))
    answer = client.post("/jobs/upload", data={"request": json.dumps(request)}, files=[file])
    assert answer.status_code == 422, answer.text
    (error,) = answer.json()["errors"]
    assert error["field"] == "series[0].y"
    assert "in this order" in error["message"]
    assert "reorder the columns" in error["message"]


def test_units_behind_names_may_be_left_out(client):
    files = {
        "file": ("a.csv", b"rain [mm],depth [1e8 m^3],clock [year]\n5,1120,1\n6,1160,2\n7,963,3\n")
    }
    entry = {"file": "a.csv", "t": "clock", "extra": ["rain"]}
    for y in (["depth"], {"flow": "depth"}):
        request = {"kind": "smooth", "model": "local-level", "series": [entry | {"y": y}]}
        answer = client.post("/jobs/upload", data={"request": json.dumps(request)}, files=files)
        assert answer.status_code == 201, answer.text
        read = client.get(f"{answer.headers['location']}/request").json()["series"][0]
        assert (read["y"], read["t"]) == ([[1120.0], [1160.0], [963.0]], [1.0, 2.0, 3.0])
        client.post(f"{answer.headers['location']}/stop")


def test_the_command_line_finds_them_so_too(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("rain [mm],depth [1e8 m^3],clock [year]\n5,1120,1\n6,1160,2\n7,963,3\n")
    asked = Columns({"flow": "depth"}, time="clock", extra=["rain"])
    [series], said, notes = series_of(path, get_model("local-level"), asked)
    assert notes == []
    np.testing.assert_array_equal(series.y, [[1120], [1160], [963]])
    np.testing.assert_array_equal(series.t, [1, 2, 3])
    assert "flow from column depth [1e8 m^3]" in said


ROOM = """import numpy as np
from engine import Gaussian, MixedModel, Parameter

room = MixedModel(
    name="room-T",
    dynamics=lambda a, u, t, dt, th: (a + dt * (th.k * u[0] - 0.1 * a), np.zeros((1, 0)), [[1e-4]]),
    measurement=lambda a, u, t, th: ([a[:, 0]], np.zeros((1, 0)), [[1e-2]]),
    initial=lambda th: (Gaussian([20.0], [[1.0]]), [], np.zeros((0, 0))),
    nonlinear={"x": "degC"}, inputs={"P": "kW"}, outputs={"T": "degC"},
    parameters=[Parameter("k", 1.0, "degC/kJ", (0.0, 9.0))],
)
"""


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    path = tmp_path_factory.mktemp("models") / "room.py"
    path.write_text(ROOM)
    return model_of(f"{path}:room")


@pytest.mark.parametrize("head", ["T,t,P", "T,time,P", "T,Time [s],P", "t,T,P"])
@pytest.mark.parametrize("given", [{}, {"T": "T"}])
def test_a_temperature_is_no_time_where_the_model_measures_it(tmp_path, room, head, given):
    """Its column rises as times do."""
    rows = [(20.0 + 0.1 * k**1.5, 0.5 * k, 1) for k in range(9)]
    if head.startswith("t"):
        rows = [(b, a, c) for a, b, c in rows]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([head, *(",".join(map(str, row)) for row in rows)]))
    [series], _, notes = series_of(path, room, Columns(given))
    assert notes == []
    assert series.dt == 0.5
    np.testing.assert_allclose(series.y[:, 0], 20.0 + 0.1 * np.arange(9) ** 1.5)


def test_a_column_given_to_a_channel_is_no_time(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,time,y_V\n" + "".join(f"{k},{2 * k},{k % 3}\n" for k in range(9)))
    model = get_model("local-level")
    assert series_of(path, model, Columns({"flow": "y_V"}))[0][0].dt == 1.0
    assert series_of(path, model, Columns({"flow": "t"}))[0][0].dt == 2.0
    assert (
        series_of(path, model, Columns({"flow": "t"}, time="t"))[0][0].dt == 1.0
    )  # as it was asked
    assert series_of(path, model, Columns({"flow": "y_V"}, extra=["t"]))[0][0].dt == 2.0


def test_an_upload_takes_no_temperature_for_times(client):
    rows = "".join(f"{20 + k / 10},{k / 50},{k % 3},1\n" for k in range(9))
    files = {"file": ("a.csv", f"T,t,y,drive\n{rows}".encode())}
    answer = client.post("/preview", files=files)
    assert answer.json()["time"]["column"] == "t"
    request = {"kind": "smooth", "model": "servo"}
    answer = client.post("/jobs/upload", data={"request": json.dumps(request)}, files=files)
    assert answer.status_code == 201, answer.text
    read = client.get(f"{answer.headers['location']}/request").json()["series"][0]
    assert read["t"] == [k / 50 for k in range(9)]
    client.delete(answer.headers["location"])


@pytest.mark.long
def test_what_an_upload_assumes_is_told(client, ended):
    stamps = [f"2024-03-01 00:00:0{k}.5" for k in range(9)]
    rows = "".join(f"{one},{k % 3},1,{one}\n" for k, one in enumerate(stamps))
    files = {"file": ("a.csv", f"Timestamp,y [furlong],drive [V],Sent\n{rows}".encode())}
    request = {"kind": "smooth", "model": "servo", "options": {"particles": 5}}
    answer = client.post("/jobs/upload", data={"request": json.dumps(request)}, files=files)
    assert answer.status_code == 201, answer.text
    step = "a.csv: no column of times: a step of 1 s is assumed; else \"dt\": STEP, or, as 'Timestamp' holds "
    step += 'dates, "t": "Timestamp".'
    unit = "a.csv: units that are not known are compared with none: 'furlong' of column 'y [furlong]' is "
    unit += "taken for m."
    assert answer.json()["message"] == f"{step} {unit}"
    here = answer.headers["location"]
    assert ended(client, here)["message"].endswith(f"{step} {unit}")
    assert client.get(f"{here}/results").json()["notes"] == [step, unit]
    request |= {"series": [{"file": "a.csv", "t": "Timestamp"}]}
    again = client.post("/jobs/upload", data={"request": json.dumps(request)}, files=files)
    assert again.json()["message"] == unit
    for one in (answer, again):
        client.delete(one.headers["location"])


def test_the_hint_is_what_helps(client):
    request = {"kind": "smooth", "model": "local-level"}
    data = text("year,depth,rain").encode()
    files = {"file": ("a.csv", data)}
    answer = client.post("/jobs/upload", data={"request": json.dumps(request)}, files=files)
    assert answer.status_code == 422
    error = answer.json()["errors"][0]
    assert (error["field"], error["channel"]) == ("series[0].y", "flow")
    hint = error["message"].partition(" with ")[2].partition(". There")[0]
    request |= json.loads("{" + hint.replace("COLUMN", "depth") + "}")
    answer = client.post("/jobs/upload", data={"request": json.dumps(request)}, files=files)
    assert answer.status_code == 201
    client.post(f"{answer.headers['location']}/stop")
