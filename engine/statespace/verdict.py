"""What is known of the calls of one kind that a model's function takes."""

from __future__ import annotations

import numpy as np

from engine.statespace.rows import Array, Kind, Rows
from engine.statespace.trial import Trial

OFTEN = 8  # passes over a record of which the first call is looked at ...
SOME = 4  # ... and then one in so many: they are of the function itself, as it is now


class Verdict:
    """Whether calls of a kind are taken, how many there were, and the next one not to be trusted.

    ``trial`` makes them: of the function itself, or of what was recorded of it.
    """

    __slots__ = ("asked", "calls", "due", "next", "ranges", "takes", "trial")

    def __init__(self, trial: Trial) -> None:
        self.trial, self.takes, self.calls, self.asked = trial, True, 0, 0
        self.ranges: Array | None = None  # of inputs and times of the calls so far, see ranges_of
        self.due = self.next = 1  # ``due`` is the next call to be looked at thoroughly

    def look_again(self, recorded: bool) -> None:
        """Look at the next call where it is ``recorded``, else often at first, then at some of the passes."""
        self.asked += 1
        if recorded or self.asked <= OFTEN or self.asked % SOME == 0:
            self.next = self.calls + 1

    def restart(self, trial: Trial) -> None:
        """Make calls otherwise from this one on, which is looked at."""
        self.trial, self.takes, self.calls = trial, True, 1
        self.due = self.next = 1

    def refuse(self) -> None:
        """No, for good."""
        self.takes, self.next = False, 0


def ranges_of(rows: Rows, kind: Kind) -> Array:
    """Largest and minus the smallest value of each input and time (3, n) that differs, and how far it goes."""
    columns = np.array(rows.columns(kind._replace(fields=())), dtype=float)
    if not len(columns):  # u has no entries
        return np.zeros((3, 0))
    highest, lowest = columns.max(axis=1), columns.min(axis=1)
    return np.array([highest, -lowest, highest - lowest])
