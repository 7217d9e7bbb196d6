"""The same promises on a Dask cluster: a real scheduler and two worker processes."""

import os
import shutil
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from service.settings import Settings

pytestmark = pytest.mark.skipif(not find_spec("distributed"), reason="Dask is not installed")


class Cluster:
    """A scheduler and two worker processes of one thread each."""

    def __init__(self, folder, port, protocol="tcp", environment=None):
        self.address, self.folder = f"{protocol}://127.0.0.1:{port}", folder
        self.environment = environment or {}
        self.start()

    def start(self):
        env = (
            os.environ
            | self.environment
            | {
                "DASK_DISTRIBUTED__WORKER__DAEMON": "False",
                "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0",
            }
        )
        dask = [sys.executable, "-m", "dask"]
        commands = [
            [*dask, "scheduler", "--host", self.address, "--no-dashboard"],
            [*dask, "worker", self.address, "--nworkers", "2", "--nthreads", "1", "--no-dashboard",
             "--local-directory", str(self.folder), "--preload", "service.dask_runner"],
        ]  # fmt: skip
        with (self.folder / "log").open("ab") as log:
            self.processes = [
                subprocess.Popen(c, env=env, stdout=log, stderr=log) for c in commands
            ]

    def stop(self, how=signal.SIGTERM):
        for process in reversed(self.processes):
            process.send_signal(how)
            process.wait(120)


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.slow)])
def database(request, empty_database):
    """Of the two kinds, both of which test_store has in every run."""
    return empty_database(request.param)


@pytest.fixture(scope="module")
def cluster(free_ports, tmp_path_factory):
    made = Cluster(tmp_path_factory.mktemp("dask"), free_ports())
    yield made
    made.stop()


@pytest.fixture
def attempts(cluster, workers, children_of):
    """{Dask worker's process id: those of what it computes} where it computes anything."""

    def look():
        found = {pid: workers(pid) for pid in children_of(cluster.processes[1].pid)}
        return {pid: computing for pid, computing in found.items() if computing}

    return look


@pytest.fixture
def client(make_client, cluster, database, eventually):
    served = make_client(dask_scheduler=cluster.address, database_url=database, lease_seconds=5)
    eventually(lambda: served.app.state.supervisor.capacity() == 2)
    return served


@pytest.mark.slow
def test_estimate_cancel_and_a_killed_worker(
    client, attempts, estimation, long, wait, ended, eventually
):
    request = estimation(particles=100, iterations=40, seed=9)
    url = client.post("/jobs", json=request).headers["location"]
    assert ended(client, url)["status"] == "successful"
    expected = client.get(f"{url}/trace").json()["theta"]
    eventually(lambda: not attempts())

    url = client.post("/jobs", json=long).headers["location"]
    wait(client, url, lambda job: job["iteration"] >= 1)
    assert len(attempts()) == 1
    client.post(f"{url}/stop")
    eventually(lambda: not attempts())

    for _ in range(10):  # until one is caught while it computes
        url = client.post("/jobs", json=request).headers["location"]
        wait(client, url, lambda job: job["iteration"] >= 3)
        if caught := list(attempts()):
            os.kill(caught[0], signal.SIGKILL)
            break
        ended(client, url)
    job = wait(client, url, lambda job: "disappeared" in job["message"])
    job = ended(client, url)
    assert job["status"] == "successful", job["message"]
    assert client.get(f"{url}/trace").json()["theta"] == expected


@pytest.fixture
def front(spawn, cluster, database, eventually):
    """Starts a service of the cluster as a process of its own."""

    def start(**more):
        there = {"dask_scheduler": cluster.address, "database_url": database}
        service = spawn(**(there | more))
        eventually(lambda: "rbps_workers 2" in service.client.get("/metrics").text)
        return service

    return start


@pytest.mark.slow
def test_a_killed_computation_and_a_killed_service(front, attempts, estimation, wait, ended):
    """The computation starts again where it was; that of a service that died goes on without it."""
    service = front(lease_seconds=5)
    request = estimation(particles=100, iterations=150, seed=9)

    def submitted():
        url = service.client.post("/jobs", json=request).headers["location"]
        wait(service.client, url, lambda job: job["iteration"] >= 3)
        return url

    def trace(url):
        return service.client.get(f"{url}/trace").json()["theta"]

    url = submitted()
    assert ended(service.client, url)["status"] == "successful"
    expected = trace(url)

    url = submitted()
    ((computation,),) = attempts().values()
    os.kill(computation, signal.SIGKILL)
    job = wait(service.client, url, lambda job: "killed by signal 9" in job["message"])
    job = ended(service.client, url)
    assert (job["status"], trace(url)) == ("successful", expected), job["message"]

    url = submitted()
    before = attempts()
    service.stop(signal.SIGKILL)
    assert attempts() == before
    service = front(lease_seconds=5)
    job = ended(service.client, url)
    assert (job["status"], trace(url)) == ("successful", expected), job["message"]
    assert "restart" not in job["message"]


@pytest.mark.slow
def test_workers_that_another_service_uses_are_not_free(
    front, attempts, estimation, long, wait, ended, eventually
):
    """What it left running after a kill has its places; other jobs wait and lose nothing."""
    service = front(lease_seconds=2)
    running = [service.client.post("/jobs", json=long).headers["location"] for _ in range(2)]
    for url in running:
        wait(service.client, url, lambda job: job["iteration"] >= 1)
    before = attempts()
    service.stop(signal.SIGKILL)
    service = front(lease_seconds=2, losses_allowed=0)
    waiting = service.client.post("/jobs", json=estimation()).headers["location"]
    time.sleep(6.0)
    assert service.client.get(waiting).json()["status"] == "accepted"
    assert attempts() == before
    for url in running:
        assert service.client.post(f"{url}/stop").json()["status"] == "dismissed"
    job = ended(service.client, waiting)
    assert job["status"] == "successful", job["message"]


@pytest.mark.slow
def test_members_of_a_cluster_show_certificates(
    spawn, free_ports, tmp_path, eventually, estimation, ended
):
    """With the settings of compose.yaml: who has none is turned away."""
    if not shutil.which("openssl"):
        pytest.skip("openssl is not installed; it makes the certificates")
    docker = Path(__file__).parents[2] / "docker"
    folder = tmp_path / "tls"
    folder.mkdir()
    subprocess.run(["sh", docker / "certificates", folder], check=True)
    settings = yaml.safe_load((docker / "compose.yaml").read_text())["x-tls"]
    tls = {name: value.replace("/tls/", f"{folder}/") for name, value in settings.items()}
    cluster = Cluster(tmp_path, free_ports(), "tls", tls)
    try:
        service = spawn(environment=tls, dask_scheduler=cluster.address)
        eventually(lambda: "rbps_workers 2" in service.client.get("/metrics").text)
        url = service.client.post("/jobs", json=estimation()).headers["location"]
        assert ended(service.client, url)["status"] == "successful"
        for address in (cluster.address, cluster.address.replace("tls:", "tcp:")):
            stranger = f"import distributed; distributed.Client({address!r}, timeout=5)"
            assert subprocess.run(
                [sys.executable, "-c", stranger], capture_output=True, check=False
            ).returncode
        service.stop()
    finally:
        cluster.stop()


@pytest.mark.long
def test_what_ends_after_the_service_has_stopped_is_let_alone(store):
    from service.dask_runner import DaskRunner  # which takes a second to load

    runner = DaskRunner(store, Settings(dask_scheduler="tcp://nowhere"), lambda: None)
    store.create("estimate", "linear-2", {}, 10)
    attempt = store.claim("a")
    runner.stop(drain=True)
    runner._done(attempt, SimpleNamespace(status="cancelled"))
    assert store.holds(attempt)


@pytest.mark.slow
def test_a_study_is_spread_over_the_workers(client, attempts, estimation, ended):
    request = estimation(method="rts-em", iterations=15, bootstrap=8)
    url = client.post("/jobs", json=request).headers["location"]
    seen = set()
    while client.get(url).json()["status"] in ("accepted", "running"):
        seen.add(len(attempts()))
        time.sleep(0.02)  # or this loop takes the time of the computation
    assert ended(client, url)["status"] == "successful"
    assert max(seen) == 2


@pytest.mark.slow
def test_a_scheduler_that_is_gone_and_comes_back(
    client, cluster, attempts, estimation, long, wait, ended, eventually
):
    assert client.get("/readyz").status_code == 200
    assert "rbps_workers 2" in client.get("/metrics").text
    url = client.post("/jobs", json=long).headers["location"]
    wait(client, url, lambda job: job["iteration"] >= 1)
    cluster.stop(signal.SIGKILL)
    eventually(lambda: client.get("/readyz").status_code == 503)
    waiting = client.post("/jobs", json=estimation()).headers["location"]
    cluster.start()
    eventually(lambda: client.get("/readyz").status_code == 200)
    before = client.get(url).json()["iteration"]
    wait(client, url, lambda job: job["iteration"] > before)
    client.post(f"{url}/stop")
    assert ended(client, waiting)["status"] == "successful"
