"""The finished parts of a computation on a state file, from which an interrupted one goes on."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from engine.errors import EngineError, OptionError
from engine.statespace.model import Array
from service.cli.ending import Code, Ending, Interrupt, wrong
from service.cli.meter import Meter, duration
from service.cli.state_file import StateFile

TOLD = 0.1  # of a stage: sooner its remaining time would be a guess


class Kept(dict[str, Any]):
    """The parts by name, and the place where Ctrl-C ends the computation.

    Rows of the file: one, the per cent done.
    """

    def __init__(
        self, file: StateFile, shown: Meter, rows: Array | None = None, left: Sequence[Any] = ()
    ) -> None:
        super().__init__(left)
        self.file, self.shown, self.percent = file, shown, 0
        if rows is not None:
            self.percent = int(rows[0, 0])
            shown.note(f"going on at {self.percent} %")
        self.interrupt = Interrupt()
        self.stage, self.since, self.first = "", 0.0, 0.0

    def __setitem__(self, name: str, part: Any) -> None:
        super().__setitem__(name, part)
        if self.file.due:
            self.save()
        self.interrupt.check()

    def step(self, k: int, message: str = "", share: float | None = None) -> None:
        """Per cent done; fewer than before while what was kept is gone through."""
        self.percent = max(self.percent, k)
        self.shown.at(self.percent, message + self._left(message, share))
        self.interrupt.check()

    def _left(self, message: str, share: float | None) -> str:
        """The time that is left of a stage whose steps are counted, by its pace so far."""
        stage, now = message.partition(",")[0], time.monotonic()
        if share is None or stage != self.stage or share < self.first:
            self.stage, self.since, self.first = stage, now, share or 0.0
            return ""
        done = share - self.first
        if done < TOLD:
            return ""
        return f", about {duration((now - self.since) / done * (1.0 - share))} left of this"

    def save(self) -> None:
        """Write the state."""
        self.file.save(np.array([[self.percent]]), list(self.items()))

    def settle(self) -> None:
        """At the end the state is removed, unless it was asked for by name."""
        if self.file.asked.keep:
            self.save()
        self.file.remove()

    @contextmanager
    def going(self, interrupted: Callable[[], Ending]) -> Iterator[None]:
        """Within, the parts are made; when that is ``interrupted``, what is done is saved."""
        try:
            with self.interrupt.held():
                yield
        except KeyboardInterrupt:
            self.save()
            raise interrupted() from None
        except EngineError as error:
            if isinstance(error, OptionError) and error.field == "kept":
                raise wrong(f"--resume: {error}") from None
            self.file.remove()  # from here nothing leads on
            raise

    def interrupted(self, text: str = "", **more: Any) -> Ending:
        """What is said at Ctrl-C, with a ``text`` behind it."""
        said = f"interrupted at {self.percent} %. Go on with\n  {self.file.again}{text}"
        state = str(self.file.path)
        return Ending(Code.INTERRUPTED, said, state=state, percent=self.percent, **more)
