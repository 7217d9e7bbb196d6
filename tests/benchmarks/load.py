"""``make load``: 200 queued jobs, 50 polling clients, both workers busy; how fast are answers?"""

from __future__ import annotations

import asyncio
import json
import os
import sys
import tempfile
import time
from pathlib import Path

import httpx
import numpy as np
from service_process import ServiceProcess, request

JOBS, CLIENTS, PAUSE = 200, 50, 1.0  # the pause is what Retry-After asks for
RESULTS = Path(__file__).parent / "results" / "service-load.json"


async def main() -> None:
    """Run, print, write the figures."""
    with tempfile.TemporaryDirectory() as state:
        service = ServiceProcess(Path(state), workers=2)
        try:
            figures = await load(service.url)
        finally:
            service.stop()
        log = (Path(state) / "log").read_text()
    figures["lock_errors_in_the_log"] = log.count("locked")
    figures["cores"] = os.cpu_count()
    figures["load_average_at_the_end"] = round(os.getloadavg()[0], 1)
    RESULTS.write_text(json.dumps(figures, indent=1) + "\n")
    print(json.dumps(figures, indent=1))
    good = (
        figures["answers_that_are_not_2xx"] == 0
        and figures["lock_errors_in_the_log"] == 0
        and figures["queue_order_kept"]
        and figures["median_ms"] < 50
    )
    sys.exit(0 if good else 1)


async def load(url: str) -> dict[str, object]:
    """Submit all, poll until all have ended."""
    bodies = [json.dumps(request(seed, iterations=10)) for seed in range(4)]
    times: list[float] = []
    bad = 0
    limits = httpx.Limits(max_connections=CLIENTS)
    async with httpx.AsyncClient(base_url=url, timeout=60, limits=limits) as client:
        begin, jobs, posts = time.monotonic(), [], []
        for i in range(JOBS):
            sent = time.perf_counter()
            answer = await client.post(
                "/jobs", content=bodies[i % 4], headers={"Content-Type": "application/json"}
            )
            posts.append(time.perf_counter() - sent)
            jobs.append(answer.json()["jobID"])
        waiting = set(jobs)

        async def poll(number: int) -> None:
            nonlocal bad
            rng = np.random.default_rng(number)
            await asyncio.sleep(rng.uniform(0, PAUSE))
            while waiting:
                job = sorted(waiting)[rng.integers(len(waiting))]
                path = ("", "", "/trace")[rng.integers(3)]
                sent = time.perf_counter()
                answer = await client.get(f"/jobs/{job}{path}")
                times.append(time.perf_counter() - sent)
                bad += answer.status_code >= 300
                if not path and answer.json()["status"] in ("successful", "failed", "dismissed"):
                    waiting.discard(job)
                await asyncio.sleep(PAUSE)

        await asyncio.gather(*(poll(i) for i in range(CLIENTS)))
        seconds = time.monotonic() - begin
        ended = [(await client.get(f"/jobs/{job}")).json() for job in jobs]
    started = [job["started"] for job in ended]
    ms = 1e3 * np.array(times)
    return {
        "jobs": JOBS,
        "polling_clients": CLIENTS,
        "successful": sum(job["status"] == "successful" for job in ended),
        "seconds": round(seconds, 1),
        "answers": len(times),
        "median_ms": round(float(np.median(ms)), 1),
        "p95_ms": round(float(np.quantile(ms, 0.95)), 1),
        "p99_ms": round(float(np.quantile(ms, 0.99)), 1),
        "max_ms": round(float(ms.max()), 1),
        "post_median_ms": round(1e3 * float(np.median(posts)), 1),
        "answers_that_are_not_2xx": bad,
        "queue_order_kept": started == sorted(started),
    }


if __name__ == "__main__":
    asyncio.run(main())
