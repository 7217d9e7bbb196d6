"""Killed workers and killed services: nothing lost, nothing twice, the same bits."""

import os
import signal
import time
from pathlib import Path

import pytest


@pytest.fixture
def request_(estimation):
    """About two seconds of iterations."""
    return estimation(particles=100, iterations=60, seed=9)


@pytest.fixture
def expected(client, request_, ended):
    """The results of an attempt nobody disturbed."""
    url = client.post("/jobs", json=request_).headers["location"]
    ended(client, url)
    return without_seconds(client.get(f"{url}/results").json())


def without_seconds(results):
    del results["trace"]["seconds"]
    return results


def gone(pid):
    """No such process, or one that is dead and only waits for its parent to notice."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    except FileNotFoundError:
        return True


def test_a_killed_worker_is_replaced_and_goes_on(spawn, workers, wait, ended, request_, expected):
    service = spawn()
    url = service.client.post("/jobs", json=request_).headers["location"]
    wait(service.client, url, lambda job: job["iteration"] >= 5)
    (worker,) = workers(service.process.pid)
    os.kill(worker, signal.SIGKILL)
    job = wait(service.client, url, lambda job: "restart 1 of 2" in job["message"])
    assert "killed by signal 9" in job["message"]
    assert ended(service.client, url)["status"] == "successful"
    assert without_seconds(service.client.get(f"{url}/results").json()) == expected


def test_a_killed_service_leaves_no_worker_and_is_taken_up_again(
    spawn, workers, wait, ended, request_, expected
):
    service = spawn(lease_seconds=1)
    url = service.client.post("/jobs", json=request_).headers["location"]
    done = wait(service.client, url, lambda job: job["iteration"] >= 5)["iteration"]
    (worker,) = workers(service.process.pid)
    service.stop(signal.SIGKILL)
    end = time.monotonic() + 2.0
    while not gone(worker):
        assert time.monotonic() < end
        time.sleep(0.01)

    again = spawn(lease_seconds=1)
    assert again.client.get(url).json()["iteration"] >= done
    job = ended(again.client, url)
    assert job["status"] == "successful", job["message"]
    assert without_seconds(again.client.get(f"{url}/results").json()) == expected


def test_a_worker_that_always_dies_fails_the_job(spawn, workers, wait, ended, long):
    service = spawn()
    url = service.client.post("/jobs", json=long).headers["location"]
    wait(service.client, url, lambda job: job["iteration"] >= 1)
    for restart in range(3):
        wait(service.client, url, lambda job, n=restart: f"restart {n} " in job["message"] or not n)
        end = time.monotonic() + 10
        while not (found := workers(service.process.pid)):
            assert time.monotonic() < end
            time.sleep(0.01)
        os.kill(found[0], signal.SIGKILL)
    job = ended(service.client, url)
    assert job["status"] == "failed"
    assert "given up after 3 attempts" in job["message"]
    answer = service.client.get(f"{url}/results")
    assert (answer.status_code, answer.json()["title"]) == (500, "worker lost")


def test_a_killed_forkserver_is_replaced(spawn, workers, wait, ended, request_, expected):
    service = spawn()
    url = service.client.post("/jobs", json=request_).headers["location"]
    wait(service.client, url, lambda job: job["iteration"] >= 3)
    (worker,) = workers(service.process.pid)
    parent = int(Path(f"/proc/{worker}/stat").read_text().rpartition(")")[2].split()[1])
    os.kill(parent, signal.SIGKILL)
    assert ended(service.client, url)["status"] == "successful"
    assert without_seconds(service.client.get(f"{url}/results").json()) == expected
    assert gone(worker)


def test_run_time_is_limited(make_client, long, ended):
    client = make_client(run_seconds=0.5)
    url = client.post("/jobs", json=long).headers["location"]
    job = ended(client, url)
    assert (job["status"], "longer than the 0.5 s" in job["message"]) == ("failed", True)
