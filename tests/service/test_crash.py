"""Killed workers and killed services: nothing lost, nothing twice, the same bits."""

import copy
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import httpx
import numpy as np
import pytest

import engine
from service.examples import EXAMPLES


@pytest.fixture
def request_(estimation):
    """Some seconds of iterations."""
    return estimation(particles=200, iterations=100, seed=9)


@pytest.fixture(scope="module")
def known():
    return []


@pytest.fixture
def expected(client, request_, ended, known):
    """The results of an attempt nobody disturbed."""
    if not known:
        url = client.post("/jobs", json=request_).headers["location"]
        ended(client, url)
        known.append(without_seconds(client.get(f"{url}/results").json()))
    return copy.deepcopy(known[0])


def without_seconds(results):
    del results["trace"]["seconds"], results["created"]
    return results


def test_a_killed_worker_is_replaced_and_goes_on(running, catch, wait, ended, request_, expected):
    service = running
    url, worker = catch(service, request_, iterations=5)
    os.kill(worker, signal.SIGKILL)
    job = wait(service.client, url, lambda job: "restart 1 of 2" in job["message"])
    assert "killed by signal 9" in job["message"]
    assert ended(service.client, url)["status"] == "successful"
    assert without_seconds(service.client.get(f"{url}/results").json()) == expected


@pytest.mark.slow
def test_what_the_quasi_newton_method_remembers_outlives_its_worker(
    running, catch, ended, request_, client
):
    request_["options"] |= {"method": "quasi-newton", "iterations": 12, "particles": 400}
    request_["series"] = [{"y": [[float(i % 7)] for i in range(300)]}]
    undisturbed = client.post("/jobs", json=request_).headers["location"]
    ended(client, undisturbed)
    expected = without_seconds(client.get(f"{undisturbed}/results").json())
    url, worker = catch(running, request_, iterations=4)
    os.kill(worker, signal.SIGKILL)
    assert ended(running.client, url)["status"] == "successful"
    assert without_seconds(running.client.get(f"{url}/results").json()) == expected


@pytest.mark.slow
def test_a_killed_service_leaves_no_worker_and_is_taken_up_again(
    spawn, catch, dead, eventually, ended, request_, expected
):
    service = spawn(lease_seconds=1)
    url, worker = catch(service, request_, iterations=5)
    done = service.client.get(url).json()["iteration"]
    service.stop(signal.SIGKILL)
    eventually(lambda: dead(worker))

    again = spawn(lease_seconds=1)
    assert again.client.get(url).json()["iteration"] >= done
    job = ended(again.client, url)
    assert job["status"] == "successful", job["message"]
    assert without_seconds(again.client.get(f"{url}/results").json()) == expected


@pytest.fixture
def diagnosis():
    """Some seconds of screens and refits."""
    model = engine.get_model("linear-2")
    y = engine.simulate(model, None, 300, np.random.default_rng(3)).y
    y[150:] += 4.0
    options = {"effects": ["step", "bias", "gain", "cubic", "drag", "latent", "pulse"], "seed": 1}
    series = [{"y": y.tolist(), "dt": 1.0}]
    return {"kind": "diagnose", "model": "linear-2", "series": series, "options": options}


def without_times(results):
    found = results["diagnosis"]
    del found["seconds"]
    found["page"] = [line for line in found["page"].splitlines() if " s in all: " not in line]
    return found


@pytest.mark.slow
def test_a_diagnosis_goes_on_with_what_a_killed_worker_had_finished(
    running, catch, wait, ended, diagnosis
):
    service = running
    url, worker = catch(service, diagnosis, iterations=31)  # per cent: refits of the first round
    os.kill(worker, signal.SIGKILL)
    wait(service.client, url, lambda job: "continues where it was (restart 1" in job["message"])
    job = ended(service.client, url)
    assert job["status"] == "successful", job["message"]
    log = (service.state / "log").read_text()
    kept = re.search(r"goes on with (\d+) finished parts", log)
    assert kept, log[-2000:]
    assert int(kept[1]) >= 3
    whole = service.client.post("/jobs", json=diagnosis).headers["location"]
    assert ended(service.client, whole)["status"] == "successful"
    results = [service.client.get(f"{one}/results").json() for one in (url, whole)]
    assert without_times(results[0]) == without_times(results[1])


@pytest.mark.slow
def test_a_design_goes_on_with_what_a_killed_worker_had_finished(running, catch, wait, ended):
    service, example = running, EXAMPLES["design"]["value"]
    long = {**example, "options": {**example["options"], "length": 150, "inputs": 160}}
    url, worker = catch(service, long, iterations=10)  # per cent: random inputs
    os.kill(worker, signal.SIGKILL)
    wait(service.client, url, lambda job: "continues where it was (restart 1" in job["message"])
    seen = []
    over = ("successful", "failed")
    job = wait(
        service.client,
        url,
        lambda job: seen.append(job["progress"]) or job["status"] in over,
        200.0,
    )
    assert job["status"] == "successful", job["message"]
    assert min(seen) >= 10
    kept = re.search(r"goes on with (\d+) finished parts", (service.state / "log").read_text())
    assert kept
    assert int(kept[1]) >= 3
    whole = service.client.post("/jobs", json=long).headers["location"]
    assert ended(service.client, whole)["status"] == "successful"
    one, other = (service.client.get(f"{job}/results").json()["design"] for job in (url, whole))
    assert one | {"seconds": 0.0} == other | {"seconds": 0.0}


def kill_worker(service, workers, eventually, dead):
    (worker,) = eventually(lambda: workers(service.process.pid))
    os.kill(worker, signal.SIGKILL)
    eventually(lambda: dead(worker))


def test_a_worker_that_always_dies_at_one_place_fails_the_job_and_it_can_be_resumed(
    running, workers, wait, ended, eventually, dead, long
):
    service = running
    long["options"]["particles"] = 10_000  # its first iteration does not end before it is killed
    url = service.client.post("/jobs", json=long).headers["location"]
    for restart in range(3):
        wait(
            service.client,
            url,
            lambda job, n=restart: (
                f"restart {n} " in job["message"] or (not n and job["status"] == "running")
            ),
        )
        kill_worker(service, workers, eventually, dead)
    job = ended(service.client, url)
    assert (job["status"], job["iteration"]) == ("failed", 0)
    assert "given up after 3 attempts" in job["message"]
    answer = service.client.get(f"{url}/results")
    assert (answer.status_code, answer.json()["title"]) == (500, "worker lost")
    assert {"href": f"{url}/resume", "rel": "resume", "title": ""} in job["links"]
    assert service.client.post(f"{url}/resume").json()["status"] in ("accepted", "running")
    wait(service.client, url, lambda job: job["status"] == "running")
    kill_worker(service, workers, eventually, dead)
    wait(service.client, url, lambda job: "restart 1 of 2" in job["message"])
    service.client.post(f"{url}/stop")


@pytest.mark.slow
def test_losses_with_progress_between_them_do_not_add_up(
    running, workers, wait, ended, eventually, dead, request_, expected
):
    """Five of them, where two are allowed at one place."""
    service = running
    url = service.client.post("/jobs", json=request_).headers["location"]
    reached = 7
    for _ in range(5):
        wait(service.client, url, lambda job, k=reached: job["iteration"] > k)
        kill_worker(service, workers, eventually, dead)
        job = wait(service.client, url, lambda job: "restart 1 of 2" in job["message"])
        reached = job["iteration"]
    job = ended(service.client, url)
    assert job["status"] == "successful", job["message"]
    assert without_seconds(service.client.get(f"{url}/results").json()) == expected
    assert service.client.get(f"{url}/tasks").json()["tasks"][0]["restarts"] == 5


@pytest.mark.slow
def test_a_stopped_job_goes_on_where_it_was(make_client, wait, ended, request_, expected):
    client = make_client(workers=1)
    url = client.post("/jobs", json=request_).headers["location"]
    wait(client, url, lambda job: job["iteration"] >= 10)
    stopped = client.post(f"{url}/stop").json()
    assert stopped["status"] == "dismissed"
    assert stopped["estimate"]["theta"] is not None
    reached = client.get(f"{url}/results").json()
    last = reached["trace"]["iteration"][-1]
    assert reached["outcome"] == "stopped"
    assert last >= 10
    assert reached["estimate"]["theta"]["value"] == reached["trace"]["theta"]["theta"][-1]
    assert reached["estimate"]["theta"]["standard_error"] is None
    assert f"after {last} of at most 100" in reached["message"]
    assert client.get(f"{url}/trace").json()["iteration"] == reached["trace"]["iteration"]
    assert client.get(f"{url}/request").status_code == 200
    assert client.get(f"{url}/report").status_code == 404

    assert client.post(f"{url}/resume").status_code == 200
    job = ended(client, url)
    assert job["status"] == "successful", job["message"]
    found = without_seconds(client.get(f"{url}/results").json())
    assert found == expected
    assert client.post(f"{url}/resume").status_code == 409

    assert client.delete(url).json()["status"] == "dismissed"
    assert client.get(f"{url}/trace").json()["iteration"] == []
    answer = client.post(f"{url}/resume")
    assert (answer.status_code, "its data are gone" in answer.json()["detail"]) == (409, True)
    assert client.post("/jobs/none/resume").status_code == 404


@pytest.mark.slow
def test_a_killed_forkserver_is_replaced(
    running, catch, ended, parent_of, dead, eventually, request_, expected
):
    service = running
    url, worker = catch(service, request_, iterations=3)
    os.kill(parent_of(worker), signal.SIGKILL)
    eventually(lambda: dead(worker))
    assert ended(service.client, url)["status"] == "successful"
    assert without_seconds(service.client.get(f"{url}/results").json()) == expected


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_a_forkserver_that_still_loads_goes_with_its_service(
    spawn, children_of, dead, eventually, how
):
    """Loading takes seconds, or on a new machine minutes; nothing is compiled for nobody."""
    service = spawn()
    below = eventually(lambda: children_of(service.process.pid))
    service.stop(how)
    eventually(lambda: all(dead(pid) for pid in below))


@pytest.mark.slow
def test_a_stopped_service_goes_on_where_it_was(spawn, catch, ended, dead, request_, expected):
    """SIGTERM without draining: the task goes back to the queue unharmed, no loss is counted."""
    service = spawn(lease_seconds=1000)
    url, worker = catch(service, request_, iterations=5)
    service.stop()
    assert dead(worker)
    again = spawn(lease_seconds=1000)
    job = ended(again.client, url)
    assert (job["status"], "restart" in job["message"]) == ("successful", False)
    assert "goes on after iteration" in (again.state / "log").read_text()
    assert without_seconds(again.client.get(f"{url}/results").json()) == expected


@pytest.mark.slow
def test_a_suspended_service_has_lost_nothing(spawn, catch, ended, request_, expected):
    """Its own clock went on without it, far beyond the time after which silence is a loss."""
    service = spawn(lease_seconds=1)
    url, worker = catch(service, request_, iterations=5)
    for pid in (service.process.pid, worker):
        os.kill(pid, signal.SIGSTOP)
    time.sleep(3.0)
    for pid in (service.process.pid, worker):
        os.kill(pid, signal.SIGCONT)
    job = ended(service.client, url)
    assert (job["status"], job["message"].count("restart")) == ("successful", 0)
    assert (service.state / "log").read_text().count("attempt started") == 1
    assert without_seconds(service.client.get(f"{url}/results").json()) == expected


@pytest.mark.slow
def test_memory_that_ends_is_taken_from_a_worker_first(running, catch, long):
    service = running
    url, worker = catch(service, long, iterations=1)
    scores = [
        int(Path(f"/proc/{pid}/oom_score_adj").read_text()) for pid in (service.process.pid, worker)
    ]
    assert scores[0] < scores[1]
    service.client.post(f"{url}/stop")


UNGUARDED = """
import uvicorn
from service.app import create_app
from service.logs import configure
from service.settings import Settings
configure()
settings = Settings.from_env()
uvicorn.run(create_app(settings), port=settings.port, log_config=None)
"""


@pytest.mark.slow
def test_a_script_without_a_main_guard_is_told_so(tmp_path, free_ports, ended, eventually):
    script, port = tmp_path / "serve.py", free_ports()
    script.write_text(UNGUARDED)
    env = {
        "RBPS_STATE_DIR": tmp_path,
        "RBPS_PORT": port,
        "RBPS_WORKERS": 1,
        "RBPS_LOSSES_ALLOWED": 0,
    }
    with (tmp_path / "log").open("wb") as log:
        path = os.pathsep.join(sys.path)  # a script's own folder takes the place of this one
        served = subprocess.Popen(
            [sys.executable, script],
            env=os.environ | {"PYTHONPATH": path} | {k: str(v) for k, v in env.items()},
            stderr=log,
        )
    client = httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60)

    def answers():
        try:
            return client.get("/livez").status_code == 200
        except httpx.TransportError:
            return False

    try:
        eventually(answers)
        request = {"kind": "simulate", "model": "linear-2", "options": {"samples": 5}}
        job = ended(client, client.post("/jobs", json=request).headers["location"])
    finally:
        client.close()
        served.terminate()
        served.wait(120)
    assert job["status"] == "failed"
    assert "belong under `if __name__ == '__main__':`" in job["message"]
    lines = [
        json.loads(one) for one in (tmp_path / "log").read_text().splitlines() if one[0] == "{"
    ]
    assert any(one["message"].startswith("no job will be computed") for one in lines)


def test_run_time_is_limited(make_client, long, ended):
    client = make_client(run_seconds=0.5)
    url = client.post("/jobs", json=long).headers["location"]
    job = ended(client, url)
    assert (job["status"], "longer than the 0.5 s" in job["message"]) == ("failed", True)
