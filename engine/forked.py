"""Independent parts of a computation on several cores, by copies of this process.

A copy has all that this process has, models and functions included, which could not be sent to another; what
it finds is sent back. So nothing changes but the time: what no copy has found is computed here.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from types import TracebackType
from typing import IO, Any, Self, TypeVar

T = TypeVar("T")

MANY = 16  # short tasks, for which a copy is worth its hundredth of a second

_PROCESSES: ContextVar[int] = ContextVar("processes", default=1)


@contextmanager
def in_processes(n: int | None) -> Iterator[None]:
    """Have :class:`Copies` share their tasks among ``n`` processes, this one included.

    None: as many as there are cores. But where this process has several threads, only if ``n`` says so: a copy
    has none of the others, and waits for ever for what one of them held. Nor where it is one of a pool, whose
    others have the cores.
    """
    if n is None:
        alone = threading.active_count() == 1 and multiprocessing.parent_process() is None
        n = _cores() if alone else 1
    before = _PROCESSES.set(n if sys.platform == "linux" else 1)  # elsewhere copies are not safe
    try:
        yield
    finally:
        _PROCESSES.reset(before)


def each(tasks: Sequence[Callable[[], T]]) -> Generator[T, None, None]:
    """What all these short ``tasks`` find, in their order, shared with copies of this process. To be closed.

    A few of them are done in less time than a copy takes.
    """
    with Copies(tasks if len(tasks) >= MANY else ()) as copies:
        for i, task in enumerate(tasks):
            found = copies.take(i)
            yield task() if found is None else found


class Copies:
    """While it is open, copies of this process do their share of ``tasks``, each of its own in their order.

    A task takes no arguments and returns what can be pickled.
    """

    def __init__(self, tasks: Sequence[Callable[[], Any]]) -> None:
        self._tasks = tasks
        self._found: dict[int, IO[bytes]] = {}  # by the number of a task, what its copy sends
        self._copies: list[int] = []

    def __enter__(self) -> Self:
        n = min(_PROCESSES.get(), len(self._tasks))
        for k in range(1, n):
            self._begin(range(k, len(self._tasks), n))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for copy in self._copies:
            with suppress(
                ProcessLookupError, ChildProcessError
            ):  # where ended children are not waited for
                os.kill(copy, signal.SIGKILL)
                os.waitpid(copy, 0)
        for found in set(self._found.values()):
            found.close()

    def take(self, i: int) -> Any:
        """What a copy has found of task i, once it is there; None where it is to be done here.

        As where it failed in the copy. Tasks are taken in their order.
        """
        if i not in self._found:
            return None
        try:
            return pickle.load(self._found[i])  # of a copy of this process
        except (EOFError, pickle.UnpicklingError):  # the copy was killed
            return None

    def _begin(self, own: range) -> None:
        """A copy that does these tasks; none where there is no room for another process."""
        there, back = os.pipe()
        here = os.getpid()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # of threads of linear algebra
                copy = os.fork()
        except OSError:
            os.close(there)
            os.close(back)
            return
        if copy == 0:
            try:
                os.close(there)
                for one in (signal.SIGINT, signal.SIGTERM):
                    signal.signal(one, signal.SIG_DFL)
                self._do(own, here, back)
            finally:
                os._exit(0)  # without what this process would do at its end
        os.close(back)
        self._copies.append(copy)
        self._found |= dict.fromkeys(own, os.fdopen(there, "rb"))

    def _do(self, own: range, parent: int, back: int) -> None:
        """In the copy: the tasks, each sent as soon as it is done; an end where nobody waits."""
        _PROCESSES.set(1)
        with os.fdopen(back, "wb") as out:
            for i in own:
                if os.getppid() != parent:
                    return
                try:
                    found = pickle.dumps(self._tasks[i]())
                except Exception:  # noqa: BLE001 - it is done again where it is heard
                    found = pickle.dumps(None)
                out.write(found)
                out.flush()


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
