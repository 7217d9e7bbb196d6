"""Every documented call, on the real application with real worker processes."""

import os
from itertools import pairwise
from pathlib import Path

import pytest

FIELDS = {
    "jobID", "kind", "model", "status", "progress", "iteration", "iterations", "created", "started",
    "updated", "finished", "stage", "estimated_end", "message", "estimate", "log_likelihood", "links",
    "name", "tags", "data", "outcome", "cause", "causes", "values",
}  # fmt: skip


@pytest.mark.long
def test_estimate_from_post_to_results(client, estimation, ended):
    answer = client.post("/jobs", json=estimation())
    assert answer.status_code == 201
    assert answer.headers["location"] == f"/jobs/{answer.json()['jobID']}"
    assert set(answer.json()) == FIELDS
    assert answer.json()["status"] in ("accepted", "running")

    url = answer.headers["location"]
    job = ended(client, url)
    assert (job["status"], job["progress"], job["iteration"]) == ("successful", 100, 5)
    assert job["created"] <= job["started"] <= job["finished"] == job["updated"]

    found = client.get(f"{url}/results").json()
    assert found["outcome"] == "iterations-used-up"
    assert set(found["estimate"]) == {"theta"}
    assert found["estimate"]["theta"]["unit"] == "1"
    trace = client.get(f"{url}/trace").json()
    assert trace == found["trace"]
    assert trace["iteration"] == [0, 1, 2, 3, 4, 5]
    assert trace["theta"]["theta"][0] == 0.3
    assert trace["theta"]["theta"][-1] == found["estimate"]["theta"]["value"]
    assert trace["log_likelihood"][0] is None
    assert all(x < 0 for x in trace["log_likelihood"][1:])
    states = found["states"]["series"][0]
    assert set(states["mean"]) == set(states["standard_deviation"]) == {"a", "z"}
    assert len(states["t"]) == len(states["mean"]["z"]) == 60
    assert client.get(f"{url}/trace?after=3").json()["iteration"] == [4, 5]


@pytest.mark.parametrize(
    ("method", "engines"), [("quasi-newton", {}), ("rbps-em", {"method": "em"})]
)
def test_the_service_computes_what_the_engine_computes(
    client, estimation, ended, data, method, engines
):
    import engine

    found = engine.rbps_em(
        engine.get_model("linear-2"), engine.Series(data), {"theta": 0.3}, ["theta"], 20,
        n_iterations=5, seed=1, **engines,
    )  # fmt: skip
    url = client.post("/jobs", json=estimation(method=method)).headers["location"]
    ended(client, url)
    trace = client.get(f"{url}/trace").json()
    assert trace["theta"]["theta"] == found.trace[:, 0].tolist()
    assert trace["log_likelihood"][1:] == found.log_likelihood.tolist()


@pytest.mark.slow
def test_exact_em_of_several_series_with_missing_values(client, estimation, ended, data):
    request = estimation(method="rts-em", iterations=60)
    gaps = [[None] if 10 <= i < 14 else row for i, row in enumerate(data)]
    request["series"] = [{"y": data, "dt": 1.0}, {"y": gaps}]
    url = client.post("/jobs", json=request).headers["location"]
    assert ended(client, url)["status"] == "successful"
    found = client.get(f"{url}/results").json()
    assert found["log_likelihood"]["standard_error"] == 0.0
    assert len(found["states"]["series"]) == 2
    std = found["states"]["series"][1]["standard_deviation"]["a"]
    assert max(std[10:14]) > 1.3 * std[5]


def test_smooth_agrees_with_the_kalman_smoother(client, ended, data):
    import engine

    request = {
        "kind": "smooth", "model": {"name": "linear-2", "with": []}, "series": [{"y": data}],
        "parameters": {"values": {"theta": 0.2}}, "options": {"particles": 400, "seed": 2},
    }  # fmt: skip
    url = client.post("/jobs", json=request).headers["location"]
    assert ended(client, url)["status"] == "successful"
    found = client.get(f"{url}/results").json()
    exact = engine.kalman_smoother(
        engine.get_model("linear-2"), {"theta": 0.2}, engine.Series(data)
    )
    mean = found["states"]["series"][0]["mean"]
    assert mean["a"] == pytest.approx(exact.x[:, 0], abs=0.15)
    assert found["log_likelihood"]["value"] == pytest.approx(exact.log_likelihood, abs=1.0)


def test_simulate_draws_and_free_run(client, ended):
    request = {
        "kind": "simulate", "model": "linear-2", "options": {"samples": 30, "seed": 3},
    }  # fmt: skip
    runs = []
    for _ in range(2):
        url = client.post("/jobs", json=request).headers["location"]
        assert ended(client, url)["status"] == "successful"
        runs.append(client.get(f"{url}/results").json()["simulation"])
    assert runs[0] == runs[1]
    assert len(runs[0]["series"][0]["y"]["y"]) == 30

    request |= {"series": [{"y": [[1.0], [None], [2.0]]}], "options": {"mode": "free-run"}}
    url = client.post("/jobs", json=request).headers["location"]
    assert ended(client, url)["status"] == "successful"
    free = client.get(f"{url}/results").json()["simulation"]["series"][0]
    assert free["y"]["y"] == pytest.approx([0.0, 0.1, 0.2])
    assert free["rmse"] == pytest.approx(((1.0 + 1.8**2) / 2) ** 0.5)


@pytest.mark.long
def test_results_before_the_end_cancel_and_list(client, long, wait, eventually):
    url = client.post("/jobs", json=long).headers["location"]
    early = client.get(f"{url}/results")
    assert early.status_code == 404
    assert early.headers["content-type"] == "application/problem+json"
    assert early.json()["type"].endswith("/result-not-ready")
    running = wait(client, url, lambda job: job["iteration"] >= 2)
    assert running["status"] == "running"
    assert running["estimate"]["theta"] is not None
    assert running["estimated_end"] > running["updated"]

    assert f"{url}/stop" in [link["href"] for link in running["links"] if link["rel"] == "stop"]
    answer = client.delete(url)
    assert (answer.status_code, answer.json()["status"]) == (200, "dismissed")
    for _ in range(2):  # the first answer may have been lost on its way
        answer = client.post(f"{url}/stop")
        assert (answer.status_code, answer.json()["status"]) == (200, "dismissed")
    eventually(lambda: not client.app.state.supervisor.running())
    assert client.get(f"{url}/results").json()["outcome"] == "stopped"
    assert client.delete(url).json()["status"] == "dismissed"
    assert client.get(f"{url}/results").status_code == 404
    listed = client.get("/jobs?status=dismissed").json()["jobs"]
    assert [job["jobID"] for job in listed] == [url.removeprefix("/jobs/")]


def test_a_stop_that_comes_after_the_end_changes_nothing(client, estimation, ended):
    url = client.post("/jobs", json=estimation()).headers["location"]
    before = ended(client, url)
    results = client.get(f"{url}/results").json()
    answer = client.post(f"{url}/stop")
    assert (answer.status_code, answer.json()) == (200, before)
    assert client.get(f"{url}/results").json() == results
    for _ in range(2):
        assert "removed by the client" in client.delete(url).json()["message"]
    assert client.get(f"{url}/results").status_code == 404


def test_list_pages_newest_first(client, estimation, ended):
    made = [client.post("/jobs", json=estimation(iterations=1)).json()["jobID"] for _ in range(3)]
    listed, url = [], "/jobs?limit=2&model=linear-2"
    while url:
        page = client.get(url).json()
        listed += [job["jobID"] for job in page["jobs"]]
        url = next((link["href"] for link in page["links"] if link["rel"] == "next"), None)
    assert listed[:3] == made[::-1]
    assert len(set(listed)) == len(listed) > 3
    assert client.get("/jobs?model=nothing").json()["jobs"] == []
    for job in made:
        ended(client, f"/jobs/{job}")


@pytest.mark.long
def test_queue_is_first_in_first_out(make_client, estimation, ended):
    client = make_client(workers=1)
    urls = [client.post("/jobs", json=estimation(seed=i)).headers["location"] for i in range(5)]
    jobs = [ended(client, url) for url in urls]
    started = [job["started"] for job in jobs]
    assert started == sorted(started)
    assert all(a["finished"] <= b["started"] for a, b in pairwise(jobs))


def test_a_computation_that_fails_tells_why(client, ended):
    request = {
        "kind": "simulate", "model": "mixed-4", "options": {"mode": "stochastic", "samples": 5000},
        "parameters": {"values": {"theta_4": 1.2}},
    }  # fmt: skip
    url = client.post("/jobs", json=request).headers["location"]
    job = ended(client, url)
    assert job["status"] == "failed"
    answer = client.get(f"{url}/results")
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert "runs away" in answer.json()["detail"] == job["message"]


@pytest.mark.slow
def test_all_jobs_survive_a_restart(make_client, estimation, long, ended, wait):
    client = make_client(workers=1)
    done = client.post("/jobs", json=estimation()).headers["location"]
    ended(client, done)
    before = client.get(f"{done}/results").json()
    blocking = client.post("/jobs", json=long).headers["location"]
    there = wait(client, blocking, lambda job: job["iteration"] >= 1)["iteration"]
    waiting = client.post("/jobs", json=estimation(seed=2)).headers["location"]
    client.stop()

    again = make_client(workers=1)
    assert again.get(f"{done}/results").json() == before
    assert again.get(done).json()["status"] == "successful"
    assert again.get(waiting).json()["status"] == "accepted"
    wait(again, blocking, lambda job: job["iteration"] > there)
    again.post(f"{blocking}/stop")
    assert ended(again, waiting)["status"] == "successful"


def test_models(client):
    found = client.get("/models").json()
    assert found["broken_plugins"] == {}
    assert {"linear-2", "mixed-4", "local-level", "servo", "tanks"} <= {
        model["name"] for model in found["models"]
    }
    tanks = client.get("/models/tanks").json()
    assert tanks in found["models"]
    assert tanks["parameters"][0]["name"]
    assert client.get("/models/none").status_code == 404
    for model in found["models"]:
        request = model["example"] | {"options": {"particles": 10, "iterations": 1}}
        answer = client.post("/jobs", json=request)
        assert answer.status_code == 201, answer.text
        client.post(f"{answer.headers['location']}/stop")


def test_service_document_and_livez(client):
    links = {link["rel"]: link["href"] for link in client.get("/").json()["links"]}
    for href in links.values():
        assert client.get(href).status_code == 200
    assert client.get("/livez").json() == {"status": "alive"}


@pytest.mark.slow
def test_a_fresh_service_starts_warm(spawn, catch, long):
    """Its first worker has the engine loaded and compiled: it computes for little more than itself."""
    long["options"]["particles"] = 100
    url, worker = catch(spawn(), long, iterations=1)
    assert url
    fields = Path(f"/proc/{worker}/stat").read_text().rpartition(")")[2].split()
    used = sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")  # s of the processor, so far
    assert used < 2.0  # to load takes as long, to compile ten times


@pytest.mark.slow
def test_estimates_are_there_before_their_standard_errors_and_stay_when_stopped(
    running, estimation, wait, ended
):
    """The errors of this one take far longer than its only iteration."""
    client = running.client
    request = estimation(iterations=1, standard_errors=True, particles=2)
    request["series"] = [{"y": [[float(i % 7)] for i in range(6_000)]}]
    url = client.post("/jobs", json=request).headers["location"]
    job = wait(client, url, lambda job: any(link["rel"] == "results" for link in job["links"]))
    assert job["status"] == "running"
    found = client.get(f"{url}/results").json()
    assert found["estimate"]["theta"]["standard_error"] is None
    assert found["estimate"]["theta"]["value"] == job["estimate"]["theta"]
    assert "not there yet" in found["message"]
    assert client.get(f"{url}/report").status_code == 200
    assert client.post(f"{url}/stop").json()["status"] == "dismissed"
    stopped = client.get(f"{url}/results").json()
    assert stopped == found
    assert client.get(url).json()["links"] != []


def test_with_its_standard_errors_a_result_replaces_the_one_without(client, estimation, ended):
    url = client.post("/jobs", json=estimation(standard_errors=True)).headers["location"]
    assert ended(client, url)["status"] == "successful"
    found = client.get(f"{url}/results").json()
    assert found["estimate"]["theta"]["standard_error"] > 0.0
    assert "not there yet" not in found["message"]


def test_readings_that_do_not_tell_the_parameters_are_refused_at_once(client, estimation):
    request = estimation()
    request |= {"model": "local-level", "series": [{"y": [[1.0], [2.0], [0.5]], "dt": 1.0}]}
    request["parameters"] = {"start": {}, "free": ["q", "r", "level"]}
    answer = client.post("/jobs", json=request)
    assert answer.status_code == 422
    assert "3 readings do not tell 3 parameters" in answer.text
