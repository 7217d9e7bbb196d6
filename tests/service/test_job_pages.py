"""The page of a job, its report, and what they are made from."""

import json
import re

import pytest

from service.auth import digest_of
from service.downsample import thin_results
from service.stages import plan, roles

BROWSER = "text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8"


@pytest.fixture(scope="module")
def url(client, data):
    """A small estimate with two starts and a bootstrap, done."""
    request = {
        "kind": "estimate",
        "model": "linear-2",
        "series": [{"y": data, "dt": 1.0}, {"y": data[:40], "dt": 1.0}],
        "parameters": {"start": {"theta": 0.3}, "free": ["theta"]},
        "options": {"method": "rts-em", "iterations": 8, "starts": 2, "bootstrap": 3, "seed": 1},
    }
    return client.post("/jobs", json=request).headers["location"]


@pytest.mark.long
def test_one_address_two_forms(client, url, ended):
    assert ended(client, url)["status"] == "successful"
    page = client.get(url, headers={"Accept": BROWSER})
    assert page.headers["content-type"] == "text/html; charset=utf-8"
    assert "default-src 'self'" in page.headers["content-security-policy"]
    for name in (
        "progress",
        "traces",
        "attempts",
        "failure",
        "results",
        "stop",
        "repeat",
        "report",
    ):
        assert f'id="{name}"' in page.text, name
    links = set(re.findall(r'(?:src|href)="(/[^"]+)"', page.text)) - {"/jobs"}
    for link in links:
        assert client.get(link).status_code == 200, link
    job = client.get(url).json()
    assert {link["rel"] for link in job["links"]} == {"self", "trace", "results", "report"}


@pytest.mark.long
def test_results_hold_what_the_page_shows(client, url, ended):
    ended(client, url)
    found = client.get(f"{url}/results").json()
    assert list(found["model"]["outputs"]) == ["y"]
    theta = found["estimate"]["theta"]
    quantiles = found["bootstrap"]["quantiles"]["theta"]
    assert theta["interval"] == [quantiles["0.025"], quantiles["0.975"]]
    assert len(found["examination"]["series"]) == 2
    one = found["examination"]["series"][1]
    for what in ("free_run", "one_step"):
        curves = one[what]["curves"]
        assert len(curves["t"]) == len(curves["y"]["y"]) == len(curves["lower"]["y"]) == 40
        assert one[what]["fits"][0]["output"] == "y"
    assert len(one["residuals"]["z"]["y"]) == 40


def test_thin_results_keep_extremes_and_other_axes(client, url, ended):
    ended(client, url)
    whole = client.get(f"{url}/results").json()["examination"]["series"][0]
    thin = client.get(f"{url}/results?points=30").json()["examination"]["series"][0]
    measured = [
        whole["free_run"]["curves"]["measured"]["y"],
        thin["free_run"]["curves"]["measured"]["y"],
    ]
    assert 5 < len(measured[1]) <= 30 < len(measured[0])
    assert (min(measured[1]), max(measured[1])) == (min(measured[0]), max(measured[0]))
    z = [one["residuals"]["z"]["y"] for one in (whole, thin)]
    assert (min(z[1]), max(z[1])) == (min(z[0]), max(z[0]))
    for key in ("autocorrelation", "quantiles", "histogram"):
        assert thin["residuals"][key] == whole["residuals"][key]
    assert thin["one_step"]["bands"] == whole["one_step"]["bands"]


def test_report_as_a_file(client, url, ended):
    ended(client, url)
    answer = client.get(f"{url}/report", headers={"Accept": "text/html"})
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    assert answer.headers["content-security-policy"].startswith("default-src 'none'")
    assert re.search(r'filename="estimate-\w{8}\.html"', answer.headers["content-disposition"])
    assert answer.text.startswith("<!doctype html>")
    assert not re.search(r"https?://|<script", answer.text)
    for said in ("start 1", "start 2", "Parametric bootstrap", "series 2", url.rpartition("/")[2]):
        assert said in answer.text, said


def test_report_in_parts(client, url, ended):
    ended(client, url)
    parts = client.get(f"{url}/report").json()
    ids = [section["id"] for section in parts["sections"]]
    assert ids[:3] == ["convergence", "states-0", "states-1"]
    html = parts["summary"] + "".join(section["html"] for section in parts["sections"])
    places = [int(k) for k in re.findall(r'data-chart="(\d+)"', html)]
    assert places == list(range(len(parts["charts"])))
    chart = parts["charts"][0]
    trace = client.get(f"{url}/results").json()["trace"]
    assert chart["title"] == "theta"
    n = len(trace["iteration"])  # another start may have taken more
    assert chart["x"][:n] == trace["iteration"]
    assert chart["series"][-1]["y"][:n] == trace["theta"]["theta"]
    assert chart["series"][0]["band"] is not None  # the bootstrap's interval
    # the page allows no style and no script within it
    assert not re.search(r"<script|<style|\sstyle=|\son\w+=", html)


@pytest.mark.long
def test_more_points_where_a_long_curve_is_zoomed_into(client, ended):
    request = {"kind": "simulate", "model": "linear-2", "options": {"samples": 9000, "seed": 1}}
    url = client.post("/jobs", json=request).headers["location"]
    ended(client, url)
    whole = client.get(f"{url}/results").json()["simulation"]["series"][0]
    charts = client.get(f"{url}/report").json()["charts"]
    number, chart = next((k, c) for k, c in enumerate(charts) if c["title"].startswith("y"))
    (y,) = (row["y"] for row in chart["series"])
    full = whole["y"]["y"]
    assert len(y) == len(chart["x"]) <= 4000 < chart["points"] == 9000
    assert (min(y), max(y)) == (min(full), max(full))
    finer = client.get(f"{url}/charts?from=4000.5&to=4100").json()["charts"]
    assert set(finer) == {str(k) for k in range(len(charts))}
    assert finer[str(number)]["x"] == [float(t) for t in range(4000, 4102)]
    assert finer[str(number)]["series"][0]["y"] == full[4000:4102]
    wide = client.get(f"{url}/charts?from=-50&to=1e6").json()["charts"][str(number)]
    assert wide["x"] == chart["x"]
    assert client.get(f"{url}/charts?from=9500&to=9600").json()["charts"][str(number)]["x"] == [
        8999.0
    ]
    for wrong in ("from=5&to=5", "from=nan&to=1", "to=3"):
        assert client.get(f"{url}/charts?{wrong}").status_code == 422


def test_short_curves_have_no_finer_ones(client, url, ended):
    ended(client, url)
    charts = client.get(f"{url}/report").json()["charts"]
    assert all(chart["points"] == len(chart["x"]) for chart in charts)
    assert client.get(f"{url}/charts?from=1&to=2").json() == {"charts": {}}


def test_computations_are_listed(client, url, ended):
    ended(client, url)
    tasks = client.get(f"{url}/tasks").json()["tasks"]
    expected = ["start", "start", "choice", "bootstrap", "bootstrap", "bootstrap", "summary"]
    assert [task["role"] for task in tasks] == expected
    assert {task["state"] for task in tasks} == {"done"}
    assert [task["iteration"] > 0 for task in tasks[:2]] == [True, True]
    trace = client.get(f"{url}/trace?task=1").json()
    assert tasks[1]["estimate"]["theta"] == trace["theta"]["theta"][-1]
    assert tasks[2]["estimate"] is None


START, CHOICE, DRAW, SUMMARY = "start", "choice", "bootstrap", "summary"


@pytest.mark.parametrize(
    ("starts", "bootstrap", "expected"),
    [
        (1, 0, ["computation"]),
        (3, 0, [START, START, START, CHOICE]),
        (1, 2, ["estimate", DRAW, DRAW, SUMMARY]),
        (2, 2, [START, START, CHOICE, DRAW, DRAW, SUMMARY]),
    ],
)
def test_roles_are_those_of_the_plan(estimation, starts, bootstrap, expected):
    from service.validation import load

    request = load(estimation(starts=starts, bootstrap=bootstrap)).request
    assert roles(plan(request)) == expected


def test_a_waiting_job_has_a_page_and_no_report(make_client, estimation):
    client = make_client(workers=1)
    long = estimation(particles=200, iterations=10_000)
    for _ in range(2):
        location = client.post("/jobs", json=long).headers["location"]
    assert client.get(location, headers={"Accept": BROWSER}).status_code == 200
    answer = client.get(f"{location}/report", headers={"Accept": BROWSER})
    assert (answer.status_code, answer.json()["title"]) == (404, "result not ready")
    tasks = client.get(f"{location}/tasks").json()["tasks"]
    assert [(task["state"], task["estimate"]) for task in tasks] == [("queued", None)]
    client.post(f"{location}/stop")
    assert client.get(f"{location}/report").status_code == 404
    assert client.get(f"{location}/tasks").json()["tasks"][0]["state"] == "stopped"


def test_a_failed_job_says_what_to_do(client, estimation, ended):
    request = estimation() | {"kind": "smooth", "run_seconds": 0.2, "parameters": {}}
    request |= {
        "options": {"particles": 10_000},
        "series": [{"y": [[0.1 * (k % 7)] for k in range(5000)]}],
    }
    url = client.post("/jobs", json=request).headers["location"]
    assert ended(client, url)["status"] == "failed"
    for path in ("results", "report"):
        answer = client.get(f"{url}/{path}", headers={"Accept": BROWSER})
        assert answer.headers["content-type"] == "application/problem+json"
        assert "longer than the 0.2 s" in answer.json()["detail"]
        assert "allow more time" in answer.json()["advice"]


simulated_or_smoothed = pytest.mark.parametrize(
    "request_",
    [
        {"kind": "simulate", "options": {"samples": 30}},
        {
            "kind": "smooth",
            "options": {"particles": 10},
            "series": [{"y": [[float(k % 3)] for k in range(20)]}],
        },
    ],
    ids=lambda request: request["kind"],
)


@simulated_or_smoothed
def test_what_is_said_of_a_result_and_of_its_files_is_on_page_and_in_report(
    client, ended, request_
):
    labels = {"name": "a run", "tags": ["cold", "rig 2"], "data": ["run7.csv"]}
    asked = {
        "model": "linear-2",
        **labels,
        "notes": ["run7.csv: a step of 1 s was assumed"],
        **request_,
    }
    if request_["kind"] == "smooth":
        y = [[100.0 * (k % 7 > 3)] for k in range(60)]
        asked |= {"series": [{"y": y}], "options": {"particles": 2}}
    url = client.post("/jobs", json=asked).headers["location"]
    job = ended(client, url)
    results = client.get(f"{url}/results").json()
    said = [results["message"]] if results.get("message") else []
    if request_["kind"] == "smooth":
        assert "Use more particles" in said[0]
    page = client.get(f"{url}/report").json()["summary"]
    report = client.get(f"{url}/report", headers={"Accept": "text/html"}).text
    for sentence in (*said, *asked["notes"]):
        assert sentence in page
        assert sentence in report
    for told in ("a run", "cold, rig 2", "run7.csv"):
        assert f"<dd>{told}</dd>" in report
    assert {key: results[key] for key in labels} == labels
    assert results["created"] == job["created"]
    assert client.get(f"{url}/results?points=3").json()["data"] == ["run7.csv"]


@simulated_or_smoothed
def test_simulations_and_states_have_reports(client, ended, request_):
    url = client.post("/jobs", json={"model": "linear-2"} | request_).headers["location"]
    assert ended(client, url)["status"] == "successful"
    parts = client.get(f"{url}/report").json()
    assert parts["sections"]
    assert len(parts["charts"]) >= 2


def test_others_see_neither_report_nor_tasks(make_client, tmp_path, estimation, ended):
    (tmp_path / "keys").write_text(f"one {digest_of('key one')}\ntwo {digest_of('key two')}\n")
    client = make_client(keys_file=tmp_path / "keys")
    mine, other = {"X-API-Key": "key one"}, {"X-API-Key": "key two"}
    url = client.post("/jobs", json=estimation(iterations=1), headers=mine).headers["location"]
    for path in (f"{url}/report", f"{url}/tasks", f"{url}/charts?from=0&to=1"):
        assert client.get(path).status_code == 401
        assert client.get(path, headers=other).status_code == 404
    page = client.get(url, headers={"Accept": BROWSER})  # a shell that holds no data
    assert page.status_code == 200
    assert 'data-keys="needed"' in page.text


@pytest.mark.long
def test_what_is_shown_of_a_diagnosis_is_in_its_results(client, ended, data):
    y = [[row[0] + (5.0 if i >= 30 else 0.0)] for i, row in enumerate(data)]
    request = {
        "kind": "diagnose", "model": "linear-2", "series": [{"y": y, "dt": 1.0}],
        "options": {"effects": ["step", "bias"], "seed": 1},
    }  # fmt: skip
    url = client.post("/jobs", json=request).headers["location"]
    assert ended(client, url, 120.0)["status"] == "successful"
    found = client.get(f"{url}/results").json()["diagnosis"]
    parts = client.get(f"{url}/report").json()
    assert [s["id"] for s in parts["sections"]][:4] == ["wrong", "cause", "extension", "gain"]
    assert found["verdict"] in parts["summary"]
    run = found["symptoms"]["free_run"]["curves"]
    chart = next(c for c in parts["charts"] if c["title"].startswith("Free-run"))
    assert chart["x"] == run["t"]
    assert chart["series"][0]["band"] == [run["lower"]["y"], run["upper"]["y"]]
    assert chart["series"][1]["y"] == run["measured"]["y"]
    if found["gain"]:
        assert sum(
            found["gain"]["budget"][0][k] for k in ("noise", "left", "gone")
        ) == pytest.approx(1)
    thin = thin_results(json.loads(json.dumps({"diagnosis": found})), 10)["diagnosis"]
    assert len(thin["symptoms"]["one_step"]["curves"]["t"]) <= 12


def test_names_in_a_job_are_escaped(client):
    evil = "<script>alert(1)</script>"
    answer = client.get(f"/jobs/{evil}", headers={"Accept": BROWSER})
    assert evil not in answer.text
    request = {"kind": "estimate", "model": evil, "series": [{"y": [[1.0], [2.0]]}]}
    answer = client.post("/jobs", json=request, headers={"Accept": BROWSER})
    assert answer.headers["content-type"] == "application/problem+json"  # never read as a page
    assert answer.headers["x-content-type-options"] == "nosniff"
