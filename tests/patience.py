"""Waiting for others: as long as the machine needs, however busy it is, and not for ever."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any


def slowness() -> float:
    """By how much a machine that others use too is slower than an idle one."""
    return max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def eventually(
    what: Callable[[], Any],
    seconds: float = 120.0,
    pause: Callable[[], Any] = lambda: time.sleep(0.02),
    said: Callable[[], Any] = lambda: "",
) -> Any:
    """What ``what`` returns as soon as that is true; patience costs nothing where all is well.

    Raises AssertionError with what was ``said`` where that takes longer than the ``seconds`` of an idle
    machine.
    """
    begin = time.monotonic()
    while not (found := what()):
        if time.monotonic() - begin > seconds * slowness():
            raise AssertionError(f"still {found!r} after {seconds} s; {said()}")
        pause()
    return found
