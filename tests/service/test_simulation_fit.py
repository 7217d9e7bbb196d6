"""The fit of the free run as a job: what it gives, what it refuses, and EM that leaves from it."""

import numpy as np
import pytest

import engine


@pytest.fixture(scope="module")
def request_():
    model = engine.get_model("oscillator")
    name = next(iter(model.parameter_names))
    u = np.repeat(np.random.default_rng(0).uniform(-2, 2, 30), 10)
    truth = {name: 1.2 * model.theta()[name]}
    series = engine.simulate(model, truth, 300, np.random.default_rng(1), u=u, dt=0.05).series
    return truth, {
        "kind": "estimate",
        "model": "oscillator",
        "series": [{"y": series.y.tolist(), "u": series.u.tolist(), "dt": 0.05}],
        "parameters": {"free": [name]},
        "options": {"method": "simulation", "seed": 3},
    }


@pytest.mark.long
def test_a_fit_of_the_simulation(client, ended, request_):
    truth, request = request_
    url = client.post("/jobs", json=request).headers["location"]
    job = ended(client, url)
    assert job["status"] == "successful", job
    assert job["progress"] == 100
    found = client.get(f"{url}/results").json()
    ((name, value),) = truth.items()
    one = found["estimate"][name]
    assert one["value"] == pytest.approx(value, rel=0.1)
    assert one["interval"][0] < one["value"] < one["interval"][1]
    assert found["method"] == "simulation"
    assert "errors of the run that last" in found["warning"]
    assert found["estimate"][next(k for k in found["estimate"] if k != name)]["fixed"]
    (run,) = found["simulation"]["series"]
    measured, y = (np.array(run[key]["y"] if "y" in run[key] else next(iter(run[key].values())))
                   for key in ("measured", "y"))  # fmt: skip
    assert found["rmse"] == pytest.approx(np.sqrt(np.mean((measured - y) ** 2)))
    model = engine.get_model("oscillator")
    series = engine.Series(request["series"][0]["y"], request["series"][0]["u"], dt=0.05)
    same = engine.fit_simulation(model, series, free=[name], seed=3)
    assert one["value"] == same.theta[name]
    report = client.get(f"{url}/report", headers={"Accept": "text/html"}).text
    assert "Simulation" in report
    assert "measured" in report


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"starts": 2}, "starts"),
        ({"bootstrap": 5}, "bootstrap"),
        ({"first": "simulation"}, "first"),
    ],
)
def test_what_it_has_no_use_for_is_refused(client, request_, options, field):
    request = request_[1] | {"options": {"method": "simulation"} | options}
    answer = client.post("/jobs", json=request)
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == f"options.{field}"


@pytest.mark.long
@pytest.mark.parametrize("starts", [1, 2])
def test_em_leaves_from_it(client, ended, request_, starts):
    options = {"first": "simulation", "iterations": 2, "particles": 20, "standard_errors": False}
    request = request_[1] | {"options": options | {"starts": starts, "seed": 3}}
    url = client.post("/jobs", json=request).headers["location"]
    assert ended(client, url)["status"] == "successful"
    found = client.get(f"{url}/results").json()
    (name,) = request["parameters"]["free"]
    series = engine.Series(request["series"][0]["y"], request["series"][0]["u"], dt=0.05)
    least = engine.fit_simulation(engine.get_model("oscillator"), series, free=[name], seed=3)
    if starts == 1:
        assert "EM started from the fit of the simulation" in found["message"]
        assert found["trace"]["theta"][name][0] == least.theta[name]
    else:
        first = found["starts"][0]
        assert first["trace"]["theta"][name][0] == first["start"][name] == least.theta[name]
        assert found["starts"][1]["start"][name] != least.theta[name]


def test_it_makes_as_many_steps_a_sample_as_are_asked_for(client, ended, request_):
    """The oscillator's are exact: nothing changes, and results are at the samples."""
    _, request = request_
    more = request | {"options": request["options"] | {"substeps": 4}}
    plain, fine = (
        client.get(f"{url}/results").json()
        for url in (client.post("/jobs", json=one).headers["location"] for one in (request, more))
        if ended(client, url)["status"] == "successful"
    )
    for name, one in plain["estimate"].items():
        assert fine["estimate"][name]["value"] == pytest.approx(one["value"], rel=1e-4)
    assert fine["rmse"] == pytest.approx(plain["rmse"], rel=1e-4)
    (run,), (other,) = (one["simulation"]["series"] for one in (fine, plain))
    np.testing.assert_allclose(run["t"], other["t"], rtol=1e-12)
    assert "steps" not in plain["message"]


def test_steps_that_are_too_long_are_said_and_those_of_other_models_refused(client, ended):
    """Tanks that empty within a few steps."""
    request = {
        "kind": "simulate",
        "model": "tanks",
        "series": [{"u": [4.0] * 20, "dt": 40.0}],
        "options": {"mode": "free-run"},
    }
    url = client.post("/jobs", json=request).headers["location"]
    job = ended(client, url)
    assert "The model's steps are too long for these data" in job["message"]
    assert client.get(f"{url}/results").json()["message"] == job["message"]
    more = request | {"options": {"mode": "free-run", "substeps": 16}}
    finer = ended(client, client.post("/jobs", json=more).headers["location"])
    assert "with 2 steps a sample" not in finer["message"]
    other = more | {"model": "mixed-4", "series": [{"dt": 1.0}]}
    answer = client.post("/jobs", json=other | {"options": {"samples": 20, "substeps": 2}})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == "options.substeps"
