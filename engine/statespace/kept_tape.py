"""The tape of a function as it is kept from pass to pass, and how it learns the ways through the function."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from engine.statespace.evaluation import ModelFunction
from engine.statespace.rows import Array
from engine.statespace.tape import Lines, Tape, lines_of
from engine.statespace.ways import PartedError, UnrecordedError, Way, merged, parted, record_way

WAYS = 16  # through a function: more take longer to learn than they save in the screens of many effects
NEW = 3  # passes of a tape, which are looked at from their beginning, too
# states (M, na), inputs (M, nu), time and step (M, 2) and parameters (M, n) of rows
Rows = tuple[Array, Array, Array, Array]


class OfRecord(NamedTuple):
    """The inputs ``u`` (T, nu), times ``t`` and steps ``dt`` (T,) of a record, the last step of no meaning.

    The function is ``called`` (T,) at these rows: the dynamics neither at the last one nor where a record ends.
    """

    u: Array
    t: Array
    dt: Array
    called: NDArray[np.bool_]


@dataclass
class KeptTape:
    """The ``tape`` of a function, of all ``ways`` through it that were met.

    How often it was gone through, and left. From so many passes on it is ``known``. The function is called
    where ``over``, and at uneven steps where it is ``even_only``; ``where`` is the place in it that cannot be
    recorded.
    """

    tape: Tape | None = None
    ways: list[Way] = field(default_factory=list)
    over: bool = False
    even_only: bool = False
    passes: int = 0
    known: int = 0
    left: int = 0
    where: str = ""

    def has_any(self, dt: float | None) -> bool:
        """Whether there may be a tape for steps of ``dt``, or for uneven ones."""
        return not (self.over or (dt is None and self.even_only))

    def lines(self, thetas: Array, copies: int, dt: float | None, record: OfRecord) -> Lines | None:
        """The lines for these parameters. None where there are none. Raises LeftError."""
        if self.tape is None:
            return None
        found = lines_of(self.tape, thetas, copies, dt, record[:3])
        if found is None:  # something that no kernel does
            self.even_only, self.over = True, dt is not None
        return found

    def learn(self, function: ModelFunction, rows: Rows, theta: Any) -> int | None:
        """Take in another way that some of the rows take; the first row that takes it, None where none does.

        The tape is as it was where the way cannot be taken in.
        """
        columns = [x for each in rows for x in each.T]
        row = 0 if self.tape is None else parted(self.tape.way, columns)
        if row is None or len(self.ways) >= WAYS:
            return None
        own = [each[row] for each in rows]
        try:
            way = record_way(function, own, theta._make(own[-1]))
            one = merged([*self.ways, way], sum(map(len, own)))
        except UnrecordedError as error:
            self.where = str(error)
            return None
        except PartedError:
            return None
        if parted(one, columns) == row:  # rounding decides
            return None
        self.ways.append(way)
        na, nu, _, parameters = map(len, own)
        self.tape = Tape((na, nu, parameters), one)
        self.known = self.passes + NEW
        return row

    def learn_all(self, function: ModelFunction, rows: Rows, theta: Any) -> list[int]:
        """Take in all ways that rows take; the first row of each that was new."""
        found = list[int]()
        while (row := self.learn(function, rows, theta)) is not None:
            found.append(row)
        return found


def rows_of(record: OfRecord, a: Array, theta: Array) -> Rows:
    """The rows of a record at which the function is called, at the same states and parameters."""
    clock = np.stack([record.t, record.dt], axis=1)[record.called]
    n = len(clock)
    return np.tile(a, (n, 1)), record.u[record.called], clock, np.tile(theta, (n, 1))
