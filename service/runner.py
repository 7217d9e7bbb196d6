"""Where attempts run: each in a fresh process that one thread watches.

``watch`` is the whole life of an attempt as seen from outside; a runner only says on which machine
it happens. A killed worker loses its own attempt and nothing else, which shared pools cannot say.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from multiprocessing import connection
from multiprocessing.process import BaseProcess
from typing import Protocol

from sqlalchemy.exc import SQLAlchemyError

from service.attempt import main
from service.clocks import Awake
from service.problems import OUT_OF_TIME, Problem
from service.processes import cause_of_end, joined, kill, start
from service.settings import Settings
from service.store import Store
from service.transitions import Attempt

log = logging.getLogger("service")

POLL_SECONDS = 0.25  # how soon a cancelled job's process is killed


class Runner(Protocol):
    """Runs attempts somewhere."""

    def capacity(self) -> int:
        """How many attempts can run at once; 0 if nothing can be reached that runs them."""

    def free(self) -> int:
        """How many more attempts can start now."""

    def running(self) -> int:
        """How many attempts there are."""

    def start(self, attempt: Attempt) -> None:
        """Start an attempt and return at once."""

    def stop(self, drain: bool) -> None:
        """Let running attempts end (drain), or give them back to the queue; then return."""


class LocalRunner:
    """A bounded number of worker processes on this machine."""

    def __init__(
        self, store: Store, settings: Settings, on_free: Callable[[], None] = lambda: None
    ) -> None:
        self._store, self._settings, self._on_free = store, settings, on_free
        self._threads: dict[str, threading.Thread] = {}
        self._stopping = threading.Event()
        self._warm = threading.Event()  # claimed before, an attempt could be silent in waiting
        # Loading takes seconds, or on a new machine minutes: who stops does not wait for it.
        threading.Thread(target=self._warm_up, name="warm-up", daemon=True).start()

    def capacity(self) -> int:
        """How many attempts can run at once."""
        return self._settings.workers

    def free(self) -> int:
        """How many more attempts can start now."""
        return self._settings.workers - len(self._threads) if self._warm.is_set() else 0

    def running(self) -> int:
        """How many attempts there are."""
        return len(self._threads)

    def start(self, attempt: Attempt) -> None:
        """Start an attempt and return at once."""
        thread = threading.Thread(target=self._run, args=(attempt,), name=attempt.job_id)
        self._threads[attempt.token] = thread
        try:
            thread.start()
        except RuntimeError:  # the machine has no thread left
            del self._threads[attempt.token]
            raise

    def stop(self, drain: bool) -> None:
        """Let running attempts end (drain), or give them back to the queue; then return."""
        if not drain:
            self._stopping.set()
        for thread in list(self._threads.values()):
            thread.join()

    def _warm_up(self) -> None:
        """Let the forkserver load the engine, or on a new machine compile its kernels."""
        try:
            warm_up()
        except (OSError, EOFError):  # the first attempt tries again, and is given back if it fails
            log.exception("no worker process could be started to load the engine ahead")
        finally:
            self._warm.set()
            self._on_free()

    def _run(self, attempt: Attempt) -> None:
        try:
            watch(self._store, attempt, self._settings, self._stopping)
        finally:
            self._threads.pop(attempt.token)
            self._on_free()


def watch(store: Store, attempt: Attempt, settings: Settings, stopping: threading.Event) -> None:
    """Run an attempt in a process of its own until it ends; nothing of it is left on return.

    Keeps the heartbeat, and kills the process when the task is no longer the attempt's (cancelled,
    or given to another), when its time is up, or when the service stops.
    """
    job = {"job": attempt.job_id}
    try:
        process = _started(store, attempt, settings)
    except (OSError, EOFError):  # the forkserver was killed, or the machine has no process left
        log.exception("no worker process could be started; the task is queued again", extra=job)
        store.release(attempt)
        stopping.wait(POLL_SECONDS)
        return
    log.info("attempt started, process %s", process.pid, extra=job)
    try:
        cause = _until_end(store, attempt, settings, stopping, process)
    finally:
        kill(process)
    try:
        if cause is not None:
            cause()
        elif store.holds(attempt):  # ended without a word to the store
            store.lost(attempt, cause_of_end(process), settings.losses_allowed)
    except SQLAlchemyError:  # nobody beats for it any more, and the task is queued again
        log.exception("the end of the attempt could not be written", extra=job)
    log.info("attempt ended, exit code %s", process.exitcode, extra=job)


def _started(store: Store, attempt: Attempt, settings: Settings) -> BaseProcess:
    """Spawn; the heartbeat goes on meanwhile, for a new forkserver has to load the engine first."""
    with ThreadPoolExecutor(1) as pool:
        work = (store.url, attempt, settings.worker_memory, settings.own_models)
        process = pool.submit(start, main, work)
        while wait([process], settings.lease_seconds / 4).not_done:
            store.renew(attempt)
        return process.result()


def warm_up() -> None:
    """Return when the forkserver has the engine loaded; says so if workers cannot start."""
    process = joined(start(int, ()))
    if process.exitcode:
        log.error("no job will be computed: %s", cause_of_end(process))


def _until_end(
    store: Store,
    attempt: Attempt,
    settings: Settings,
    stopping: threading.Event,
    process: BaseProcess,
) -> Callable[[], object] | None:
    """Wait; returns what to write to the store once the process is dead, if anything."""
    awake, renewed = Awake(max(settings.lease_seconds / 4, 2 * POLL_SECONDS)), 0.0
    run_seconds = min(settings.run_seconds, attempt.run_seconds or settings.run_seconds)
    left = run_seconds - attempt.spent
    while not connection.wait([process.sentinel], POLL_SECONDS):
        now = awake.look()
        if stopping.is_set():
            return lambda: store.release(attempt)
        if now > left:
            detail = (
                f"the computation took longer than the {run_seconds:g} s it may take; it can go on"
            )
            problem = Problem(422, OUT_OF_TIME, detail).document()
            return lambda: store.fail(attempt, problem)
        try:
            if now - renewed >= settings.lease_seconds / 4:
                mine, renewed = store.renew(attempt), now
            else:
                mine = store.holds(attempt)
        except SQLAlchemyError as error:
            log.warning("the store does not answer: %s", error, extra={"job": attempt.job_id})
            mine = now - renewed < settings.lease_seconds
        if not mine:
            return lambda: None
    return None
