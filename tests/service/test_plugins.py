"""Models of users' own packages: registered, broken, and misbehaving while they compute."""

import os
import resource
import sys

import pytest

MODELS = """
import os, signal, time
import numpy as np
from engine import Gaussian, MixedModel, Parameter

def dynamics(a, u, t, dt, theta):
    if theta.fault == 1:
        raise ZeroDivisionError("the valve is shut")
    if theta.fault == 2:
        return [np.full(len(a), np.nan)], np.zeros((1, 0)), [[0.1]]
    if theta.fault == 3:
        while True:
            time.sleep(0.01)
    if theta.fault == 4:
        hoard = []
        while True:
            hoard.append(np.empty(40_000_000))
    if theta.fault == 5:
        os.kill(os.getpid(), signal.SIGKILL)
    return [0.9 * a[:, 0]], np.zeros((1, 0)), [[0.1]]

def measurement(a, u, t, theta):
    return [a[:, 0]], np.zeros((1, 0)), [[0.1]]

def initial(theta):
    return Gaussian([0.0], [[1.0]]), np.zeros(0), np.zeros((0, 0))

VALVE = MixedModel(
    name="valve", dynamics=dynamics, measurement=measurement, initial=initial,
    outputs={"y": "V"}, nonlinear={"a": "V"}, parameters=[Parameter("fault", 0.0)],
)
"""
ENTRIES = """[engine.models]
valve = laboratory:VALVE
gone = laboratory:MISSING
quits = quitting:MODEL
"""
REQUEST = {"kind": "smooth", "model": "valve", "series": [{"y": [[0.0], [0.1], [0.2], [0.1]]}]}


@pytest.fixture
def service(spawn, tmp_path):
    """A service beside which a user's package with a good and a broken model is installed."""
    site = tmp_path / "site"
    info = site / "laboratory-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "laboratory.py").write_text(MODELS)
    (site / "quitting.py").write_text("raise SystemExit('no licence')")
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: laboratory\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRIES)
    path = os.pathsep.join([str(site), *sys.path])
    return spawn({"PYTHONPATH": path}, worker_memory=3 << 30, run_seconds=6.0)


@pytest.mark.slow
def test_good_and_broken_and_misbehaving_models(service, workers, dead, ended, eventually, wait):
    client = service.client
    models = client.get("/models").json()
    assert "valve" in {model["name"] for model in models["models"]}
    assert "MISSING" in models["broken_plugins"]["gone"]
    assert models["broken_plugins"]["quits"] == "SystemExit: no licence"
    faults = {
        0: ("successful", ""),
        1: ("failed", "ZeroDivisionError: the valve is shut (laboratory.py, line 8, in dynamics"),
        2: ("failed", "finite"),
        3: ("failed", "longer than the 6 s"),
        4: ("failed", "memory"),
        5: ("failed", "killed by signal 9"),
    }
    urls = []
    for fault in faults:
        request = REQUEST | {"parameters": {"values": {"fault": float(fault)}}}
        urls.append(client.post("/jobs", json=request).headers["location"])
    for url, (status, words) in zip(urls, faults.values(), strict=True):
        job = ended(client, url)
        assert job["status"] == status, job["message"]
        assert words in job["message"]
        if status == "failed":
            problem = client.get(f"{url}/results")
            assert problem.status_code in (422, 500)
            assert problem.json()["detail"] == job["message"]

    # what never returns is cancelled all the same
    request = REQUEST | {"parameters": {"values": {"fault": 3.0}}}
    url = client.post("/jobs", json=request).headers["location"]
    wait(client, url, lambda job: job["status"] == "running")
    (worker,) = eventually(lambda: workers(service.process.pid))
    assert client.post(f"{url}/stop").json()["status"] == "dismissed"
    eventually(lambda: dead(worker))

    causes = client.get("/metrics").text
    assert 'rbps_failures_total{cause="computation-failed"}' in causes
    assert 'rbps_failures_total{cause="worker-lost"} 1' in causes


def limit(pids, size):
    """A limit on the size of files stands for a full disk; 0 takes it away again."""
    for pid in pids:
        most = resource.prlimit(pid, resource.RLIMIT_FSIZE)[1]
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (size or most, most))


@pytest.mark.slow
def test_a_full_disk(spawn, catch, dead, estimation, ended, eventually):
    """With room again all goes on."""
    service = spawn(lease_seconds=2, losses_allowed=100)
    client = service.client
    url, worker = catch(service, estimation(particles=100, iterations=80), iterations=1)
    limit([service.process.pid, worker], 4096)
    answer = client.post("/jobs", json=estimation())
    assert (answer.status_code, answer.json()["title"]) == (503, "store unavailable")
    assert client.get("/readyz").status_code == 503
    assert client.get("/livez").status_code == 200
    assert client.get(url).status_code == 200
    eventually(lambda: dead(worker))  # it could not write, and nobody could write about it
    limit([service.process.pid], 0)
    eventually(lambda: client.get("/readyz").status_code == 200)  # tried every few seconds
    job = ended(client, url)
    assert job["status"] == "successful"
    assert ended(client, client.post("/jobs", json=estimation()).headers["location"])


@pytest.mark.slow
def test_a_disk_that_stays_full_for_the_worker(spawn, catch, long, ended):
    """Its log, with what Python keeps of it until the end, is on the same disk."""
    service = spawn({"PYTHONUNBUFFERED": ""}, losses_allowed=0)
    url, worker = catch(service, long, iterations=1)
    limit([worker], 1)
    job = ended(service.client, url)
    assert job["status"] == "failed"
    assert "the store could not be written (its disk may be full)" in job["message"]
    problem = service.client.get(f"{url}/results").json()
    assert problem["detail"] == job["message"]


@pytest.mark.long
def test_an_unwritable_state_directory_is_said(tmp_path):
    import subprocess

    (tmp_path / "file").write_text("")
    env = os.environ | {"RBPS_STATE_DIR": str(tmp_path / "file" / "state")}
    done = subprocess.run(
        [sys.executable, "-m", "service"], env=env, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 1
    assert done.stderr.startswith("rbps: ")
    assert str(tmp_path / "file") in done.stderr
