"""Where attempts run: each in a fresh process that one thread watches.

``watch`` is the whole life of an attempt as seen from outside; a runner only says on which machine
it happens. A killed worker loses its own attempt and nothing else, which shared pools cannot say.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from multiprocessing import connection, resource_tracker
from multiprocessing.context import ForkServerContext
from multiprocessing.process import BaseProcess
from typing import Protocol

from sqlalchemy.exc import SQLAlchemyError

from service.attempt import STORE_FAILED, main
from service.clocks import Awake
from service.lasting import Lasting
from service.problems import Problem
from service.settings import Settings
from service.store import Store
from service.transitions import Attempt

log = logging.getLogger("service")

POLL_SECONDS = 0.25  # how soon a cancelled job's process is killed
START_TRIES = 3
GUARD = "create_app() and uvicorn.run() belong under `if __name__ == '__main__':`"
# The forkserver is killed when the thread that started it ends (``preload``): one that lasts.
_starter = Lasting("starter")
_starting = threading.Lock()  # multiprocessing polls all children when it starts one


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
        _kill(process)
    try:
        if cause is not None:
            cause()
        elif store.holds(attempt):  # ended without a word to the store
            store.lost(attempt, _cause_of_end(process), settings.losses_allowed)
    except SQLAlchemyError:  # nobody beats for it any more, and the task is queued again
        log.exception("the end of the attempt could not be written", extra=job)
    log.info("attempt ended, exit code %s", process.exitcode, extra=job)


def _started(store: Store, attempt: Attempt, settings: Settings) -> BaseProcess:
    """Spawn; the heartbeat goes on meanwhile, for a new forkserver has to load the engine first."""
    with ThreadPoolExecutor(1) as pool:
        work = (store.url, attempt, settings.worker_memory, settings.own_models)
        process = pool.submit(_start, main, work)
        while wait([process], settings.lease_seconds / 4).not_done:
            store.renew(attempt)
        return process.result()


def _context() -> ForkServerContext:
    """Processes forked from a server that has the engine loaded and only one thread."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"  # the forkserver inherits them
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["service.preload"])
    return context


def warm_up() -> None:
    """Return when the forkserver has the engine loaded; says so if workers cannot start."""
    process = _start(int, ())
    with _starting:
        process.join()
    if process.exitcode:
        log.error("no job will be computed: %s", _cause_of_end(process))


def _start(target: Callable[..., object], args: tuple[object, ...]) -> BaseProcess:
    """Start a process; a forkserver that was killed is replaced by the next try."""
    for tries_left in reversed(range(START_TRIES)):
        try:
            return _starter(_begin, target, args)
        except (OSError, EOFError):
            if not tries_left:
                raise
            threading.Event().wait(0.1)  # under a faked clock time.sleep may fail
    raise AssertionError("unreachable")


def _begin(target: Callable[..., object], args: tuple[object, ...]) -> BaseProcess:
    with _starting:
        process = _context().Process(target=target, args=args, daemon=True)
        # Ctrl-C reaches all processes of a terminal and is the service's to handle: the forkserver inherits
        # that this thread hears nothing of it. The tracker goes first, for its start lets the thread hear.
        resource_tracker.ensure_running()
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        process.start()
    return process


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
            detail = f"the computation took longer than the {run_seconds:g} s it may take"
            problem = Problem(422, "run-time-exceeded", detail).document()
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


def _kill(process: BaseProcess) -> None:
    process.kill()
    with _starting:
        process.join()


def _cause_of_end(process: BaseProcess) -> str:
    """Why a worker process ended without a word to the store."""
    code = process.exitcode
    if code is not None and code < 0:
        hint = " (the system may have run out of memory)" if code == -9 else ""
        return f"the worker process was killed by signal {-code}{hint}"
    if code == STORE_FAILED:
        return "the store could not be written (its disk may be full)"
    hint = f" (the log says why; in a script of your own, {GUARD})" if code == 1 else ""
    return f"the worker process ended with exit code {code}{hint}"
