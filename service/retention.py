"""The data of ended jobs are kept for a time; then their rows remain, as after a DELETE."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from service.store import Store

log = logging.getLogger("service")

SWEEP_SECONDS = 3600.0
DAY = 86_400.0


class Retention:
    """Removes what is older than ``days`` (0: nothing), once an hour at most.

    Ages are by the wall clock, which may be wrong, as after a start without a network. So nothing is
    removed in the first hour, nor in an hour in which the clock was set.
    """

    def __init__(
        self,
        store: Store,
        days: float,
        clock: Callable[[], float] = time.monotonic,
        wall: Callable[[], float] = time.time,
    ) -> None:
        self._store, self._days, self._clock, self._wall = store, days, clock, wall
        self._last = clock(), wall()

    def look(self) -> int:
        """Remove what has had its time, if it is time to; how many jobs."""
        now, wall = self._clock(), self._wall()
        passed, shown = now - self._last[0], wall - self._last[1]
        if not self._days or passed < SWEEP_SECONDS:
            return 0
        self._last = now, wall
        if abs(shown - passed) > SWEEP_SECONDS / 10:
            log.warning("the clock was set by %.0f s; nothing is removed now", shown - passed)
            return 0
        if removed := self._store.purge(wall - self._days * DAY):
            log.info("the data of %d jobs were removed after %g days", removed, self._days)
        return removed
