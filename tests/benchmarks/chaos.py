"""``make chaos``: 50 blows at random moments under load; every job ends as it would have, bit by bit.

    python -m tests.benchmarks.chaos [--kills 50] [--jobs 80] [--seed 0] [--results ...] [--keep ...]

Eight clients each keep one job in the service, of every kind, with several starts and a bootstrap,
some that must fail, some that are cancelled, some that are stopped and resumed. Meanwhile SIGKILL hits,
in an order drawn from the seed: a worker; the forkserver above the workers; the service process, in
which the supervisor is a thread; all processes of the service at once. All of them are also suspended
for longer than silence is waited for (SIGSTOP, SIGCONT), and started again with a clock that is an hour
or a day off (libfaketime, where it is installed). The setting for losses is the default, two at one
place. At the end one more job loses its worker five times, with iterations between. What each kind of
job leaves is compared with what an undisturbed service gives. Exits with 1 if a promise is broken.
Writes ``service-chaos.md`` and two tables of what ``.md`` sums up.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import json
import os
import re
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from service.settings import Settings
from tests.benchmarks.machine import Watch, processes
from tests.benchmarks.service_process import ENDED, ServiceProcess, request

CLIENTS, WORKERS, LEASE = 8, 2, 2.0
PAUSE = (0.05, 3.0)  # s, uniform
AFTER_JOB = 0.75  # chance that the pause begins when one more job has ended
PATIENCE = 600.0  # s; a job that has not ended by then hangs
SHARES = {
    "worker": 0.2,
    "forkserver": 0.2,
    "supervisor": 0.2,
    "whole service": 0.1,
    "suspended": 0.15,
    "clock set": 0.15,
}
SUSPEND = 3.0 * LEASE  # s
STEPS = ("-3600", "+3600", "-86400", "+86400", "+0")  # s, of the clock of a service started again
LOSSES = 5  # of one job's worker, with iterations between
AT_ONE_PLACE = Settings().losses_allowed  # without one between: a further one gives the job up
FAKETIME = next(Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1"), None)
RESULTS = Path(__file__).parent / "results"


def jobs() -> dict[str, dict[str, Any]]:
    """Requests by name; clients send them in turn."""
    linear = {"model": "linear-2", "parameters": {"start": {"theta": 0.3}, "free": ["theta"]}}
    data = {"series": [{"y": [[float(i % 7)] for i in range(300)]}]}
    draw = {"kind": "simulate", "model": "mixed-4", "options": {"samples": 5000, "seed": 3}}
    return {
        "estimate": request(0, iterations=60),
        "starts and bootstrap": request(1, 80, 20, starts=3, bootstrap=3),
        "estimate, cancelled": request(2, iterations=20_000),
        "estimate, resumed": request(8, iterations=60),
        "estimate, PS-EM": request(3, 100, 40, method="ps-em"),
        "smooth": {"kind": "smooth", "model": "linear-2", "options": {"particles": 1000}} | data,
        "estimate, errors": request(4, iterations=40, standard_errors=True),
        "simulate": draw,
        "simulate, fails": draw | {"parameters": {"values": {"theta_4": 1.2}}},
        "exact EM": request(5)
        | linear
        | data
        | {"options": {"method": "rts-em", "iterations": 200}},
        "estimate, two series": _two_series(),
    }


def _two_series() -> dict[str, Any]:
    one, other = request(6, iterations=40), request(7)
    return one | {"series": one["series"] + other["series"]}


def right_end(name: str) -> str:
    """The status a job must end with."""
    return {"cancelled": "dismissed", "fails": "failed"}.get(name.rpartition(", ")[2], "successful")


class Client(threading.Thread):
    """Keeps one job in the service until there have been enough."""

    def __init__(self, url: str, numbers: Iterator[int], jobs: int, done: threading.Event) -> None:
        super().__init__()
        self.http = httpx.Client(base_url=url, timeout=60)
        self.numbers, self.jobs, self.done = numbers, jobs, done
        self.found: list[dict[str, Any]] = []
        self.broken: list[str] = []

    def run(self) -> None:
        requests = jobs()
        names = list(requests)
        for i in self.numbers:
            if i >= self.jobs and self.done.is_set():
                return
            name = names[i % len(names)]
            self.found.append({"number": i, "name": name} | self._one(i, name, requests[name]))

    def _one(self, i: int, name: str, body: dict[str, Any]) -> dict[str, Any]:
        headers = {"Idempotency-Key": f"job {i}"}
        job = self.ask("POST", "/jobs", json=body, headers=headers).json()["jobID"]
        end, before, stopped = time.monotonic() + PATIENCE, 0, False
        while time.monotonic() < end:
            status = self.ask("GET", f"/jobs/{job}").json()
            if status["kind"] == "estimate" and status["iteration"] < before:
                self.broken.append(f"job {job} went back from {before} to {status['iteration']}")
            before = status["iteration"]
            if status["status"] in ENDED:
                ended = {"status": status["status"], "message": status.get("message", "")}
                return {"job": job, "left": left(self, job)} | ended
            if right_end(name) == "dismissed" and before >= 5:
                self.ask("POST", f"/jobs/{job}/stop")
            if name.endswith("resumed") and before >= 5 and not stopped:
                stopped = self._stop_and_resume(job)
            time.sleep(0.2)
        return {"job": job, "status": f"hangs: {status['status']}", "left": None, "message": ""}

    def _stop_and_resume(self, job: str) -> bool:
        """What comes back says whether it was in time."""
        if self.ask("POST", f"/jobs/{job}/stop").json()["status"] == "dismissed":
            self.ask("POST", f"/jobs/{job}/resume")
            return True
        return False

    def ask(self, verb: str, path: str, **more: Any) -> httpx.Response:
        """As a careful client: again until there is an answer."""
        end = time.monotonic() + PATIENCE
        while True:
            try:
                answer = self.http.request(verb, path, **more)
                if answer.status_code not in (500, 503):
                    return answer
                if path.endswith("/results"):  # a failed job's own problem
                    return answer
                self.broken.append(f"{verb} {path}: {answer.status_code} {answer.text[:200]}")
            except httpx.TransportError:
                if time.monotonic() > end:
                    raise
            time.sleep(0.2)


def left(client: Client, job: str) -> Any:
    """All a job left: results or problem, without times; and the trace of every iteration."""
    results = client.ask("GET", f"/jobs/{job}/results").json()
    if results.get("outcome") == "stopped":
        return None
    traces = client.ask("GET", f"/jobs/{job}/trace").json()
    for document in (traces, results.get("trace") or {}):
        document.pop("seconds", None)
    return {"results": results, "trace": traces}


def undisturbed(state: Path) -> dict[str, Any]:
    """What each job leaves if nobody kills anything."""
    service = ServiceProcess(state, workers=WORKERS)
    try:
        client = Client(service.url, iter(range(len(jobs()))), len(jobs()), threading.Event())
        client.run()
    finally:
        service.stop()
    return {one["name"]: one for one in client.found}


@dataclass(frozen=True)
class Kill:
    """What to kill, so many seconds after the next job has ended, or after the last kill."""

    what: str
    pause: float
    after_job: bool
    which: float  # of several workers, in [0, 1)


def plan(kills: int, seed: int) -> list[Kill]:
    """All kills, drawn from the seed."""
    rng = np.random.default_rng(seed)
    bounds = np.rint(kills * np.cumsum([0.0, *SHARES.values()])).astype(int)
    order = rng.permutation(np.repeat(list(SHARES), np.diff(bounds)))
    return [
        Kill(str(what), rng.uniform(*PAUSE), bool(rng.random() < AFTER_JOB), rng.random())
        for what in order
    ]


def targets(service: ServiceProcess, what: str, which: float) -> list[int]:
    """Process ids; waits until there is such a process."""
    end = time.monotonic() + PATIENCE
    while what in ("worker", "forkserver"):
        all_ = processes()
        servers = {
            p for p in all_ if all_[p][0] == service.process.pid and "forkserver" in command(p)
        }
        workers = sorted(pid for pid, (parent, _, _) in all_.items() if parent in servers)
        if what == "worker" and workers:
            return [workers[int(which * len(workers))]]
        if what == "forkserver" and servers:
            return sorted(servers)
        if time.monotonic() > end:
            raise RuntimeError(f"there is no {what}")
        time.sleep(0.01)
    return [
        service.process.pid,
        *(service.below() if what in ("whole service", "clock set") else []),
    ]


def command(pid: int) -> str:
    """Command line; empty if it has gone."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ")
    except (FileNotFoundError, ProcessLookupError):
        return ""


def strike(service: ServiceProcess, kill: Kill, clients: list[Client]) -> int:
    """SIGKILL; the number of processes that were hit. A killed service is started again."""
    hit, ended = 0, sum(len(client.found) for client in clients)
    while kill.after_job and sum(len(client.found) for client in clients) == ended:
        if not any(client.is_alive() for client in clients):
            raise RuntimeError("all clients have given up")
        time.sleep(0.01)
    time.sleep(kill.pause)
    if kill.what == "suspended":
        return suspend(service)
    if kill.what == "clock set" and FAKETIME is not None:
        step = STEPS[int(kill.which * len(STEPS))]
        service.environment = {
            "LD_PRELOAD": str(FAKETIME),
            "FAKETIME": step,
            "FAKETIME_DONT_FAKE_MONOTONIC": "1",
        }
    for pid in targets(service, kill.what, kill.which):
        try:
            os.kill(pid, signal.SIGKILL)
            hit += 1
        except ProcessLookupError:
            pass
    if kill.what in ("supervisor", "whole service", "clock set"):
        service.process.wait()
        service.start()  # not waited for: the next kill may hit it before it answers
    return hit


def suspend(service: ServiceProcess) -> int:
    """All processes stand still, and go on."""
    pids = [service.process.pid, *service.below()]
    for how in (signal.SIGSTOP, signal.SIGCONT):
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, how)
        if how == signal.SIGSTOP:
            time.sleep(SUSPEND)
    return len(pids)


def lose_repeatedly(service: ServiceProcess) -> dict[str, Any]:
    """A job whose worker is killed LOSSES times, with iterations between, and the same one undisturbed."""
    client = Client(service.url, iter(()), 0, threading.Event())
    body = request(9, 1000, 200)
    calm = _ended(client, client.ask("POST", "/jobs", json=body).json()["jobID"])
    between = calm["iterations"] // (LOSSES + 1)
    job = client.ask("POST", "/jobs", json=body).json()["jobID"]
    for k in range(LOSSES):
        while (status := client.ask("GET", f"/jobs/{job}").json())["status"] not in ENDED:
            if status["iteration"] >= (k + 1) * between:
                os.kill(targets(service, "worker", 0.0)[0], signal.SIGKILL)
                break
            time.sleep(0.05)
    lost = _ended(client, job)
    return {
        "between": between,
        "restarts": lost["restarts"],
        "status": lost["status"],
        "same_bits": calm["left"] == lost["left"],
    }


def _ended(client: Client, job: str) -> dict[str, Any]:
    """What a job left, once it has ended."""
    while (status := client.ask("GET", f"/jobs/{job}").json())["status"] not in ENDED:
        time.sleep(0.1)
    (task,) = client.ask("GET", f"/jobs/{job}/tasks").json()["tasks"]
    return {
        "status": status["status"],
        "iterations": status["iteration"],
        "restarts": task["restarts"],
        "left": left(client, job),
    }


def disturbed(state: Path, kills: int, n: int, seed: int) -> dict[str, Any]:
    """The run itself: kills, jobs, and what the log says about each attempt."""
    service = ServiceProcess(state, workers=WORKERS, lease_seconds=LEASE)
    numbers, done = Numbers(), threading.Event()
    clients = [Client(service.url, numbers, n, done) for _ in range(CLIENTS)]
    begin, killed = time.monotonic(), []
    for client in clients:
        client.start()
    try:
        for kill in plan(kills, seed):
            hit = strike(service, kill, clients)
            now = round(time.monotonic() - begin, 2)
            killed.append({"seconds": now, "killed": kill.what, "processes": hit})
    finally:
        done.set()
        for client in clients:
            client.join()
    seconds = time.monotonic() - begin
    service.wait_until_up()
    repeated = lose_repeatedly(service)
    listed = clients[0].ask("GET", "/jobs?limit=1000").json()["jobs"]
    service.stop()
    end = time.monotonic() + 10.0
    while (orphans := belonging_to(state)) and time.monotonic() < end:
        time.sleep(0.1)
    return {
        "kills": killed,
        "jobs": sorted((one for c in clients for one in c.found), key=lambda one: one["number"]),
        "broken": [text for client in clients for text in client.broken],
        "repeated": repeated,
        "listed": len(listed) - 2,
        "orphans": len(orphans),
        "seconds": seconds,
        "log": [
            json.loads(line) for line in service.log.read_text().splitlines() if line[:1] == "{"
        ],
    }


class Numbers:
    """0, 1, 2, ... for several threads."""

    def __init__(self) -> None:
        self._count, self._lock = count(), threading.Lock()

    def __iter__(self) -> Numbers:
        return self

    def __next__(self) -> int:
        with self._lock:
            return next(self._count)


def belonging_to(state: Path) -> list[int]:
    """Processes that were started with this state directory."""
    mark, found = f"RBPS_STATE_DIR={state}\0".encode(), []
    for file in Path("/proc").glob("[0-9]*/environ"):
        try:
            if mark in file.read_bytes():
                found.append(int(file.parent.name))
        except OSError:
            continue
    return found


def hit_at_one_place(said: list[str]) -> int:
    """How often a job lost its worker with no checkpoint between, at most; by its lines in the log.

    It went on from there after each loss but the last. An attempt that was killed before its first word is not
    in the log.
    """
    places = Counter(text for text in said if text.startswith("goes on after"))
    attempts = sum(text.startswith("attempt started") for text in said)
    from_the_beginning = attempts - sum(places.values())
    return max(from_the_beginning, max(places.values(), default=0) + 1)


def given_up(one: dict[str, Any], said: list[str]) -> bool:
    """Whether a job was given up as the setting says: the store counts a hit that the log may not have."""
    counted = re.search(r"given up after (\d+) attempts", one["message"])
    hits = int(counted[1]) if counted else 0
    return one["status"] == "failed" and hits > AT_ONE_PLACE <= hit_at_one_place(said)


def judge(run: dict[str, Any], expected: dict[str, Any]) -> list[dict[str, Any]]:
    """One row for each job."""
    rows = []
    for one in run["jobs"]:
        said = [line["message"] for line in run["log"] if line.get("job") == one["job"]]
        written = Counter(text for text in said if text.endswith("its result is written"))
        attempts = sum(text.startswith("attempt started") for text in said)
        rows.append(
            {
                "number": one["number"],
                "job": one["name"],
                "status": one["status"],
                "right": one["status"] == right_end(one["name"]),
                "given_up": given_up(one, said),
                "attempts": attempts,
                "tasks_ended": len(written),
                "interrupted": max(0, attempts - max(1, len(written))),
                "resumed_at": max(
                    (int(text.split()[-1]) for text in said if text.startswith("goes on after")),
                    default=0,
                ),
                "ended_twice": sum(n - 1 for n in written.values())
                + (one["status"] != "dismissed")
                * sum("was computed to its end, but" in text for text in said),
                "same_bits": one["left"] == expected[one["name"]]["left"],
                "last_words": said[-1] if said else "",
            }
        )
    return rows


def main() -> None:
    """Run, print, write the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--jobs", type=int, default=80, help="at least so many")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--keep", type=Path, help="a new folder where stores and logs remain")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="rbps-chaos-") as temporary, Watch() as machine:
        state = chosen.keep or Path(temporary)
        for part in ("calm", "storm"):
            (state / part).mkdir(parents=True)
        expected = undisturbed(state / "calm")
        for name, one in expected.items():
            if one["status"] != right_end(name):
                sys.exit(f"undisturbed, '{name}' ended as {one['status']}: {one['left']}")
        run = disturbed(state / "storm", chosen.kills, chosen.jobs, chosen.seed)
    rows = judge(run, expected)
    text, good = report(run, rows, chosen.seed, machine.figures())
    write(chosen.results / "service-chaos.jobs.csv", rows)
    write(chosen.results / "service-chaos.kills.csv", run["kills"])
    (chosen.results / "service-chaos.md").write_text(text)
    print(text)
    sys.exit(0 if good else 1)


def write(path: Path, rows: list[dict[str, Any]]) -> None:
    """A table with a head."""
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


def report(
    run: dict[str, Any], rows: list[dict[str, Any]], seed: int, machine: dict[str, float]
) -> tuple[str, bool]:
    """The text, and whether every promise was kept."""
    kinds = Counter(kill["killed"] for kill in run["kills"])
    states = Counter(row["status"] for row in rows)
    compared = [row for row in rows if row["status"] != "dismissed"]
    promises = {
        "jobs that did not end in the right state": sum(
            not row["right"] and not row["given_up"] for row in rows
        ),
        "jobs more or fewer than were accepted": abs(run["listed"] - len(rows)),
        "results that differ from an undisturbed run in any bit": sum(
            not row["same_bits"] and not row["given_up"] for row in compared
        ),
        "tasks computed to their end twice": sum(row["ended_twice"] for row in rows),
        f"a job that lost its worker five times, each {run['repeated']['between']} iterations after the "
        "one before, failed or differs": int(
            (run["repeated"]["restarts"], run["repeated"]["status"], run["repeated"]["same_bits"])
            != (LOSSES, "successful", True)
        ),
        "jobs that hang": sum(row["status"].startswith("hangs") for row in rows),
        "processes left behind": run["orphans"],
        "answers 500 or 503, progress that went back": len(run["broken"]),
    }
    interrupted = [row for row in compared if row["interrupted"]]
    lines = [
        "# The service under kill -9, suspended, and with its clock set",
        "",
        f"`make chaos`: {len(run['kills'])} blows at random moments (seed {seed}), "
        f"{CLIENTS} clients that keep one job each in the service, {WORKERS} workers; silence of "
        f"{LEASE:g} s is a loss, and two at one place are allowed. The supervisor is a thread of the "
        "service process; to kill it is to kill that process. 'Suspended': all processes stand still for "
        f"{SUSPEND:g} s. 'Clock set': all are killed, and started with a clock that is "
        f"{', '.join(STEPS)} s off"
        + ("" if FAKETIME else " (not here: libfaketime is not installed)")
        + ".",
        "",
        "| blow | times |",
        "| --- | ---: |",
        *(f"| {what} | {kinds[what]} |" for what in SHARES),
        "",
        "| jobs | number |",
        "| --- | ---: |",
        f"| accepted | {len(rows)} |",
        *(f"| {status} | {n} |" for status, n in sorted(states.items())),
        f"| given up, hit a third time with no checkpoint between | {sum(row['given_up'] for row in rows)} |",
        f"| attempts started | {sum(row['attempts'] for row in rows)} |",
        f"| interrupted at least once | {sum(row['interrupted'] > 0 for row in rows)} |",
        f"| went on from a checkpoint | {sum(row['resumed_at'] > 0 for row in rows)} |",
        f"| compared bit for bit with an undisturbed run | {len(compared)} |",
        f"| of these, interrupted | {len(interrupted)} |",
        "",
        "| promise broken | times |",
        "| --- | ---: |",
        *(f"| {what} | {n} |" for what, n in promises.items()),
        "",
        *wrong_ends(rows),
        f"{run['seconds']:.0f} s. The machine meanwhile: "
        + ", ".join(f"{what} {value:g}" for what, value in machine.items())
        + ".",
        *("", *run["broken"]),
    ]
    return "\n".join(lines).rstrip() + "\n", not any(promises.values())


def wrong_ends(rows: list[dict[str, Any]]) -> list[str]:
    """A paragraph on jobs that did not end as they should, if there are any."""
    found = [
        f"Job {row['number']} ('{row['job']}') ended as {row['status']} after {row['attempts']} attempts, "
        f"the last from iteration {row['resumed_at']}: {row['last_words']}."
        for row in rows
        if not row["right"] and not row["given_up"]
    ]
    return [" ".join(found), ""] if found else []


if __name__ == "__main__":
    main()
