"""The same promises on a Dask cluster: a real scheduler and two worker processes."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def cluster(free_ports, tmp_path_factory):
    """Address of a scheduler with two workers of one thread each."""
    folder = tmp_path_factory.mktemp("dask")
    address = f"tcp://127.0.0.1:{free_ports()}"
    env = os.environ | {
        "DASK_DISTRIBUTED__WORKER__DAEMON": "False",
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0",
    }
    dask = [sys.executable, "-m", "dask"]
    commands = [
        [*dask, "scheduler", "--host", address, "--no-dashboard"],
        [*dask, "worker", address, "--nworkers", "2", "--nthreads", "1", "--no-dashboard",
         "--local-directory", str(folder), "--preload", "service.dask_runner"],
    ]  # fmt: skip
    log = (folder / "log").open("wb")
    processes = [subprocess.Popen(c, env=env, stdout=log, stderr=log) for c in commands]
    yield address
    for process in reversed(processes):
        process.send_signal(signal.SIGTERM)
        process.wait(20)
    log.close()


@pytest.fixture
def client(make_client, cluster, database):
    served = make_client(dask_scheduler=cluster, database_url=database, lease_seconds=5)
    runner = served.app.state.supervisor._runner
    end = time.monotonic() + 60
    while runner.free() < 2:
        assert time.monotonic() < end, "the workers did not come"
        time.sleep(0.1)
    return served


def attempts():
    """(process id, that of the Dask worker above it) of computing processes on this machine."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            pid, parent = int(stat.parent.name), int(stat.read_text().rpartition(")")[2].split()[1])
            if "forkserver" in Path(f"/proc/{parent}/cmdline").read_text():
                above = int(Path(f"/proc/{parent}/stat").read_text().rpartition(")")[2].split()[1])
                if "spawn_main" in Path(f"/proc/{above}/cmdline").read_text():
                    found.append((pid, above))
        except (FileNotFoundError, ProcessLookupError):
            pass
    return found


def test_estimate_cancel_and_a_killed_worker(client, estimation, long, wait, ended):
    request = estimation(particles=100, iterations=40, seed=9)
    url = client.post("/jobs", json=request).headers["location"]
    assert ended(client, url)["status"] == "successful"
    expected = client.get(f"{url}/trace").json()["theta"]
    assert attempts() == []

    url = client.post("/jobs", json=long).headers["location"]
    wait(client, url, lambda job: job["iteration"] >= 1)
    begin = time.monotonic()
    client.delete(url)
    while attempts():
        assert time.monotonic() - begin < 2.0
        time.sleep(0.02)

    url = client.post("/jobs", json=request).headers["location"]
    wait(client, url, lambda job: job["iteration"] >= 3)
    ((_, worker),) = attempts()
    os.kill(worker, signal.SIGKILL)
    job = wait(client, url, lambda job: "disappeared" in job["message"])
    job = ended(client, url)
    assert job["status"] == "successful", job["message"]
    assert client.get(f"{url}/trace").json()["theta"] == expected


def test_a_study_is_spread_over_the_workers(client, estimation, ended):
    request = estimation(method="rts-em", iterations=15, bootstrap=8)
    url = client.post("/jobs", json=request).headers["location"]
    seen = set()

    end = time.monotonic() + 60
    while client.get(url).json()["status"] in ("accepted", "running"):
        assert time.monotonic() < end
        seen.add(len({above for _, above in attempts()}))
        time.sleep(0.02)
    assert client.get(url).json()["status"] == "successful"
    assert max(seen) == 2
