"""Progress on stderr: a bar with the remaining time on a terminal, now and then a line elsewhere."""

from __future__ import annotations

import sys
import time
from typing import TextIO

WIDTH = 30
EVERY = 30.0  # seconds between plain lines


class Progress:
    """Counts finished runs out of ``total``; ``done`` were there before."""

    def __init__(self, label: str, total: int, done: int = 0, stream: TextIO | None = None) -> None:
        self.label, self.total, self.before, self.done = label, total, done, done
        self.stream = sys.stderr if stream is None else stream
        self.bar = self.stream.isatty()
        self.started = self.shown = time.monotonic()

    def step(self) -> None:
        """One more run is finished."""
        self.done += 1
        now = time.monotonic()
        last = self.done >= self.total
        if self.bar:
            end = "\n" if last else ""
            self.stream.write(f"\r{self.line(now)}\x1b[K{end}")
        elif last or now - self.shown >= EVERY:
            self.shown = now
            self.stream.write(self.line(now) + "\n")
        self.stream.flush()

    def line(self, now: float) -> str:
        """Label, bar, counts, elapsed and remaining time."""
        elapsed = now - self.started
        new = self.done - self.before
        left = elapsed / new * (self.total - self.done) if new else float("nan")
        full = round(WIDTH * self.done / max(self.total, 1))
        bar = "#" * full + "." * (WIDTH - full)
        return (
            f"{self.label} [{bar}] {self.done}/{self.total}  {clock(elapsed)} gone, "
            f"{clock(left)} to go"
        )


def clock(seconds: float) -> str:
    """90.0 -> 1:30, 3700 -> 1:01:40."""
    if not seconds >= 0.0:
        return "?"
    minutes, s = divmod(round(seconds), 60)
    hours, m = divmod(minutes, 60)
    return f"{hours}:{m:02d}:{s:02d}" if hours else f"{m}:{s:02d}"
