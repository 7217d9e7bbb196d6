"""Pages at the addresses of the JSON calls, and the calls that the pages need."""

import json
import re

import numpy as np
import pytest

import engine
from engine.data import nile
from service.pages import STATIC, prefers_html

BROWSER = "text/html,application/xhtml+xml,application/xml;q=0.9,image/avif,*/*;q=0.8"


@pytest.mark.parametrize(
    ("accept", "html"),
    [
        (BROWSER, True),
        ("text/html", True),
        ("text/*", True),
        ("", False),
        ("*/*", False),
        ("application/json", False),
        ("application/json, text/html", False),
        ("text/html;q=0.5, application/json", False),
        ("text/html;q=0.9, application/json;q=0.8", True),
        ("text/html;q=nan", False),
        ("text/html;q=\u00b2", False),
        ("text/html;q=\u0661", False),
        ("text/html;q=1.", True),
    ],
)
def test_preference(accept, html):
    assert prefers_html(accept) == html


@pytest.mark.parametrize("path", ["/", "/jobs"])
def test_one_address_two_forms(client, path):
    page = client.get(path, headers={"Accept": BROWSER})
    data = client.get(path)
    assert (page.status_code, page.headers["content-type"]) == (200, "text/html; charset=utf-8")
    assert page.text.startswith("<!doctype html>")
    assert data.headers["content-type"] == "application/json"
    assert page.headers["vary"] == data.headers["vary"] == "Accept"
    assert "default-src 'self'" in page.headers["content-security-policy"]


def test_the_page_loads_nothing_from_elsewhere(client):
    pages = [client.get(path, headers={"Accept": BROWSER}).text for path in ("/", "/jobs")]
    links = {link for page in pages for link in re.findall(r'(?:src|href)="([^"]+)"', page)}
    assert {link[0] for link in links} <= {"/", "#"}
    for link in links - {"/", "/jobs", "#main"}:
        assert client.get(link).status_code == 200, link
    for file in STATIC.rglob("*"):
        if file.suffix in (".js", ".css") and "vendor" not in file.parts:
            text = file.read_text("utf-8").replace("http://www.w3.org/1998/Math/MathML", "")
            assert not re.search(r"https?://|@import|url\(", text), file


def test_modules_import_only_what_is_there():
    for file in STATIC.rglob("*.js"):
        for path in re.findall(r'^import .* from "/static/([^"]+)"', file.read_text("utf-8"), re.M):
            assert (STATIC / path).is_file(), (file, path)


def test_files_that_are_not_there(client):
    for path in ("/static/nothing.js", "/static/../pages.py", "/static/%2e%2e/pages.py"):
        assert client.get(path).status_code == 404


def test_an_address_that_is_none_has_a_page_for_browsers(client):
    for path in ("/nope", "/guide/nope", "/static/nothing.js"):
        page = client.get(path, headers={"Accept": "text/html,*/*;q=0.8"})
        assert (page.status_code, page.headers["content-type"]) == (404, "text/html; charset=utf-8")
        assert "There is no such page" in page.text
        assert client.get(path).headers["content-type"] == "application/problem+json"


def look(client, name, data, **form):
    return client.post("/preview", files={"file": (name, data)}, data=form)


def test_preview_of_a_csv(client):
    text = "time,level,what\n0,1.5,a\n2,,b\n4,-1,c\n6,,d\n8,,e\n10,3,f\n"
    found = look(client, "a.csv", text).json()
    assert (found["rows"], found["dt"], found["ignored"]) == (6, None, [])
    assert found["time"] == {
        "column": "time", "problem": None, "first": 0.0, "last": 10.0, "step": 2.0, "regular": True,
    }  # fmt: skip
    time, level, what = found["columns"]
    assert (time["minimum"], time["maximum"], time["missing"]) == (0.0, 10.0, 0)
    assert level["value"] == [1.5, None, -1.0, None, None, 3.0]
    assert (level["missing"], level["gaps"]) == (3, [[1, 1], [3, 4]])
    assert "line 2, column 'what': 'a' is not a number" in what["problem"]


def test_preview_reads_times_as_a_job_does(client):
    rows = "".join(f"2024-05-01 00:0{k // 6}:{k % 6}0,{k % 3}\n" for k in range(30))
    for name in ("time", "Zeitstempel"):  # called so, or the only one of dates
        found = look(client, "a.csv", f"{name},level\n{rows}").json()
        time = found["time"]
        assert (time["column"], time["problem"], time["regular"]) == (name, None, True)
        assert (time["first"], time["last"], time["step"]) == (0.0, 290.0, 10.0)
        dates, level = found["columns"]
        assert (dates["dates"], dates["problem"]) == (True, "it holds dates")
        assert (dates["value"][:3], dates["minimum"]) == ([0.0, 10.0, 20.0], None)
        assert not level["dates"]
    found = look(client, "a.csv", f"time,level\n{rows}", time_unit="min").json()
    assert (found["time"]["step"], found["time_unit"]) == (pytest.approx(1.0 / 6.0), "min")
    found = look(client, "a.csv", f"time,level\n{rows}", t="time", time_unit="year").json()
    assert "of which it is not known how many seconds" in found["time"]["problem"]
    found = look(
        client, "a.csv", "t [ms],level\n0,1\n20,2\n40,1\n", t="t [ms]", time_unit="s"
    ).json()
    assert (found["time"]["last"], found["time_unit"]) == (0.04, "s")  # as a job converts them


def test_preview_says_what_is_wrong_with_dates(client):
    text = "day,level\n2024-05-01 00:00:00,1\n2024-05-01 00:00:10,2\n2024-05-01 00:00:05,1\n"
    found = look(client, "a.csv", text, t="day").json()
    assert found["time"]["problem"].startswith("decreases at line 4 (2024-05-01 00:00:05)")
    found = look(client, "a.csv", text.replace("00:05", "x"), t="day").json()
    assert "line 4, column 'day': '2024-05-01 00:x' is not a date" in found["time"]["problem"]


@pytest.mark.long
def test_preview_is_thin_and_keeps_extremes_and_gaps(client):
    y = np.sin(np.arange(100_000) / 500.0)
    y[[31_111, 67_890]] = 5.0, -5.0
    y[[40_000, 40_001]] = np.nan
    found = look(
        client, "a.csv", "y\n" + "\n".join("" if v != v else repr(v) for v in y.tolist())
    ).json()
    (column,) = found["columns"]
    assert len(column["row"]) < 2100
    pairs = dict(zip(column["row"], column["value"], strict=True))
    assert (pairs[31_111], pairs[67_890]) == (5.0, -5.0)
    assert column["gaps"] == [[40_000, 40_001]]
    assert pairs[40_000] is None
    assert all(y[row] == value for row, value in pairs.items() if value is not None)


def test_preview_of_stored_arrays(client, tmp_path):
    np.savez(tmp_path / "a.npz", y=np.ones((5, 2)), u=np.arange(5.0), dt=0.25, name=np.array("x"))
    found = look(client, "a.npz", (tmp_path / "a.npz").read_bytes()).json()
    assert (found["dt"], found["time"]) == (0.25, None)
    assert [one["name"] for one in found["columns"]] == ["y1", "y2", "u"]
    assert found["ignored"] == ["'name' is not a table of real numbers"]


@pytest.mark.parametrize(
    ("name", "text", "t", "field", "words"),
    [
        ("a.csv", "", None, "file", "is empty"),
        ("a.csv", "1,2\n3,4\n", None, "file", "must name the columns"),
        ("a.xlsx", "y\n1\n2\n", None, "file", "the ending must be .csv"),
        ("a.csv", "y\n1\n2\n", "z", "t", "no column 'z'"),
        ("a.npz", "PK", None, "file", "not a readable"),
    ],
)
def test_preview_of_what_cannot_be_read(client, name, text, t, field, words):
    answer = look(client, name, text, **({"t": t} if t else {}))
    assert answer.status_code == 422
    (error,) = answer.json()["errors"]
    assert error["field"] == field
    assert words in error["message"]


@pytest.mark.parametrize(
    ("times", "words"),
    [("0 1 1", "repeats at line 4 (1); time must increase"), ("0 x 2", "'x' is not a number")],
)
def test_preview_of_bad_times(client, times, words):
    rows = "".join(f"{t},{i}\n" for i, t in enumerate(times.split()))
    time = look(client, "a.csv", "t,y\n" + rows).json()["time"]
    assert words in time["problem"]
    assert time["step"] is None


def test_preview_has_the_limits_of_jobs(make_client):
    client = make_client(max_samples=3)
    assert "this service allows 3" in look(client, "a.csv", "y\n1\n2\n3\n4\n").json()["detail"]


def test_a_request_can_be_asked_for_and_posted_again(client, estimation, ended):
    first = estimation(iterations=2)
    y = first["series"][0]["y"]
    first["series"][0]["y"] = [*y[:3], [None], *y[4:]]  # a copy: other tests have the same data
    url = client.post("/jobs", json=first).headers["location"]
    asked = client.get(f"{url}/request").json()
    assert asked["series"][0]["y"] == first["series"][0]["y"]
    again = client.post("/jobs", json=asked).headers["location"]
    for one in (url, again):
        ended(client, one)
    results = [client.get(f"{one}/results").json()["estimate"] for one in (url, again)]
    assert results[0] == results[1]
    client.delete(url)
    assert client.get(f"{url}/request").status_code == 404


def test_jobs_by_kind_and_by_model_with_its_extensions(make_client, estimation):
    client = make_client(workers=1)
    smooth = {"kind": "smooth", "series": [{"y": nile().y.tolist()}], "options": {"particles": 20}}
    posted = [
        smooth | {"model": "local-level"},
        smooth | {"model": {"name": "local-level", "with": ["step:flow"]}},
        estimation(iterations=1),
    ]
    ids = [client.post("/jobs", json=one).json()["jobID"] for one in posted]
    assert client.get("/jobs?kind=other").status_code == 422

    def found(query):
        return {one["jobID"] for one in client.get(f"/jobs?{query}").json()["jobs"]}

    assert found("kind=smooth") == set(ids[:2])
    assert found("kind=smooth&kind=estimate") == set(ids)
    assert found("model=local-level") == set(ids[:2])
    assert found("model=local-level%2Bstep:flow") == {ids[1]}
    assert found("model=local") == set()
    link = client.get("/jobs?kind=smooth&limit=1").json()["links"][-1]
    assert [one["jobID"] for one in client.get(link["href"]).json()["jobs"]] == [ids[0]]


def test_a_model_with_effects(client):
    reference = {"name": "local-level", "with": ["step:flow"]}
    found = client.post("/models/extend", json=reference).json()
    assert found["parameters"][-2]["name"] == "step_flow"
    assert found["example"]["model"]["with"] == ["step:flow"]
    assert client.post("/jobs", json=found["example"]).status_code == 201
    wrong = client.post("/models/extend", json={"name": "local-level", "with": ["x:flow"]})
    assert wrong.json()["errors"][0]["field"] == "model.with"


def test_held_out_data_in_a_file(client):
    def csv(rows):
        return "\n".join(["y", *(str(v) for v in rows)])

    request = {
        "kind": "diagnose",
        "model": "linear-2",
        "test": {"file": "new.csv", "dt": 1.0},
        "options": {"effects": ["offset"]},
    }
    series = engine.simulate(engine.get_model("linear-2"), None, 40, np.random.default_rng(1))
    y = series.y[:, 0].tolist()
    files = [("file", ("old.csv", csv(y[:30]))), ("file", ("new.csv", csv(y[30:])))]
    answer = client.post("/jobs/upload", data={"request": json.dumps(request)}, files=files)
    assert answer.status_code == 201, answer.text
    asked = client.get(f"{answer.headers['location']}/request").json()
    assert len(asked["series"]) == 1
    assert asked["test"]["y"] == [[v] for v in y[30:]]
    client.post(f"{answer.headers['location']}/stop")


def test_vendored_files_say_what_they_are():
    folder = STATIC / "vendor" / "uplot"
    version = re.search(r"v([\d.]+)", (folder / "uPlot.iife.min.js").read_text("utf-8")[:100])
    assert f"uPlot {version[1]}" in (folder / "README.md").read_text("utf-8")
    assert "MIT License" in (folder / "LICENSE").read_text("utf-8")
