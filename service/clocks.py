"""Time as one process lives through it; no clock of a wall or of another machine is ever compared.

A wall clock may be set, and stands still for nobody; a process may be stopped, or its machine be
suspended. So who waits for something looks again and again, and of the time between two looks only as
much counts as an awake process can have needed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping


class Awake:
    """Seconds that this process was awake, with at most ``longest`` between two looks."""

    def __init__(self, longest: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._longest, self._clock = longest, clock
        self._last, self._seconds = clock(), 0.0

    def look(self) -> float:
        """Seconds since it was made."""
        now = self._clock()
        self._seconds += min(now - self._last, self._longest)
        self._last = now
        return self._seconds


class Silence:
    """Which attempts nobody keeps any more: their heartbeats stand still for so many seconds.

    A heartbeat is a counter that its keeper increments, so that it tells the same on all machines.
    """

    def __init__(self, seconds: float, clock: Callable[[], float] = time.monotonic) -> None:
        # Four looks at least: a keeper that slept as long as this process has time to beat again.
        self._awake, self._limit = Awake(seconds / 4, clock), seconds
        self._since: dict[str, tuple[int, float]] = {}

    def look(self, beats: Mapping[str, int]) -> dict[str, int]:
        """Of these heartbeats by token, those that stand still too long."""
        now = self._awake.look()
        before, self._since = self._since, {}
        for token, beat in beats.items():
            same = token in before and before[token][0] == beat
            self._since[token] = before[token] if same else (beat, now)
        return {
            token: beat for token, (beat, since) in self._since.items() if now - since > self._limit
        }
