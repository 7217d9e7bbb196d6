"""What goes after its time, and what can be removed where there is no room for anything."""

import os
import subprocess

import numpy as np
import pytest
from sqlalchemy.exc import OperationalError

from service.retention import DAY, Retention
from service.store import Store


def ended(store, how="finish"):
    made = store.create("estimate", "linear-2", {"y": [1, 2]}, 10)
    attempt = store.claim("a")
    store.record(attempt, 1, {1: np.ones(5)}, {"theta": 0.5}, 1.0)
    getattr(store, how)(*((made,) if how == "stop" else (attempt, {"detail": "x"})))
    return made


class Clocks:
    """A clock of the process and one of the wall, which can be set."""

    def __init__(self, wall):
        self.now, self.set = 0.0, wall

    def pass_(self, seconds):
        self.now += seconds

    def wall(self):
        return self.set + self.now

    def clock(self):
        return self.now


@pytest.mark.long
def test_data_go_after_their_time(store):
    old = {ended(store, how): how for how in ("finish", "fail", "stop")}
    finished = store.job(next(iter(old))).finished
    clocks = Clocks(finished)
    retention = Retention(store, 2.0, clocks.clock, clocks.wall)
    clocks.pass_(1.9 * DAY)
    running = store.create("estimate", "linear-2", {}, 10)
    assert retention.look() == 0
    clocks.pass_(0.2 * DAY)
    assert retention.look() == 3
    for made, how in old.items():
        job = store.job(made)
        assert job.status == {"finish": "successful", "fail": "failed", "stop": "dismissed"}[how]
        assert (job.removed, job.estimate) == (1, None)
        assert store.document(job.seq, "request") is store.document(job.seq, "result") is None
        assert store.rows(job.seq)[0] == []
        assert store.resume(made).status == job.status
    assert store.document(store.job(running).seq, "request") is not None
    clocks.pass_(DAY)
    assert retention.look() == 0
    assert store.counts() == {"successful": 1, "failed": 1, "dismissed": 1, "accepted": 1}


@pytest.mark.long
@pytest.mark.parametrize("days", [0.0, 1e6])
def test_nothing_goes_before(store, days):
    made = ended(store)
    clocks = Clocks(store.job(made).finished)
    retention = Retention(store, days, clocks.clock, clocks.wall)
    clocks.pass_(1000 * DAY)
    assert retention.look() == 0
    assert store.job(made).removed == 0


def test_a_clock_that_is_set_removes_nothing(store):
    made = ended(store)
    clocks = Clocks(store.job(made).finished)
    retention = Retention(store, 2.0, clocks.clock, clocks.wall)
    clocks.set += 1000 * DAY  # wrong when it starts: the first hour is waited for
    assert retention.look() == 0
    clocks.pass_(2 * 3600.0)
    assert retention.look() == 0  # by so much more than an hour
    clocks.set -= 1000 * DAY
    clocks.pass_(2 * 3600.0)
    assert retention.look() == 0
    assert store.job(made).removed == 0


def test_a_removed_result_says_so(make_client, estimation, wait):
    client = make_client(workers=1)
    url = client.post("/jobs", json=estimation(iterations=1)).headers["location"]
    job = wait(client, url, lambda job: job["status"] == "successful")
    assert {"results", "report"} <= {link["rel"] for link in job["links"]}
    store = Store(client.app.state.store_url)
    assert store.purge(float("inf")) == 1
    store.close()
    job = client.get(url).json()
    assert (job["status"], "removed" in job["message"]) == ("successful", True)
    assert {link["rel"] for link in job["links"]} == {"self", "trace"}
    answer = client.get(f"{url}/results")
    assert (answer.status_code, "removed after their time" in answer.json()["detail"]) == (
        404,
        True,
    )


@pytest.fixture
def small_disk(tmp_path):
    """A disk of 24 MiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=24m", "tmpfs", str(folder)]
    if os.getuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("a disk of its own needs the right to mount one")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.mark.slow
def test_a_full_disk_can_be_freed(small_disk):
    store = Store(f"sqlite:///{small_disk}/rbps.sqlite")
    rng, made = np.random.default_rng(0), []

    def create():
        request = {"y": rng.standard_normal(50_000).tolist()}
        made.append(store.create("estimate", "m", request, 1))

    with pytest.raises(OperationalError, match="full"):
        repeat(create)
    with open(small_disk / "rest", "wb", 0) as rest, pytest.raises(OSError, match="No space"):
        repeat(lambda: rest.write(bytes(4096)))
    store.close()  # and a service that is started now has no more room
    store = Store(f"sqlite:///{small_disk}/rbps.sqlite")
    for job in made:
        assert store.stop(job).status == "dismissed"
        assert store.dismiss(job).removed == 1
    create()
    assert store.document(store.job(made[-1]).seq, "request")
    with store._engine.connect() as sql:  # what is in the journal goes into the file
        sql.connection.driver_connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    assert (small_disk / "rbps.sqlite").stat().st_size < 4 << 20  # others find room as well
    store.close()


def repeat(what):
    while True:
        what()
