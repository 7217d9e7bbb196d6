"""Moves jobs: claims the first of the queue for each free place, queues abandoned ones again.

Where all places are taken it lets keys have their turns.
"""

from __future__ import annotations

import logging
import math
import os
import socket
import threading
import time

from sqlalchemy.exc import SQLAlchemyError

from service.clocks import Silence
from service.retention import Retention
from service.runner import Runner
from service.settings import Settings
from service.store import Store
from service.turns import Turns

log = logging.getLogger("service")

LOOK_SECONDS = 0.5  # how often to look at the store without being woken
TRY_SECONDS = 3.0  # how long it is believed that the store can be written


class Supervisor:
    """One thread; several supervisors may share a store."""

    def __init__(
        self, store: Store, runner: Runner, settings: Settings, wake: threading.Event | None = None
    ) -> None:
        """``wake`` is set by whoever has something for it to do, as the runner."""
        self._store, self._runner, self._settings = store, runner, settings
        self._wake, self._stop = wake or threading.Event(), threading.Event()
        self._silence = Silence(settings.lease_seconds)
        self._turns = Turns(settings.turn_seconds, 4 * LOOK_SECONDS)
        self._retention = Retention(store, settings.keep_days)
        self._holder = f"{socket.gethostname()}:{os.getpid()}"
        self._thread = threading.Thread(target=self._run, name="supervisor", daemon=True)
        self._trying, self._tried, self._store_trouble = threading.Lock(), -math.inf, ""
        self.beat = time.monotonic()  # when it last looked at the store

    def start(self) -> None:
        """Begin; jobs already in the store are taken up."""
        self._thread.start()

    def wake(self) -> None:
        """There may be something to do."""
        self._wake.set()

    def alive(self) -> bool:
        """Whether it looked at the store of late."""
        return self._thread.is_alive() and time.monotonic() - self.beat < 10.0

    def trouble(self) -> str:
        """Why no job can be computed now; empty if nothing is wrong.

        Whether the store can be written is tried by one caller every few seconds, as it waits for other
        writers; the others are told what was found last.
        """
        if self._trying.acquire(blocking=False):
            try:
                if time.monotonic() - self._tried > TRY_SECONDS:
                    self._store_trouble = self._try_store()
                    self._tried = time.monotonic()
            finally:
                self._trying.release()
        if self._store_trouble:
            return f"the store cannot be used: {self._store_trouble}"
        if not self.alive():
            return "the supervisor does not run"
        return "" if self.capacity() else "the cluster has no worker, or cannot be reached"

    def _try_store(self) -> str:
        try:
            self._store.check()
        except SQLAlchemyError as error:
            return str(error.__cause__ or error).splitlines()[0]
        return ""

    def running(self) -> int:
        """How many attempts the runner has."""
        return self._runner.running()

    def capacity(self) -> int:
        """How many attempts the runner can have at once."""
        return self._runner.capacity()

    def stop(self, drain: bool = False) -> None:
        """Claim nothing more and wait for the runner to stop."""
        self._stop.set()
        self._wake.set()
        if self._thread.ident is not None:
            self._thread.join()
        self._runner.stop(drain)

    def _run(self) -> None:
        while not self._stop.is_set():
            self._wake.clear()
            try:
                self._look()
            except Exception:  # a store that is away now may be back soon
                log.exception("the supervisor could not use the store; it tries again")
            self._wake.wait(LOOK_SECONDS)

    def _look(self) -> None:
        silent = self._silence.look(self._store.beats())
        if silent and (n := self._store.expire(silent, self._settings.losses_allowed)):
            log.warning("%d attempts have lost their supervisor", n)
        while self._runner.free() > 0 and not self._stop.is_set():
            attempt = self._store.claim(self._holder)
            if attempt is None:
                break
            try:
                self._runner.start(attempt)
            except Exception:  # it has not begun: no loss, and the next look tries again
                log.exception("the attempt cannot be started", extra={"job": attempt.job_id})
                self._store.release(attempt)
                break
        self._share()
        self._retention.look()
        self.beat = time.monotonic()

    def _share(self) -> None:
        """Where all places are taken, let keys have their turns."""
        if not self._runner.capacity() or self._runner.free() > 0:
            return
        ask, take = self._turns.look(*self._store.standing())
        if ask is not None:
            self._store.ask(ask.token)
        if take is not None:
            self._store.take(take.token)
