"""A service with its own store: in this process (client) or as a process of its own (spawned)."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import anyio
import httpx
import numpy as np
import pytest
import uvicorn

import engine
from service.app import create_app
from service.db_schema import metadata
from service.server import server_config
from service.settings import Settings
from service.store import Store
from tests.patience import eventually

# Loaded when first used, which would be in a server's thread; there Python 3.11 may fail to parse it.
OPEN_FILE = anyio.open_file

ENDED = ("successful", "failed", "dismissed")


def wait_for(client: Any, url: str, until: Callable[[dict], bool], seconds: float = 120.0) -> dict:
    """The job's status document as soon as ``until`` holds for it."""
    seen: dict = {}

    def look() -> dict | None:
        seen.update(client.get(url).json())
        return seen if until(seen) else None

    try:
        return eventually(look, seconds)
    except AssertionError as error:
        raise AssertionError(f"{error}: {seen}") from None


@pytest.fixture(scope="session", name="eventually")
def eventually_() -> Callable[..., Any]:
    return eventually


@pytest.fixture
def wait() -> Callable[..., dict]:
    return wait_for


@pytest.fixture
def ended() -> Callable[..., dict]:
    return lambda client, url, seconds=120.0: wait_for(
        client, url, lambda job: job["status"] in ENDED, seconds
    )


@pytest.fixture(scope="session")
def data() -> list[list[float]]:
    """60 samples of linear-2 at theta = 0.1."""
    model = engine.get_model("linear-2")
    return engine.simulate(model, None, 60, np.random.default_rng(5)).y.tolist()


@pytest.fixture
def estimation(data: list[list[float]]) -> Callable[..., dict[str, Any]]:
    """A request; keyword arguments change its options."""

    def make(**options: Any) -> dict[str, Any]:
        return {
            "kind": "estimate",
            "model": "linear-2",
            "series": [{"y": data, "dt": 1.0}],
            "parameters": {"start": {"theta": 0.3}, "free": ["theta"]},
            "options": {"method": "rbps-em", "particles": 20, "iterations": 5, "seed": 1}
            | {"standard_errors": False}
            | options,
        }

    return make


@pytest.fixture
def long(estimation: Callable[..., dict[str, Any]], data: list[list[float]]) -> dict[str, Any]:
    """A request that computes far longer than any test waits: 40 slow iterations at least.

    Of few samples and many particles, for the search for a start takes longer the more samples there are.
    """
    request = estimation(particles=350, iterations=10_000)
    request["series"] = [{"y": 5 * data}]
    return request


class Served(httpx.Client):
    """The application on a loopback port, in a thread of this process; a client of it."""

    def __init__(self, settings: Settings) -> None:
        self.app = create_app(settings)
        self.port = free_port()
        here = replace(settings, host="127.0.0.1", port=self.port)
        self.server = uvicorn.Server(server_config(self.app, here))
        self.thread = threading.Thread(target=self.server.run)
        self.thread.start()
        while not self.server.started:
            time.sleep(0.01)
        super().__init__(base_url=f"http://127.0.0.1:{self.port}", timeout=60)

    def stop(self) -> None:
        """Stop as a signal would."""
        self.close()
        self.server.should_exit = True
        self.thread.join()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    served = Served(Settings(state_dir=tmp_path_factory.mktemp("state"), workers=2))
    yield served
    served.stop()


@pytest.fixture(scope="session")
def serve() -> type[Served]:
    return Served


@pytest.fixture
def make_client(tmp_path: Path) -> Iterator[Callable[..., Served]]:
    """Services with settings of one's own, all on one store."""
    made: list[Served] = []

    def make(**settings: Any) -> Served:
        made.append(Served(Settings(**({"state_dir": tmp_path} | settings))))
        return made[-1]

    yield make
    for served in made:
        served.stop()


class Spawned:
    """``python -m service`` on a free port."""

    def __init__(
        self,
        state: Path,
        environment: dict[str, str] | None = None,
        before: Sequence[str] = (),
        new_session: bool = False,
        **settings: Any,
    ) -> None:
        port = free_port()
        values = {"port": port, "state_dir": state, "workers": 1} | settings
        self.port = port
        env = {f"RBPS_{name.upper()}": str(value) for name, value in values.items()}
        self.state = state
        self.log = open(state / "log", "ab")  # noqa: SIM115 - closed in stop
        self.process = subprocess.Popen(
            [*before, sys.executable, "-m", "service"],
            env=os.environ | (environment or {}) | env,
            stderr=self.log,
            start_new_session=new_session,
        )
        self.client = httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60)
        eventually(self.answers)

    def answers(self) -> bool:
        assert self.process.poll() is None, "the service has ended"
        try:
            return self.client.get("/livez").status_code == 200
        except httpx.TransportError:
            return False

    def stop(self, how: int = signal.SIGTERM) -> None:
        self.client.close()
        self.process.send_signal(how)
        self.process.wait(120)
        self.log.close()


@pytest.fixture
def spawn(tmp_path: Path) -> Iterator[Callable[..., Spawned]]:
    made: list[Spawned] = []

    def make(environment: dict[str, str] | None = None, **settings: Any) -> Spawned:
        made.append(Spawned(tmp_path, environment, **settings))
        return made[-1]

    yield make
    for one in made:
        if one.process.poll() is None:
            one.stop()
        one.client.close()
        one.log.close()


@pytest.fixture(scope="session")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Spawned]:
    """A service with the usual settings, for all tests that leave it without a job to compute."""
    made = Spawned(tmp_path_factory.mktemp("running"))
    yield made
    made.stop()


def parent(pid: int) -> int:
    """Of a process; 0 if it has gone."""
    try:
        return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    except (FileNotFoundError, ProcessLookupError):
        return 0


def gone(pid: int) -> bool:
    """No such process, or one that is dead and only waits for its parent to notice."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    except (FileNotFoundError, ProcessLookupError):
        return True


def _children(pid: int) -> list[int]:
    try:
        lists = [file.read_text() for file in Path(f"/proc/{pid}/task").glob("*/children")]
    except (FileNotFoundError, ProcessLookupError):
        return []
    return [int(child) for text in lists for child in text.split()]


def worker_processes(above: int) -> list[int]:
    """Process ids of the workers of a service or Dask worker, which its forkserver started."""
    found = []
    for child in _children(above):
        try:
            command = Path(f"/proc/{child}/cmdline").read_text()
        except (FileNotFoundError, ProcessLookupError):
            continue
        if "forkserver" in command:
            found += [pid for pid in _children(child) if not gone(pid)]
    return found


@pytest.fixture(scope="session")
def workers() -> Callable[[int], list[int]]:
    return worker_processes


@pytest.fixture(scope="session")
def dead() -> Callable[[int], bool]:
    return gone


@pytest.fixture(scope="session")
def children_of() -> Callable[[int], list[int]]:
    return _children


@pytest.fixture(scope="session")
def parent_of() -> Callable[[int], int]:
    return parent


@pytest.fixture
def catch() -> Callable[..., tuple[str, int]]:
    """Submit until a job's worker is found while it computes; (address, worker's process id)."""

    def caught(service: Spawned, request: dict[str, Any], iterations: int) -> tuple[str, int]:
        for _ in range(10):
            url = service.client.post("/jobs", json=request).headers["location"]
            job = wait_for(
                service.client, url, lambda j: j["iteration"] >= iterations or j["status"] in ENDED
            )
            found = worker_processes(service.process.pid)
            if found and job["status"] == "running":
                return url, found[0]
        raise AssertionError("the jobs end before their workers are found")

    return caught


@pytest.fixture(scope="session")
def postgres() -> Iterator[str]:
    """URL of a PostgreSQL server started for the tests; skips where there is none."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin")) or [Path("/nowhere")]
    initdb = shutil.which("initdb") or shutil.which("initdb", path=str(found[-1]))
    if initdb is None:
        pytest.skip("PostgreSQL's binaries are not installed")
    folder = Path(tempfile.mkdtemp(prefix="rbps-postgres-"))
    user: dict[str, Any] = {}
    if os.getuid() == 0:  # the server does not run as root
        user = {"user": "postgres", "group": "postgres", "extra_groups": []}
        shutil.chown(folder, "postgres", "postgres")
    data, port = folder / "data", free_port()
    quiet: dict[str, Any] = {"check": True, "stdout": subprocess.DEVNULL, "cwd": folder}
    subprocess.run([initdb, "-D", data, "-U", "rbps", "-A", "trust", "-N"], **quiet, **user)
    control = [Path(initdb).resolve().parent / "pg_ctl", "-D", data, "-w"]
    options = f"-p {port} -c listen_addresses=127.0.0.1 -c unix_socket_directories={folder}"
    start = [*control, "-l", folder / "log", "-o", options, "start"]
    try:
        subprocess.run(start, **quiet, **user)
        yield f"postgresql+psycopg://rbps@127.0.0.1:{port}/postgres"
    finally:
        subprocess.run([*control, "-m", "immediate", "stop"], **(quiet | {"check": False}), **user)
        shutil.rmtree(folder)


@pytest.fixture
def empty_database(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[str], str]:
    """URL of an empty database of a kind."""

    def make(kind: str) -> str:
        if kind == "sqlite":
            return Settings(state_dir=tmp_path).store_url
        url: str = request.getfixturevalue("postgres")
        from sqlalchemy import create_engine

        engine_ = create_engine(url)
        metadata.drop_all(engine_)
        engine_.dispose()
        return url

    return make


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request: pytest.FixtureRequest, empty_database: Callable[[str], str]) -> str:
    """URL of an empty database."""
    return empty_database(request.param)


@pytest.fixture
def store(database: str) -> Iterator[Store]:
    made = Store(database)
    yield made
    made.close()


@pytest.fixture(scope="session")
def free_ports() -> Callable[[], int]:
    return free_port
