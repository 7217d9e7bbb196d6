"""What else the machine does while something is measured on it."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

Stat = tuple[int, str, int]  # parent, state, clock ticks of CPU time


def processes() -> dict[int, Stat]:
    """Every process there is."""
    found = {}
    for file in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = file.read_text().rpartition(")")[2].split()
        except (FileNotFoundError, ProcessLookupError):
            continue
        found[int(file.parent.name)] = int(fields[1]), fields[0], int(fields[11]) + int(fields[12])
    return found


def below(pid: int, all_: dict[int, Stat]) -> set[int]:
    """The process and its descendants."""
    own, before = {pid}, 0
    while len(own) > before:
        before = len(own)
        own |= {one for one, (parent, _, _) in all_.items() if parent in own}
    return own


class Watch:
    """Within ``with``: load average, and foreign processes that compute, looked at each second.

    A process is foreign if this one did not start it, nor its children; it is busy in a second of
    which it computed more than a fifth.
    """

    def __init__(self) -> None:
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._busy: list[int] = []
        self._cores: list[float] = []
        self._load: list[float] = []

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        ticks = os.sysconf("SC_CLK_TCK")
        before = processes()
        while not self._stop.wait(1.0):
            now = processes()
            own = below(os.getpid(), now)
            used = np.array(
                [
                    (stat[2] - before[pid][2]) / ticks
                    for pid, stat in now.items()
                    if pid not in own and pid in before
                ]
            )
            self._busy.append(int((used > 0.2).sum()))
            self._cores.append(float(used.sum()))
            self._load.append(os.getloadavg()[0])
            before = now

    def figures(self) -> dict[str, float]:
        """Means over the seconds watched, and how the scheduler favours this session (nice)."""
        group = Path("/proc/self/autogroup")  # nice within it counts against its own processes only
        return {
            "nice of the run's session": float(group.read_text().split()[-1])
            if group.exists()
            else 0.0,
            "cores": float(os.cpu_count() or 1),
            "load average": round(float(np.mean(self._load)), 2),
            "busy foreign processes": round(float(np.mean(self._busy)), 2),
            "cores used by foreign processes": round(float(np.mean(self._cores)), 2),
        }
