r"""Attempts on other machines: the same ``watch`` inside a task of a Dask cluster.

    dask scheduler
    DASK_DISTRIBUTED__WORKER__DAEMON=False dask worker tcp://scheduler:8786 \
        --nworkers 4 --nthreads 1 --preload service.dask_runner
    RBPS_DASK_SCHEDULER=tcp://scheduler:8786 RBPS_DATABASE_URL=postgresql+psycopg://... \
        python -m service

Dask only says on which machine an attempt runs. Its worker starts the child process, keeps the
heartbeat, and kills the child; the store must be one that all machines reach (PostgreSQL). A worker
that disappears is reported by the scheduler, one that is cut off by its heartbeat.
"""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
from collections.abc import Callable
from functools import cache
from typing import Any, cast
from urllib.parse import urlsplit

import distributed
from sqlalchemy.exc import SQLAlchemyError

from service.logs import configure
from service.runner import warm_up, watch
from service.settings import Settings
from service.store import Store
from service.transitions import Attempt

log = logging.getLogger("service")


class DaskRunner:
    """As many attempts at once as the cluster's workers have threads."""

    def __init__(self, store: Store, settings: Settings, on_free: Callable[[], None]) -> None:
        self._store, self._settings, self._on_free = store, settings, on_free
        self._places, self._away = 0, False
        self._running: dict[str, tuple[Attempt, Any]] = {}
        self._ending, self._stopped = threading.Lock(), False
        self._client: Any = None  # until the scheduler is there; services need not start after it

    def _connect(self) -> Any:
        scheduler = self._settings.dask_scheduler
        where = urlsplit(scheduler)
        with socket.create_connection((where.hostname or "", where.port or 8786), 2.0):
            pass  # a Dask client that finds nobody leaves its threads behind
        made = cast(Any, distributed).Client
        return made(scheduler, set_as_default=False, name="rbps", timeout=5)

    def capacity(self) -> int:
        """How many attempts can run at once, at the last look."""
        return self._places

    def free(self) -> int:
        """How many more attempts can start now; connects again to a scheduler that was away."""
        try:
            if self._client is None:
                self._client = self._connect()
            if self._client.status == "closed":  # Dask's own tries to connect again were too few
                raise OSError("the connection is closed")
            here = self._client.status == "running"
            self._places = int(sum(self._client.nthreads().values())) if here else 0
            self._away = False
        except OSError as error:
            if not self._away:  # said once, not twice a second
                log.warning("the Dask scheduler does not answer: %s", error)
            self._away = True
            if self._client is not None:
                with contextlib.suppress(OSError):
                    self._client.close(timeout=1)
            self._places, self._client = 0, None
            self._running.clear()  # what still runs of these keeps its own heartbeat
        # Another service of this store, or one that was killed, may have attempts in the cluster too;
        # a task claimed beyond its places would be silent in Dask's queue.
        return self._places - max(len(self._running), len(self._store.beats()))

    def running(self) -> int:
        """How many attempts there are."""
        return len(self._running)

    def start(self, attempt: Attempt) -> None:
        """Submit the attempt; never run twice by Dask itself, whatever its settings."""
        future = self._client.submit(
            remote,
            self._store.url,
            attempt,
            self._settings,
            key=attempt.token,
            pure=False,
            retries=0,
        )
        self._running[attempt.token] = attempt, future
        future.add_done_callback(lambda done: self._done(attempt, done))

    def stop(self, drain: bool) -> None:
        """Let running attempts end (drain), or give them back to the queue; then return."""
        for attempt, future in list(self._running.values()):
            if not drain:
                self._store.release(attempt)  # its watcher sees it and kills the process
            with contextlib.suppress(OSError, distributed.CancelledError):  # the scheduler has gone
                future.exception()
        with self._ending:  # a callback that comes later would use a store that is closed
            self._stopped = True
        if self._client is not None:
            self._client.close()

    def _done(self, attempt: Attempt, future: Any) -> None:
        self._running.pop(attempt.token, None)
        try:
            with self._ending:
                if future.status != "finished" and not self._stopped:
                    cause = "the machine or Dask worker that ran the computation disappeared"
                    self._store.lost(attempt, cause, self._settings.losses_allowed)
        except SQLAlchemyError:  # nobody beats for it any more, and the task is queued again
            log.exception("the loss could not be written", extra={"job": attempt.job_id})
        self._on_free()


def remote(url: str, attempt: Attempt, settings: Settings) -> None:
    """The task: watch an attempt on this machine."""
    watch(_store(url), attempt, settings, threading.Event())


@cache
def _store(url: str) -> Store:
    return Store(url)


def dask_setup(worker: Any) -> None:
    """Called by ``--preload``: the worker joins the cluster once its kernels are loaded."""
    configure()
    warm_up()
