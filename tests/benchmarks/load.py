"""``make load``: 200 queued jobs, 50 polling clients, both workers busy; how fast are answers?

    python -m tests.benchmarks.load [--jobs 200] [--clients 50] [--results FOLDER]

All jobs are sent at once and wait in the queue; the clients ask about them once a second each, as
``Retry-After`` tells them to. Beside them one client sends bodies of 64 MiB, which no job can hold, and
bodies with as many numbers as are allowed, all through. Times are those a client sees, and only of
requests sent while jobs waited, so that all workers had something to do. Exits with 1 if the median is
50 ms or more, an answer was wrong, the store was locked, or the queue's order was not kept. Writes
``service-load.md``.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import tempfile
import time
from collections import defaultdict
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from tests.benchmarks.large_bodies import array
from tests.benchmarks.machine import Watch
from tests.benchmarks.service_process import ENDED, ServiceProcess, request

WORKERS, PAUSE = 2, 1.0
MEDIAN_MS = 50.0
JSON = {"Content-Type": "application/json"}
RESULTS = Path(__file__).parent / "results"
CALLS = {  # what a client asks, how often of 20 times, right answers
    "GET /jobs/{id}": (11, {200}),
    "GET /jobs/{id}/trace": (4, {200}),
    "GET /jobs/{id}/results": (2, {200, 404}),  # 404 result-not-ready
    "GET /jobs": (2, {200}),
    "GET /metrics": (1, {200}),
}
LARGE = {  # what the client with large bodies sends, and the right answer
    "POST /jobs, 64 MiB": (lambda: array(32 << 20), 413),
    "POST /jobs, as many numbers as are allowed": (lambda: array(999_000), 422),
}


class Load:
    """Everything that is sent, and when it was answered."""

    def __init__(self, http: httpx.AsyncClient, jobs: int, clients: int) -> None:
        self.http, self.n_jobs, self.n_clients = http, jobs, clients
        self.jobs: list[str] = []
        self.waiting: set[str] = set()
        self.answers: dict[str, list[tuple[float, float]]] = defaultdict(list)  # sent, seconds
        self.wrong: list[str] = []
        self.large = [(call, make(), {right}) for call, (make, right) in LARGE.items()]

    async def run(self) -> list[dict[str, Any]]:
        """Submit all, poll until all have ended; their last status documents."""
        polling = asyncio.create_task(self._poll_all())
        large = asyncio.create_task(self._send_large())
        bodies = [json.dumps(request(seed, iterations=25)).encode() for seed in range(4)]
        for i in range(self.n_jobs):
            answer = await self._ask("POST", "/jobs", "POST /jobs", {201}, content=bodies[i % 4])
            self.jobs.append(answer.json()["jobID"])
            self.waiting.add(self.jobs[-1])
        await polling
        await large
        return [(await self.http.get(f"/jobs/{job}")).json() for job in self.jobs]

    async def _send_large(self) -> None:
        while self.waiting or len(self.jobs) < self.n_jobs:
            for call, body, right in self.large:
                await self._ask("POST", "/jobs", call, right, content=body)
                await asyncio.sleep(PAUSE)

    async def _poll_all(self) -> None:
        await asyncio.gather(*(self._poll(number) for number in range(self.n_clients)))

    async def _poll(self, number: int) -> None:
        rng = np.random.default_rng(number)
        calls = [call for call, (share, _) in CALLS.items() for _ in range(share)]
        while not self.jobs:
            await asyncio.sleep(0.01)
        await asyncio.sleep(rng.uniform(0.0, PAUSE))
        while self.waiting or len(self.jobs) < self.n_jobs:
            # half of the questions are about jobs that are about to run
            open_ = [job for job in self.jobs if job in self.waiting] or self.jobs
            job = open_[int(rng.integers(len(open_) if rng.random() < 0.5 else min(4, len(open_))))]
            call = calls[int(rng.integers(len(calls)))]
            answer = await self._ask("GET", call[4:].replace("{id}", job), call, CALLS[call][1])
            if call == "GET /jobs/{id}" and answer.json().get("status") in ENDED:
                self.waiting.discard(job)
            await asyncio.sleep(PAUSE)

    async def _ask(
        self, verb: str, path: str, call: str, right: set[int], **more: Any
    ) -> httpx.Response:
        sent, begin = time.time(), time.perf_counter()
        answer = await self.http.request(verb, path, headers=JSON, **more)
        self.answers[call].append((sent, time.perf_counter() - begin))
        if answer.status_code not in right:
            self.wrong.append(f"{call}: {answer.status_code} {answer.text[:200]}")
        return answer


async def load(url: str, jobs: int, clients: int) -> tuple[Load, list[dict[str, Any]]]:
    """Put the service under load."""
    limits = httpx.Limits(max_connections=clients + 2)
    async with httpx.AsyncClient(base_url=url, timeout=60, limits=limits) as http:
        made = Load(http, jobs, clients)
        return made, await made.run()


def seconds(text: str) -> float:
    """Unix time of a time in a document."""
    return datetime.fromisoformat(text).timestamp()


def report(
    made: Load, ended: list[dict[str, Any]], locked: int, machine: dict[str, float]
) -> tuple[str, bool]:
    """The text, and whether every promise was kept."""
    started = [seconds(job["started"]) for job in ended]
    finished = [seconds(job["finished"]) for job in ended]
    span = max(finished) - min(started)
    busy = sum(b - a for a, b in zip(started, finished, strict=True)) / (WORKERS * span)
    rows, all_ms = [], np.zeros(0)
    for call in ("POST /jobs", *CALLS):
        ms = np.array([1e3 * took for sent, took in made.answers[call] if sent < max(started)])
        all_ms = np.append(all_ms, ms)
        rows.append((call, ms))
    rows.append(("all", all_ms))
    rows += [(call, np.array([1e3 * took for _, took in made.answers[call]])) for call in LARGE]
    median = float(np.median(all_ms))
    promises = {
        "jobs that were not successful": sum(job["status"] != "successful" for job in ended),
        "answers that are wrong": len(made.wrong),
        "lines in the log about a locked store": locked,
        "jobs that started before one sent earlier": int((np.diff(started) < 0).sum()),
    }
    lines = [
        "# The service under load",
        "",
        f"`make load`: {len(ended)} estimations sent at once, {made.n_clients} clients that ask once "
        f"a second each, one client that sends large bodies, {WORKERS} workers. Milliseconds as a client "
        f"sees them, of requests sent while jobs waited; the client shares the machine. A median below "
        f"{MEDIAN_MS:g} ms is asked.",
        "",
        "| call | answers | median | 95 % | 99 % | max |",
        "| --- | ---: | ---: | ---: | ---: | ---: |",
    ]
    for call, ms in rows:
        p50, p95, p99 = np.quantile(ms, [0.5, 0.95, 0.99])
        lines.append(f"| {call} | {len(ms)} | {p50:.1f} | {p95:.1f} | {p99:.1f} | {ms.max():.1f} |")
    lines += [
        "",
        f"{len(ended) / span:.2f} jobs per second, each {np.mean(np.subtract(finished, started)):.2f} s; "
        f"the workers computed {100 * busy:.0f} % of the time.",
        "",
        "| promise broken | times |",
        "| --- | ---: |",
        *(f"| {what} | {n} |" for what, n in promises.items()),
        "",
        "The machine meanwhile: "
        + ", ".join(f"{what} {value:g}" for what, value in machine.items())
        + ".",
        *("", *made.wrong[:20]),
    ]
    return "\n".join(lines).rstrip() + "\n", median < MEDIAN_MS and not any(promises.values())


def main() -> None:
    """Run, print, write the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=200)
    parser.add_argument("--clients", type=int, default=50)
    parser.add_argument("--results", type=Path, default=RESULTS)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="rbps-load-") as state, Watch() as machine:
        service = ServiceProcess(Path(state), workers=WORKERS)
        try:
            made, ended = asyncio.run(load(service.url, chosen.jobs, chosen.clients))
        finally:
            service.stop()
        locked = service.log.read_text().count("locked")
    text, good = report(made, ended, locked, machine.figures())
    (chosen.results / "service-load.md").write_text(text)
    print(text)
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
