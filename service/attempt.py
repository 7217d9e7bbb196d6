"""One attempt at one task, in a worker process: store in, engine, store out.

The process dies with the service (or Dask worker) that started it, whatever that died of, so no
computation goes on unwatched. It writes each iteration as progress and checkpoint; where the
store answers that the task is not this attempt's any more (cancelled, given to another), it leaves.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import threading
import time
from collections.abc import Sequence
from importlib.metadata import version
from multiprocessing import connection, parent_process
from typing import Any, NoReturn

import numpy as np
from sqlalchemy.exc import SQLAlchemyError

from engine.diagnose.refits.checkpoint import ASKED
from engine.errors import EngineError
from engine.models.registry import register_files
from engine.statespace.model import Array, Theta
from service import stages
from service.db_schema import ITERATIONS
from service.logs import configure
from service.orphans import die_with_parent
from service.problems import Problem, unexpected
from service.processes import STORE_FAILED, settle
from service.store import Store
from service.transitions import Attempt
from service.validation import load
from service.wording import plain_throughout

log = logging.getLogger("service")

_ENDS = {
    True: "task %d is done, its result is written",
    False: "task %d was computed to its end, but is not this attempt's any more",
}
FLUSH_SECONDS = 0.1  # iterations faster than this are written several at a time


def main(url: str, attempt: Attempt, memory: int = 0, models: Sequence[str] = ()) -> None:
    """Entry point of the worker process, which may use so many bytes of memory (0: any).

    ``models`` are files of models, see :func:`engine.models.registry.register_files`.
    """
    configure()
    _die_with_parent()
    settle(memory)
    for one in models:  # the job's own is missed by its name, with the reason
        with contextlib.suppress(EngineError):
            register_files([one])
    try:
        run(Store(url), attempt)
    except SQLAlchemyError:
        log.exception("the store failed", extra={"job": attempt.job_id})
        os._exit(STORE_FAILED)  # to flush a log on the same full disk would fail, with code 1


def run(store: Store, attempt: Attempt) -> None:
    """Compute the task and write its result or the reason for its failure."""
    try:
        request = store.document(attempt.job, "request")
        if request is None:  # removed by its owner since the task was claimed
            _leave(attempt)
        job = load(json.loads(request))
        notes = job.request.notes
        progress = StoredProgress(store, attempt, notes)
        kept = StoredParts(store, attempt)
        if kept:  # what they are is gone through before anything new is reached
            progress.reached(store.job(attempt.job_id))
        result = stages.run(job, attempt.task, progress, kept)
        progress.flush()
        result = noted(result, notes)
        message = " ".join([str(result.get("message", "")), *notes]).strip()
        written = store.finish(attempt, result, message)
        log.info(_ENDS[written], attempt.task, extra={"job": attempt.job_id})
    except SQLAlchemyError:
        raise
    except Exception as error:  # noqa: BLE001 - whatever it is, the job's owner must be told
        store.fail(attempt, _problem(error, attempt.job_id).document())


def noted(result: dict[str, Any], notes: Sequence[str]) -> dict[str, Any]:
    """A result as its reader is told it, with what is to be known of how its files were read."""
    told: dict[str, Any] = plain_throughout(result)
    return {**told, "notes": list(notes)} if notes else told


class StoredProgress:
    """computations.Progress on the store; a row is (theta..., log-likelihood, ess, seconds, collapsed)."""

    def __init__(self, store: Store, attempt: Attempt, notes: Sequence[str] = ()) -> None:
        self.store, self.attempt, self.notes = store, attempt, notes
        self.k, self._stage = 0, ""
        self._pending: dict[int, Array] = {}
        self._memory: dict[int, Array] = {}
        self._latest: Any = None
        self._written, self._begun = 0.0, time.monotonic()

    def rows(self) -> Array:
        """Iterations of earlier attempts at this task."""
        ks, rows = self.store.rows(self.attempt.job, self.attempt.task)
        self.k = max(ks, default=0)
        if ks:
            log.info("goes on after iteration %d", self.k, extra={"job": self.attempt.job_id})
        return rows

    def memory(self) -> Array:
        """What they left to the next."""
        return self.store.memory(self.attempt.job, self.attempt.task)

    def start(self, theta: Theta) -> None:
        """Row 0: where the estimation starts."""
        self._pending[0] = np.append(theta, [np.nan] * 4)
        self.flush(stage=ITERATIONS)

    def iteration(self, it: Any) -> None:
        """The engine's callback."""
        numbers = [it.log_likelihood, it.ess, it.seconds, it.collapsed]
        self._pending[it.k], self._memory[it.k] = np.append(it.theta, numbers), it.memory
        self.k, self._latest = it.k, it
        if time.monotonic() - self._written > FLUSH_SECONDS:
            self.flush(ran=time.monotonic() - self._begun, stage=ITERATIONS)

    def reached(self, job: Any) -> None:
        """How far earlier attempts came at the only task of a job."""
        self.k = 0 if job is None else job.iteration

    def step(self, k: int, message: str = "", share: float | None = None) -> None:
        """Progress without a checkpoint."""
        self.k = max(self.k, k)
        self.flush(message, stage=message.partition(",")[0][:60], share=share)

    def estimated(self, document: dict[str, Any]) -> None:
        """The result so far, for requests that come meanwhile."""
        if not self.store.show(self.attempt, noted(document, self.notes)):
            _leave(self.attempt)

    def left(self, task: int) -> Any:
        """What a task of an earlier stage left."""
        return json.loads(self.store.document(self.attempt.job, f"task-{task}") or b"null")

    def flush(
        self,
        message: str = "",
        ran: float | None = None,
        stage: str | None = None,
        share: float | None = None,
    ) -> None:
        """Write what is pending; leaves the process if the task is not ours any more."""
        self._stage = self._stage if stage is None else stage
        latest = self._latest
        mine = self.store.record(
            self.attempt,
            self.k,
            self._pending,
            latest and latest.theta.asdict(),
            latest and latest.log_likelihood,
            message,
            ran,
            self._stage,
            share,
            self._memory,
        )
        if not mine:
            _leave(self.attempt)
        self._pending, self._memory, self._written = {}, {}, time.monotonic()


class StoredParts(dict[str, Any]):
    """What attempts at a diagnosis have finished, on the store; see ``engine.diagnose``.

    Parts of another version of this software are left alone: its numbers may differ. So are those from
    before the diagnosis was begun anew, with an ``ASKED``.
    """

    def __init__(self, store: Store, attempt: Attempt) -> None:
        self.store, self.attempt, self.version = store, attempt, version("rbps")
        known = [json.loads(text) for text in store.kept(attempt.job)]
        super().__init__()
        self._begun = time.monotonic()
        for one in known:
            if one["name"] == ASKED:
                self.clear()
            if one["by"] == self.version:
                super().__setitem__(one["name"], one["part"])
        self.written = len(known)
        if self:
            log.info("goes on with %d finished parts", len(self), extra={"job": attempt.job_id})

    def __setitem__(self, name: str, part: Any) -> None:
        super().__setitem__(name, part)
        text = json.dumps({"by": self.version, "name": name, "part": part})
        if not self.store.keep(self.attempt, self.written, text, time.monotonic() - self._begun):
            _leave(self.attempt)
        self.written += 1


def _leave(attempt: Attempt) -> NoReturn:
    log.info("leaves: the task is not its own any more", extra={"job": attempt.job_id})
    raise SystemExit(0)


def _problem(error: Exception, job: str) -> Problem:
    """What the owner of a failed job is told."""
    if isinstance(error, Problem):
        return error
    if isinstance(error, EngineError):
        return Problem(422, "computation-failed", str(error))
    if isinstance(error, MemoryError):
        return Problem(422, "out-of-memory", "the computation needs more memory than it may use")
    log.error("the computation failed", exc_info=error, extra={"job": job})
    return Problem(422, "computation-failed", unexpected(error))


def _die_with_parent() -> None:
    """End this process when the service does, even by SIGKILL, even inside a compiled kernel."""
    parent = parent_process()
    if parent is None:  # run by hand
        return
    die_with_parent()  # the forkserver ends with the service, and this process with it

    def watch() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
