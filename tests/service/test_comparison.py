"""Two jobs side by side: numbers, what may be compared, the report; over HTTP."""

import numpy as np
import pytest

import engine
from engine.errors import OptionError
from engine.presentation.two_results import compare_results


@pytest.fixture(scope="module")
def model():
    return engine.get_model("oscillator")


@pytest.fixture(scope="module")
def records(model):
    """Training and held-out records at omega = 7 rad/s."""
    out = []
    for seed in (0, 1):
        u = np.repeat(np.random.default_rng(seed).uniform(-2, 2, 30), 10)
        rng = np.random.default_rng(10 + seed)
        out.append(engine.simulate(model, {"omega": 7.0}, 300, rng, u=u, dt=0.05).series)
    return [{"y": one.y.tolist(), "u": one.u.tolist(), "dt": 0.05} for one in out]


@pytest.fixture(scope="module")
def jobs(client, records):
    """A fit of the simulation and one by maximum likelihood, on the same data; a diagnosis; another's data."""
    train, test = records
    fit = {"kind": "estimate", "model": "oscillator", "parameters": {"free": ["omega", "zeta"]}}
    simulation = fit | {"series": [train], "test": test, "options": {"method": "simulation"}}
    exact = {"method": "rts-em", "iterations": 20, "intervals": "symmetric"}
    requests = {
        "first": simulation | {"name": "first"},
        "second": fit | {"series": [train], "test": test, "options": exact, "name": "second"},
        "elsewhere": simulation | {"series": [test], "test": train, "name": "elsewhere"},
        "diagnosis": {
            "kind": "diagnose", "model": "oscillator", "series": [train], "test": test,
            "options": {"effects": ["bias"]},
        },
        "smooth": {"kind": "smooth", "model": "oscillator", "series": [train]},
    }  # fmt: skip
    return {
        name: client.post("/jobs", json=request).json()["jobID"]
        for name, request in requests.items()
    }


@pytest.fixture
def compare(client, jobs, ended):
    def compared(a, b, path="/compare", **headers):
        for name in (a, b):
            job = ended(client, f"/jobs/{jobs[name]}", 600.0)
            assert job["status"] == "successful", job["message"]
        return client.get(path, params={"a": jobs[a], "b": jobs[b]}, headers=headers)

    return compared


@pytest.mark.slow
def test_parameters_errors_curves_and_held_out_errors_side_by_side(client, jobs, compare):
    found = compare("first", "second").json()
    results = [client.get(f"/jobs/{jobs[name]}/results").json() for name in ("first", "second")]
    (omega,) = (one for one in found["parameters"] if one["name"] == "omega")
    estimates = [one["estimate"]["omega"] for one in results]
    assert omega["values"] == [one["value"] for one in estimates]
    assert omega["standard_errors"] == [one["standard_error"] for one in estimates]
    assert omega["difference"] == pytest.approx(estimates[1]["value"] - estimates[0]["value"])
    larger = max(one["standard_error"] for one in estimates)
    assert omega["in_errors"] == pytest.approx(omega["difference"] / larger)
    assert omega["unit"] == estimates[0]["unit"]
    assert found["free_parameters"] == [2, 2]
    assert found["methods"] == ["simulation", None]
    assert (found["same_data"], found["same_held_out"]) == (True, True)
    assert found["log_likelihood"] == [None, results[1]["log_likelihood"]]
    assert [one["name"] for one in found["jobs"]] == ["first", "second"]
    errors = [one["outputs"][0]["rmse"] for one in found["held_out"]]
    assert errors == [one["held_out"]["outputs"][0]["rmse"] for one in results]
    assert all(0.0 < error < 0.2 for error in errors)
    kinds = {one["what"] for one in found["curves"]}
    assert kinds == {"simulation", "held-out", "state"}
    for one in found["curves"]:
        for curve in (*one["values"], *one["measured"]):
            assert curve is None or len(curve) == len(one["t"])


@pytest.mark.slow
def test_the_held_out_error_is_that_of_the_model_run_on_those_data(
    client, jobs, compare, records, model
):
    found = compare("first", "second").json()["held_out"][0]
    values = client.get(f"/jobs/{jobs['first']}/results").json()
    theta = {name: one["value"] for name, one in values["estimate"].items()}
    (held,) = values["held_out"]["series"]
    test = engine.Series(records[1]["y"], records[1]["u"], dt=0.05)
    error = np.array(held["measured"]["y"]) - np.array(held["y"]["y"])
    assert found["outputs"][0]["rmse"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-5)
    # where its first state is forgotten it is the model's free run
    run = engine.free_run(model, theta, test).y[:, 0]
    assert held["y"]["y"][-50:] == pytest.approx(run[-50:], abs=0.02)
    assert found["samples"] == 300


@pytest.mark.slow
def test_what_is_of_different_data_is_not_subtracted(compare):
    found = compare("first", "elsewhere").json()
    assert (found["same_data"], found["same_held_out"]) == (False, False)
    report = compare("first", "elsewhere", "/compare/report").json()
    assert "their difference has no meaning" in report["summary"]
    assert [one["label"] for one in report["charts"][0]["series"]][2:] == [
        "measured, first",
        "measured, elsewhere",
    ]


@pytest.mark.slow
def test_a_diagnosis_beside_an_estimate(compare, client, jobs):
    found = compare("diagnosis", "first").json()
    assert found["models"][0].startswith("oscillator")
    assert found["outcome"][0] in ("nothing", "named", "set", "unknown")
    extension = client.get(f"/jobs/{jobs['diagnosis']}/results").json()["diagnosis"]["extension"]
    (omega,) = (one for one in found["parameters"] if one["name"] == "omega")
    assert omega["values"][0] == extension["theta"]["omega"]
    assert omega["standard_errors"][0] == extension["standard_errors"]["omega"]


@pytest.mark.slow
def test_the_report_as_parts_and_as_a_file(compare):
    parts = compare("first", "second", "/compare/report").json()
    assert parts["title"] == "first and second"
    assert "standard errors of first are of a fit of the simulation" in parts["summary"]
    assert {one["id"] for one in parts["sections"]} == {"parameters", "curves"}
    assert all(len(one["x"]) <= 3000 for one in parts["charts"])
    file = compare("first", "second", "/compare/report", Accept="text/html")
    assert file.headers["content-type"].startswith("text/html")
    assert "<svg" in file.text
    assert "held-out error of y, rms" in file.text
    assert "<script" not in file.text


def test_jobs_that_cannot_be_compared(client, jobs, compare, long):
    assert client.get("/compare", params={"a": "none", "b": "none"}).status_code == 404
    assert client.get("/compare", headers={"Accept": "application/json"}).status_code == 422
    running = client.post("/jobs", json=long).json()["jobID"]
    answer = client.get("/compare", params={"a": running, "b": jobs["first"]})
    assert (answer.status_code, answer.json()["title"]) == (404, "result not ready")
    client.post(f"/jobs/{running}/stop")
    with pytest.raises(OptionError, match="no estimate"):
        compare_results({}, {})


def test_curves_at_different_times_are_joined():
    def simulated(t, y):
        run = {"t": t, "y": {"y": y}, "states": {}, "measured": {"y": y}}
        return {"parameters": {"k": 1.0}, "simulation": {"series": [run]}}

    found = compare_results(simulated([0.0, 1.0], [0.0, 2.0]), simulated([0.5, 2.0], [1.0, 3.0]))
    (curve,) = found["curves"]
    assert curve["t"] == [0.0, 0.5, 1.0, 2.0]
    assert curve["values"] == [[0.0, 1.0, 2.0, None], [None, 1.0, pytest.approx(5 / 3), 3.0]]
    assert curve["measured"] == [[0.0, None, 2.0, None], [None, 1.0, None, 3.0]]
    assert found["same_data"] is False
    assert found["parameters"][0]["held"] == [True, True]
