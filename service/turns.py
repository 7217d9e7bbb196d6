"""Who makes room: no key keeps all places for as long as its computations last.

A key that waits gets the place of another that has more. Of that key's attempts the longest at work is
asked to leave; it does so at its next checkpoint, where nothing is lost, and its task goes back to the queue.
Where no checkpoint comes it is taken away, and next time has twice as long: so it ends in spite of that,
having computed at most a few times what it needed.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

from service.clocks import Awake


@dataclass(frozen=True)
class Running:
    """An attempt, as the store has it."""

    token: str
    owner: str
    asked: bool  # to leave at its next checkpoint
    taken: int  # how often attempts at its task were taken away since its latest checkpoint


class Turns:
    """Whom to ask, and whom to take the place away, so that keys have their turns.

    An attempt has ``seconds`` from when it is first seen before it is asked, and as long again, doubled
    for each time that it was taken away before, until it is.
    """

    def __init__(
        self, seconds: float, longest: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._seconds, self._awake = seconds, Awake(longest, clock)
        self._seen: dict[str, float] = {}

    def look(
        self, running: Sequence[Running], waiting: Collection[str]
    ) -> tuple[Running | None, Running | None]:
        """Which attempt to ask, and which to take away, where no place is free and owners are waiting."""
        now = self._awake.look()
        self._seen = {one.token: self._seen.get(one.token, now) for one in running}
        age = {token: now - since for token, since in self._seen.items()}
        has = Counter(one.owner for one in running)
        wants = min((has[owner] for owner in waiting), default=None)
        if wants is None:
            return None, None
        overdue = [
            one
            for one in running
            if one.asked
            and has[one.owner] > wants
            and age[one.token] >= self._seconds * (1 + 2 ** min(one.taken, 40))
        ]
        leaving = Counter(one.owner for one in running if one.asked)
        most = max(n - leaving[owner] for owner, n in has.items()) if has else 0
        richest = [
            one
            for one in running
            if not one.asked
            and has[one.owner] - leaving[one.owner] == most
            and age[one.token] >= self._seconds
        ]
        poorer = sum(has[owner] < most for owner in waiting)
        enough = leaving.total() >= poorer  # they get a place each
        oldest = None if enough else max(richest, key=lambda one: age[one.token], default=None)
        return oldest, max(overdue, key=lambda one: age[one.token], default=None)
