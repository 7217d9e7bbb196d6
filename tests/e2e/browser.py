"""A real Chromium without a window, and a service for it to look at."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

FLAGS = [
    "--headless=new",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
]
DESK = {"width": 1280, "height": 900}
PATIENCE = 600_000.0  # ms: the machine may be shared with long studies


def chromium() -> str | None:
    """Path of an installed Chromium, or None."""
    names = ("chromium", "chromium-browser", "google-chrome")
    return next((path for path in map(shutil.which, names) if path), None)


@contextmanager
def service(state: Path, **settings: Any) -> Iterator[str]:
    """``python -m service`` on a free port with its state in ``state``; its address."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    values = {"port": port, "state_dir": state, "workers": 1} | settings
    env = {f"RBPS_{name.upper()}": str(value) for name, value in values.items()}
    with open(state / "log", "ab") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "service"], env=os.environ | env, stderr=log
        )
        try:
            address = f"http://127.0.0.1:{port}"
            _wait_until_it_answers(process, address)
            yield address
        finally:
            process.terminate()
            process.wait(PATIENCE / 1000)


def _wait_until_it_answers(process: subprocess.Popen[bytes], address: str) -> None:
    """Raises RuntimeError if the process ends instead, TimeoutError if nothing answers."""
    last = time.monotonic() + PATIENCE / 1000
    while time.monotonic() < last:
        if process.poll() is not None:
            raise RuntimeError(f"the service has ended with code {process.returncode}")
        try:
            if httpx.get(f"{address}/livez").status_code == 200:
                return
        except httpx.TransportError:
            pass  # it does not listen yet
        time.sleep(0.05)
    raise TimeoutError(f"nothing answers at {address}")


@contextmanager
def browser() -> Iterator[Any]:
    """Chromium with a profile of its own, which is thrown away."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        started = driver.chromium.launch(
            executable_path=chromium(), args=FLAGS, timeout=PATIENCE, chromium_sandbox=False
        )
        yield started
        started.close()


class Watched:
    """Opens pages and remembers what they say and whom they ask."""

    def __init__(self, chrome, address):
        self.chrome, self.address = chrome, address
        self.errors, self.asked, self.contexts, self.provoked = [], [], [], []

    def __call__(self, path, address=None, **options):
        context = self.chrome.new_context(**{"viewport": DESK} | options)
        context.set_default_timeout(PATIENCE)
        self.contexts.append(context)
        page = context.new_page()
        self.listen(page)
        page.goto((address or self.address) + path)
        return page

    def listen(self, page):
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on(
            "console", lambda said: self.errors.append(said.text) if said.type == "error" else 0
        )
        page.on("request", lambda request: self.asked.append(request.url))

    def expect(self, words):
        """Chromium reports every answer 4xx; those a test provokes are no errors, also where one comes late."""
        page = self.contexts[-1].pages[0]
        eventually(page, lambda: any(words in error for error in self.errors))
        self.provoked.append(words)

    def check(self):
        for context in self.contexts:
            context.close()
        errors = [e for e in self.errors if not any(words in e for words in self.provoked)]
        assert not errors, errors
        assert self.asked
        foreign = re.compile(r"(?!http://127\.0\.0\.1:|data:|blob:|file:)")
        assert [url for url in self.asked if foreign.match(url)] == []


def ready(page):
    page.wait_for_selector("form[data-ready]")


def eventually(page, holds):
    """Asked from here: the pages' own policy forbids the text of a condition to be run in them."""
    last = time.monotonic() + PATIENCE / 1000
    while not holds():
        assert time.monotonic() < last, "not within the patience of the tests"
        page.wait_for_timeout(100)
