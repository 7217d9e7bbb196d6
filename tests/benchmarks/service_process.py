"""``python -m service`` for the load and chaos runs, and the jobs they submit."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np

import engine
from tests.benchmarks.machine import below, processes

ENDED = ("successful", "failed", "dismissed")


class ServiceProcess:
    """A service that can be killed and started again on the same port and store."""

    def __init__(self, state: Path, **settings: Any) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        values = {"port": port, "state_dir": state} | settings
        self._env = os.environ | {f"RBPS_{k.upper()}": str(v) for k, v in values.items()}
        self._log = (state / "log").open("ab")
        self.log = state / "log"
        self.environment: dict[str, str] = {}  # of the next start, beyond this process's own
        self.url = f"http://127.0.0.1:{port}"
        self.start()
        self.wait_until_up()

    def start(self) -> None:
        """Start; it does not answer yet."""
        command = [sys.executable, "-m", "service"]
        env = self._env | self.environment
        self.process = subprocess.Popen(command, env=env, stderr=self._log)

    def wait_until_up(self) -> None:
        """Return when it answers."""
        end = time.monotonic() + 300
        while time.monotonic() < end:
            if self.process.poll() is not None:
                raise RuntimeError(f"the service ended with {self.process.returncode}")
            with contextlib.suppress(httpx.TransportError):
                httpx.get(f"{self.url}/livez", timeout=5)
                return
            time.sleep(0.05)
        raise RuntimeError("the service did not start")

    def stop(self, how: int = signal.SIGTERM) -> None:
        """Send a signal and wait."""
        self.process.send_signal(how)
        self.process.wait(60)

    def below(self) -> list[int]:
        """The forkserver, its tracker and the workers."""
        return sorted(below(self.process.pid, processes()) - {self.process.pid})


def request(seed: int, samples: int = 200, iterations: int = 30, **options: Any) -> dict[str, Any]:
    """An estimation of one parameter of mixed-4."""
    model = engine.get_model("mixed-4")
    y = engine.simulate(model, None, samples, np.random.default_rng(seed)).y
    return {
        "kind": "estimate",
        "model": "mixed-4",
        "series": [{"y": y.tolist(), "dt": 1.0}],
        "parameters": {"start": {"theta_2": 0.5}, "free": ["theta_2"]},
        "options": {"iterations": iterations, "seed": seed, "standard_errors": False} | options,
    }
