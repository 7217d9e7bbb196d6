"""A Monte Carlo study spread over a Dask cluster: ``python -m tests.benchmarks.bench_dask``.

The study is a job of kind ``estimate`` with a bootstrap: each of its runs simulates at the estimate
and estimates again, in a task of its own. The same job runs in turn on a scheduler with one worker
process and on one with two, and locally with two; the ratio of the times is the speed-up. Both
answers must be the same in every bit, for the draws belong to the runs and not to the workers.
``[--runs 40] [--repeats 3] [--results FOLDER]``; writes ``service-dask.md``.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from tests.benchmarks.machine import Watch
from tests.benchmarks.service_process import ENDED, ServiceProcess, request

RESULTS = Path(__file__).parent / "results"


@contextlib.contextmanager
def cluster(workers: int, folder: Path) -> Iterator[str]:
    """Address of a scheduler with so many worker processes."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{probe.getsockname()[1]}"
    env = os.environ | {
        "DASK_DISTRIBUTED__WORKER__DAEMON": "False",
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0",
    }
    dask = [sys.executable, "-m", "dask"]
    commands = [
        [*dask, "scheduler", "--host", address, "--no-dashboard"],
        [*dask, "worker", address, "--nworkers", str(workers), "--nthreads", "1", "--no-dashboard",
         "--local-directory", str(folder), "--preload", "service.dask_runner"],
    ]  # fmt: skip
    with (folder / "dask-log").open("wb") as log:
        started = [subprocess.Popen(c, env=env, stdout=log, stderr=log) for c in commands]
    try:
        yield address
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait(60)


@contextlib.contextmanager
def place(workers: int, dask: bool, folder: Path) -> Iterator[ServiceProcess]:
    """A service that computes on a cluster, or by itself."""
    folder.mkdir()
    with contextlib.ExitStack() as stack:
        settings: dict[str, Any] = {"workers": workers}
        if dask:
            settings = {"dask_scheduler": stack.enter_context(cluster(workers, folder))}
        service = ServiceProcess(folder, **settings)
        stack.callback(service.stop)
        yield service


def study(service: ServiceProcess, body: dict[str, Any]) -> tuple[float, dict[str, Any]]:
    """Seconds from the first run's start to the end, and the bootstrap's estimates."""
    with httpx.Client(base_url=service.url, timeout=60) as http:
        url = http.post("/jobs", json=body).headers["location"]
        begin = time.monotonic()
        while (job := http.get(url).json())["status"] not in ENDED:
            if job["status"] == "accepted":
                begin = time.monotonic()
            time.sleep(0.02)
        if job["status"] != "successful":
            raise RuntimeError(job["message"])
        return time.monotonic() - begin, http.get(f"{url}/results").json()["bootstrap"]


def main() -> None:
    """Run, print, write the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--results", type=Path, default=RESULTS)
    chosen = parser.parse_args()
    body = request(0, 200, 20, bootstrap=chosen.runs)
    places = {
        "Dask, one worker": (1, True),
        "Dask, two workers": (2, True),
        "two workers of the service": (2, False),
    }
    seconds: dict[str, list[float]] = {name: [] for name in places}
    found = []
    with contextlib.ExitStack() as stack, Watch() as machine:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="rbps-dask-")))
        services = {
            name: stack.enter_context(place(*how, folder / str(i)))
            for i, (name, how) in enumerate(places.items())
        }
        for service in services.values():  # kernels loaded, workers there
            study(service, request(1, 50, 2, bootstrap=2))
        for _ in range(chosen.repeats):
            for name, service in services.items():
                took, bootstrap = study(service, body)
                seconds[name].append(took)
                found.append(bootstrap)
    same = all(one == found[0] for one in found)
    alone = np.array(seconds["Dask, one worker"])
    lines = [
        "# A study on a cluster",
        "",
        f"`make bench-dask`: one job of kind `estimate` with {chosen.runs} bootstrap runs (mixed-4, "
        f"T = 200, M = N = 50, at most 20 iterations each), {chosen.repeats} times on each, in turn. "
        "The ratio is that of times which follow each other; median and range.",
        "",
        "| where | seconds | median | times as fast as one worker |",
        "| --- | --- | ---: | ---: |",
    ]
    for name, took in seconds.items():
        ratio = alone / np.array(took)
        lines.append(
            f"| {name} | {', '.join(f'{one:.1f}' for one in took)} | {np.median(took):.1f} | "
            f"{np.median(ratio):.2f} ({ratio.min():.2f} to {ratio.max():.2f}) |"
        )
    lines += [
        "",
        f"All {len(found)} results are {'the same' if same else 'NOT the same'} in every bit. "
        "The first estimation and the summary run on one worker wherever they are.",
        "",
        "The machine meanwhile: "
        + ", ".join(f"{what} {value:g}" for what, value in machine.figures().items())
        + ".",
    ]
    text = "\n".join(lines) + "\n"
    (chosen.results / "service-dask.md").write_text(text)
    print(text)
    sys.exit(0 if same else 1)


if __name__ == "__main__":
    main()
