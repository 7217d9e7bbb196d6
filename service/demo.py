"""``make demo``: a real estimation through the HTTP interface of a service started for it."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

import numpy as np

import engine
import engine.data

NILE_PUBLISHED = {"r": 15099.0, "q": 1469.1}  # Durbin and Koopman, variances of error and level


def main() -> None:
    """Start a service, estimate twice, diagnose once, and leave nothing running."""
    with tempfile.TemporaryDirectory(prefix="rbps-demo-") as state, service(state) as url:
        print(f"Service: {url}\n")
        mixed(url)
        nile(url)
        diagnosis(url)
    print(
        "The service has stopped. Where to look next:\n"
        "  make serve             the same service, to stay: its pages are at http://127.0.0.1:8000, its\n"
        "                         calls in /openapi.json, the Guide on /guide\n"
        "  .venv/bin/rbps --help  the same from the shell\n"
        "  service/demo.py        the requests made here\n"
        "  engine/models/         the models, one short file each: start your own from one of them"
    )


@contextlib.contextmanager
def service(state: str) -> Iterator[str]:
    """``python -m service`` on a free port of the loopback interface."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    url = f"http://127.0.0.1:{port}"
    settings = {"RBPS_STATE_DIR": state, "RBPS_PORT": str(port)}
    log = Path(state) / "log"
    with log.open("wb") as stream:
        process = subprocess.Popen(
            [sys.executable, "-m", "service"], env=os.environ | settings, stderr=stream
        )
        try:
            for _ in range(300):
                with contextlib.suppress(OSError):
                    urlopen(f"{url}/livez", timeout=5).close()
                    break
                if process.poll() is not None:
                    sys.exit(f"the service did not start:\n{log.read_text()}")
                time.sleep(0.1)
            yield url
        finally:
            process.terminate()
            process.wait(20)


def mixed(url: str) -> None:
    """The paper's fourth-order example with known parameters."""
    model = engine.get_model("mixed-4")
    y = engine.simulate(model, None, 200, np.random.default_rng(1)).y
    truth = model.theta().asdict()
    start = {"theta_1": 0.7, "theta_2": 0.5, "theta_3": 0.2, "theta_4": 0.9, "theta_5": 0.4}
    print("1. mixed-4 (paper, eq. (35)): 200 samples simulated, five parameters to find")
    found = results(
        url,
        {
            "kind": "estimate",
            "model": "mixed-4",
            "series": [{"y": y.tolist(), "dt": 1.0}],
            "parameters": {"start": start},
            "options": {"particles": 50, "iterations": 100, "seed": 1},
        },
    )
    table(found, start, truth, "truth")


def nile(url: str) -> None:
    """The Nile at Aswan, 1871-1970, against the published maximum-likelihood estimates."""
    start = {"r": 10000.0, "q": 5000.0, "level": 1120.0}
    print("2. local-level: the Nile's yearly flows 1871-1970, measured")
    found = results(
        url,
        {
            "kind": "estimate",
            "model": "local-level",
            "series": [flows()],
            "parameters": {"start": start, "free": ["r", "q"]},
            "options": {"method": "rts-em", "iterations": 300},
        },
    )
    table(found, start, NILE_PUBLISHED, "published")
    print("   (published with a first level that is not known at all; here it is known to +- r)\n")


def diagnosis(url: str) -> None:
    """What that model leaves out of the Nile's flows: the dam at Aswan."""
    print("3. local-level: what does this model leave out of the Nile's flows?")
    found = results(url, {"kind": "diagnose", "model": "local-level", "series": [flows()]})
    verdict = found["diagnosis"]["page"].partition("\n\n")[0]
    print("\n".join(f"   {line}" for line in verdict.splitlines()[2:]))
    for cause in found["diagnosis"]["causes"]:
        for name, value in cause["parameters"].items():
            print(f"   {name} = {value:.5g}")
    print()


def flows() -> dict[str, Any]:
    """The Nile's yearly flows as a series; times are years."""
    series = engine.data.nile()
    return {"y": series.y.tolist(), "t": series.t.tolist(), "time_unit": series.time_unit}


def results(url: str, request: dict[str, Any]) -> dict[str, Any]:
    """POST /jobs, follow the progress, return the results."""
    job = call(f"{url}/jobs", request)
    here = f"{url}/jobs/{job['jobID']}"
    print(f"   POST /jobs -> {here.removeprefix(url)}")
    while job["status"] in ("accepted", "running"):
        show(job)
        time.sleep(0.2)
        job = call(here)
    show(job)
    print()
    if job["status"] != "successful":
        sys.exit(f"   the job {job['status']}: {job['message']}")
    return call(f"{here}/results")


def call(url: str, body: Any = None) -> dict[str, Any]:
    """JSON out, JSON in."""
    data = None if body is None else json.dumps(body).encode()
    with urlopen(Request(url, data, {"Content-Type": "application/json"}), timeout=60) as answer:
        document: dict[str, Any] = json.load(answer)
    return document


def show(job: dict[str, Any]) -> None:
    """One line of progress; on a terminal it is written over."""
    if not sys.stdout.isatty() and job["status"] in ("accepted", "running"):
        return
    done = job["progress"] // 4
    likelihood = job["log_likelihood"]
    text = f"   [{'#' * done:<25}] {job['iteration']:3d} of {job['iterations']}"
    text += f"  {job['status']:<10}"
    text += "" if likelihood is None else f"  log-likelihood {likelihood:.1f}"
    said = job["message"][:40] if job["status"] == "running" else ""
    print(f"\r{text}  {said:<40}" if sys.stdout.isatty() else text, end="", flush=True)


def table(
    found: dict[str, Any], start: dict[str, float], known: dict[str, float], known_as: str
) -> None:
    """Estimates beside what is known."""
    print(f"   {found['message']}")
    print(f"   {'':<10}{'start':>12}{'estimate':>12}{'std. error':>12}{known_as:>12}")
    for name, value in known.items():
        entry = found["estimate"][name]
        error = entry["standard_error"]
        shown = "-" if error is None else f"{error:.4g}"
        print(f"   {name:<10}{start[name]:>12.5g}{entry['value']:>12.5g}{shown:>12}{value:>12.5g}")
    value = found["log_likelihood"]
    print(f"   log-likelihood {value['value']:.2f} +- {value['standard_error']:.2f}\n")


if __name__ == "__main__":
    main()
