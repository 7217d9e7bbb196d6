"""``make chaos``: kill -9 at 50 random moments under load; every job ends, with the same bits.

``chaos.py [KILLS] [JOBS]`` for another number of each.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"  # as in workers: same bits

import httpx
import numpy as np
from service_process import ServiceProcess, request

import engine

KILLS, JOBS = (int(text) for text in (sys.argv[1:] + ["50", "40"][len(sys.argv) - 1 :]))
SEEDS = 4
RESULTS = Path(__file__).parent / "results" / "service-chaos.json"


def main() -> None:
    """Run, print, write the figures."""
    rng = np.random.default_rng(0)
    bodies = [request(seed, samples=60, iterations=12) for seed in range(SEEDS)]
    expected = [trace(body) for body in bodies]
    killed = {"worker": 0, "forkserver": 0, "service": 0}
    with tempfile.TemporaryDirectory(prefix="rbps-chaos-") as state:
        service = ServiceProcess(Path(state), workers=2, lease_seconds=2, losses_allowed=KILLS)
        begin = time.monotonic()
        jobs = [submit(service, bodies[i % SEEDS], i) for i in range(JOBS)]
        for _ in range(KILLS):
            time.sleep(rng.uniform(0.05, 1.0))
            killed[kill(service, rng)] += 1
        documents = [wait(service, job) for job in jobs]
        seconds = time.monotonic() - begin
        traces = [get(service, f"/jobs/{job}/trace")["theta"]["theta_2"] for job in jobs]
        listed = get(service, "/jobs?limit=1000")["jobs"]
        below = service.descendants()
        service.stop()
        time.sleep(2.0)
        left = sum(bool(command(pid)) for pid in below)
    figures = {
        "killed": killed,
        "jobs": JOBS,
        "jobs_listed": len(listed),  # a POST repeated with its key made no second job
        "successful": sum(job["status"] == "successful" for job in documents),
        "same_bits_as_undisturbed": sum(
            found == expected[i % SEEDS] for i, found in enumerate(traces)
        ),
        "jobs_that_were_restarted": sum("restart" in job["message"] for job in documents),
        "processes_left": left,
        "seconds": round(seconds, 1),
    }
    RESULTS.write_text(json.dumps(figures, indent=1) + "\n")
    print(json.dumps(figures, indent=1))
    all_well = JOBS == len(listed) == figures["successful"] == figures["same_bits_as_undisturbed"]
    sys.exit(0 if all_well and not left else 1)


def trace(body: dict) -> list[float]:
    """What an undisturbed estimation in this process gives."""
    found = engine.rbps_em(
        engine.get_model(body["model"]),
        engine.Series(body["series"][0]["y"]),
        body["parameters"]["start"],
        body["parameters"]["free"],
        n_iterations=body["options"]["iterations"],
        seed=body["options"]["seed"],
    )
    return found.trace[:, 1].tolist()


def submit(service: ServiceProcess, body: dict, number: int) -> str:
    """POST with an Idempotency-Key, as a careful client does."""
    headers = {"Idempotency-Key": f"job {number}"}
    return httpx.post(f"{service.url}/jobs", json=body, headers=headers, timeout=60).json()["jobID"]


def kill(service: ServiceProcess, rng: np.random.Generator) -> str:
    """SIGKILL a worker, the forkserver above the workers, or the whole service."""
    below = service.descendants()
    servers = [pid for pid in below if "forkserver" in command(pid)]
    workers = [pid for pid in below if pid not in servers[:1] and "forkserver" in command(pid)]
    what = rng.choice(["worker", "worker", "worker", "forkserver", "service"])
    if what == "service" or not servers:
        service.stop(signal.SIGKILL)
        service.start()
        return "service"
    targets = workers if what == "worker" and workers else servers[:1]
    os.kill(int(rng.choice(targets)), signal.SIGKILL)
    return "worker" if targets is workers else "forkserver"


def wait(service: ServiceProcess, job: str) -> dict:
    """The status document at the end."""
    end = time.monotonic() + 600
    while time.monotonic() < end:
        document = get(service, f"/jobs/{job}")
        if document["status"] in ("successful", "failed", "dismissed"):
            return document
        time.sleep(0.2)
    raise AssertionError(f"hangs: {document}")


def get(service: ServiceProcess, path: str) -> dict:
    """GET as JSON."""
    return httpx.get(service.url + path, timeout=60).json()


def command(pid: int) -> str:
    """Command line; empty if it has gone."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ")
    except (FileNotFoundError, ProcessLookupError):
        return ""


if __name__ == "__main__":
    main()
