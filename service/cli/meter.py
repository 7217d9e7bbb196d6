"""Progress on stderr: a bar with the remaining time on a terminal, plain lines in a log."""

from __future__ import annotations

import os
import sys
import time
from functools import partial
from typing import Self

PROGRESS_LINES = 10  # lines of a whole run, about ...
PAUSE_SECONDS = 30.0  # ... and one after so many seconds without


class Meter:
    """Where a computation tells how far it is; a context manager. This one shows nothing."""

    def begin(self, total: int, done: int = 0, timed: bool = True) -> None:
        """There are ``total`` steps, ``done`` of them from before; ``timed`` where they take alike long."""

    def at(self, done: int, text: str = "") -> None:
        """So many are done."""

    def say(self, text: str) -> None:
        """What is going on now, where that is not a step."""

    def stage(self, text: str, share: float | None = None) -> None:
        """Something before or after the steps is done, for an unknown time where ``share`` is None."""

    def note(self, text: str) -> None:
        """A line that stays."""

    def warn(self, text: str) -> None:
        """A line that is shown whatever else is not."""
        print(f"rbps: {text}", file=sys.stderr, flush=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        """Leave the terminal clean."""


def meter(quiet: bool) -> Meter:
    """The meter that fits stderr."""
    if quiet:
        return Meter()
    if sys.stderr.isatty() and os.environ.get("TERM", "") not in ("", "dumb"):
        return Bar()
    return Lines()


class Lines(Meter):
    """A line for every tenth of the run, with the time that is left by the pace so far."""

    def begin(self, total: int, done: int = 0, timed: bool = True) -> None:
        """Remember when and where it began."""
        self.total, self.first, self.timed = max(total, 1), done, timed
        self.shown, self.since = done, time.monotonic()
        self.said = self.since

    def at(self, done: int, text: str = "") -> None:
        """Write a line where a tenth is done, or nothing was said for long."""
        now = time.monotonic()
        tenth = done * PROGRESS_LINES // self.total > self.shown * PROGRESS_LINES // self.total
        if not tenth and now - self.said < PAUSE_SECONDS:
            return
        self.shown, self.said = done, now
        left, mine = "", done - self.first
        told = mine * PROGRESS_LINES >= self.total  # sooner it would be a guess
        if self.timed and told and done < self.total:
            left = f", {duration((now - self.since) / mine * (self.total - done))} left"
        self.say(f"{done} of {self.total}{', ' if text else ''}{text}{left}")

    def say(self, text: str) -> None:
        """One line."""
        print(f"rbps: {text}", file=sys.stderr, flush=True)

    def stage(self, text: str, share: float | None = None) -> None:
        """One line; what it takes is no part of the steps' rate."""
        self.say(text)
        self.since, self.first = time.monotonic(), self.shown

    def note(self, text: str) -> None:
        """The same."""
        self.say(text)


class Bar(Meter):
    """A bar that is written over, with per cent, remaining time and the latest words."""

    def begin(self, total: int, done: int = 0, timed: bool = True) -> None:
        """Show the bar."""
        self.total, self.clocked = max(total, 1), timed
        self.update(total=self.total, completed=done, visible=True, timed=timed, count="")

    def at(self, done: int, text: str = "") -> None:
        """Move the bar."""
        count = f"{done}/{self.total}"
        self.update(total=self.total, completed=done, timed=self.clocked, count=count)
        if text:
            self.say(text)

    def say(self, text: str) -> None:
        """Words beside the bar."""
        self.update(words=text)

    def stage(self, text: str, share: float | None = None) -> None:
        """A bar of its own, which only moves to and fro where it is not known how long it takes."""
        total = None if share is None else 1.0
        done = 0.0 if share is None else share
        self.update(total=total, completed=done, timed=False, count="", words=text)

    def note(self, text: str) -> None:
        """A line above the bar."""
        self.progress.console.print(text, markup=False, highlight=False, soft_wrap=True)

    def warn(self, text: str) -> None:
        """The same."""
        self.note(text)

    def __enter__(self) -> Self:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
        from rich.progress import TimeRemainingColumn as Left
        from rich.text import Text

        class Clock(ProgressColumn):
            """What is left where steps take alike long, else nothing."""

            left = Left(compact=True, elapsed_when_finished=True)

            def render(self, task: Task) -> Text:
                return self.left.render(task) if task.fields["timed"] else Text("")

        self.progress = Progress(
            BarColumn(bar_width=24),
            TextColumn("{task.fields[count]}", markup=False),
            Clock(),
            TextColumn("{task.fields[words]}", markup=False),
            console=Console(stderr=True),
            transient=True,
        )
        task = self.progress.add_task("", total=None, words="", visible=False, timed=True, count="")
        self.update = partial(self.progress.update, task)
        self.progress.start()
        return self

    def __exit__(self, *raised: object) -> None:
        self.progress.stop()


def duration(seconds: float) -> str:
    """``40 s``, ``5 min``, ``2.5 h``."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
