"""The store: the only channel between service and workers.

All SQL is here, in ``attempts`` and in ``transitions``; the tables are in ``db_schema``.

A job has one or more tasks (computations). A task that is running belongs to an attempt, named
by a token, for as long as its heartbeat goes on. Whoever writes says which attempt it is; the
write of an attempt that is no longer the task's own changes nothing and returns False.

    accepted --claim--> running --finish--> successful
        |                  |--fail--------> failed
        |                  |--lost, expire-> queued again; too often at one place: failed
        +------stop--------+--------------> dismissed
        +<----resume---- failed, dismissed; successful, with more iterations
"""

from __future__ import annotations

import hashlib
import json
import time
import uuid
import zlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from sqlalchemy import (
    ColumnElement,
    Connection,
    Row,
    and_,
    delete,
    func,
    insert,
    or_,
    select,
    update,
)
from sqlalchemy.exc import IntegrityError, OperationalError

from engine.statespace.model import Array
from service.attempts import Attempts
from service.db_schema import documents, in_lines, iterations, jobs, pulse, tasks
from service.problems import Problem
from service.strict_json import dumps
from service.transitions import KEPT, add, add_tasks, end, forget, iterate_on, locked, put, resume

ENDED = ("successful", "failed", "dismissed")
# how many jobs of an owner, or of all (None), may wait or run
Most = Sequence[tuple[str | None, int]]


# By what a list of jobs can be sorted.
SORTS: Mapping[str, ColumnElement[Any]] = {
    "created": jobs.c.seq,
    "name": func.nullif(func.lower(jobs.c.name), ""),
    "kind": jobs.c.kind,
    "model": func.lower(jobs.c.model),
    "data": func.nullif(func.lower(jobs.c.data), ""),
    "status": jobs.c.status,
    "outcome": jobs.c.outcome,
    "log_likelihood": jobs.c.log_likelihood,
    "duration": jobs.c.finished - jobs.c.started,
}


@dataclass(frozen=True)
class Which:
    """Which jobs: of these statuses, kinds and outcomes, with all of these tags, of an owner.

    A ``model`` stands for its extensions too; ``text`` is in the name, tags, data, model or message.
    """

    status: Sequence[str] = ()
    kind: Sequence[str] = ()
    outcome: Sequence[str] = ()
    tags: Sequence[str] = ()
    model: str | None = None
    owner: str | None = None
    text: str = ""

    def conditions(self) -> list[ColumnElement[bool]]:
        """As SQL."""
        columns = (
            (jobs.c.status, self.status),
            (jobs.c.kind, self.kind),
            (jobs.c.outcome, self.outcome),
        )
        found: list[ColumnElement[bool]] = [c.in_(values) for c, values in columns if values]
        found += [jobs.c.tags.contains(in_lines([tag]), autoescape=True) for tag in self.tags]
        if self.model is not None:
            extended = jobs.c.model.startswith(f"{self.model}+", autoescape=True)
            found.append(or_(jobs.c.model == self.model, extended))
        if self.owner is not None:
            found.append(jobs.c.owner == self.owner)
        if self.text:
            places = (jobs.c.name, jobs.c.tags, jobs.c.data, jobs.c.model, jobs.c.message)
            found.append(or_(*(one.icontains(self.text, autoescape=True) for one in places)))
        return found


EVERY = Which()


class Store(Attempts):
    """The whole store: jobs as clients see them, and attempts at their tasks."""

    def create(
        self,
        kind: str,
        model: str,
        request: Mapping[str, Any],
        iterations: int,
        stages: Sequence[int] = (1,),
        run_seconds: float | None = None,
        owner: str = "",
        idempotency_key: str | None = None,
        most: Most = (),
    ) -> str:
        """Put a job at the end of the queue; its id, or that of the job with the same key.

        Raises Problem 422 if that job's request was another, 429 beyond the limits ``most``.
        """
        now, job_id, text = time.time(), uuid.uuid4().hex, dumps(request)
        digest = hashlib.sha256(text.encode()).hexdigest()
        values = {
            "id": job_id,
            "kind": kind,
            "model": model,
            "status": "accepted",
            "created": now,
            "updated": now,
            "iterations": iterations,
            "stages": dumps(list(stages)),
            "run_seconds": run_seconds,
            "owner": owner,
            "idempotency_key": idempotency_key,
            "digest": digest,
            "name": request.get("name", ""),
            "tags": in_lines(request.get("tags", [])),
            "data": in_lines(request.get("data", [])),
            "message": " ".join(request.get("notes", [])),
        }
        try:
            with self._engine.begin() as sql:
                if (first := _by_key(sql, owner, idempotency_key)) is not None:
                    return _repeated(first, digest)
                _check_room(sql, most)
                seq = add(sql, values)
                add_tasks(sql, seq, 0, stages[0])
                put(sql, seq, "request", text)
        except IntegrityError:  # another request with the key was faster
            with self._read.begin() as sql:
                first = _by_key(sql, owner, idempotency_key)
            if first is None:
                raise
            return _repeated(first, digest)
        return job_id

    def job(self, job_id: str) -> Row[Any] | None:
        """One job, or None."""
        found: Sequence[Row[Any]] = self._rows(select(jobs).where(jobs.c.id == job_id))
        return found[0] if found else None

    def jobs(
        self, limit: int, before: int | None = None, which: Which = EVERY, sort: str = "-created"
    ) -> Sequence[Row[Any]]:
        """Jobs in the order of a key of ``SORTS``, "-" before it for the largest first.

        Of equals the newest first, and those last that have no such value. ``before`` continues after the
        job of that seq.
        """
        value = SORTS[sort.removeprefix("-")]
        falling = sort.startswith("-")
        missing, ordered = value.is_(None), value.desc() if falling else value.asc()
        query = select(jobs).where(*which.conditions()).limit(limit)
        query = query.order_by(missing, ordered, jobs.c.seq.desc())
        if before is not None:
            last = self._rows(select(value, missing).where(jobs.c.seq == before))
            if not last:
                return []
            at, none = last[0]
            later = jobs.c.seq < before
            if none:
                query = query.where(missing, later)
            else:
                beyond = value < at if falling else value > at
                query = query.where(or_(missing, beyond, and_(value == at, later)))
        return self._rows(query)

    def counts(self, owner: str | None = None) -> dict[str, int]:
        """Number of jobs of each status there is."""
        query = select(jobs.c.status, func.count()).group_by(jobs.c.status)
        if owner is not None:
            query = query.where(jobs.c.owner == owner)
        return {row[0]: row[1] for row in self._rows(query)}

    def statistics(self) -> dict[str, Any]:
        """Totals over all jobs there ever were, for the metrics."""
        waiting = select(func.min(jobs.c.created)).where(jobs.c.status == "accepted")
        ((oldest,),) = self._rows(waiting)
        ((done,),) = self._rows(select(func.coalesce(func.sum(jobs.c.iteration), 0)))
        group = (jobs.c.kind, jobs.c.status)
        seconds = jobs.c.finished - jobs.c.started  # null of what has not begun, or not ended
        durations = select(*group, func.count(), func.sum(seconds)).where(seconds.is_not(None))
        causes = select(jobs.c.cause, func.count()).where(jobs.c.cause.is_not(None))
        return {
            "waiting": time.time() - oldest if oldest else 0.0,
            "iterations": done,
            "durations": self._rows(durations.group_by(*group)),
            "causes": self._rows(causes.group_by(jobs.c.cause)),
        }

    def check(self) -> None:
        """Raise if the store cannot be written to."""
        with self._engine.begin() as sql:
            sql.execute(delete(pulse))
            sql.execute(insert(pulse).values(time=time.time()))

    def document(self, seq: int, name: str) -> bytes | None:
        """The JSON text of a request or result."""
        here = (documents.c.job == seq, documents.c.name == name)
        found = self._rows(select(documents.c.body).where(*here))
        return zlib.decompress(found[0].body) if found else None

    def kept(self, seq: int) -> list[str]:
        """What attempts have kept, in order, see ``keep``."""
        query = (
            select(documents.c.body)
            .where(documents.c.job == seq, documents.c.name.startswith(KEPT))
            .order_by(documents.c.name)
        )
        return [zlib.decompress(row.body).decode() for row in self._rows(query)]

    def rows(self, seq: int, task: int = 0, after: int = -1) -> tuple[list[int], Array]:
        """Iterations k > after of a task: [k, ...] and (n, n_theta + 4), see ``iterations.row``."""
        query = (
            select(iterations.c.k, iterations.c.row)
            .where(iterations.c.job == seq, iterations.c.task == task, iterations.c.k > after)
            .order_by(iterations.c.k)
        )
        found = self._rows(query)
        return [k for k, _ in found], np.array([np.frombuffer(row) for _, row in found])

    def has_document(self, seq: int, name: str) -> bool:
        """Whether a job has a document of that name."""
        there = select(documents.c.name).where(documents.c.job == seq, documents.c.name == name)
        return bool(self._rows(there))

    def memory(self, seq: int, task: int) -> Array:
        """What iterations 1, 2, ... of a task left to the next (k, m), see ``iterations.memory``."""
        query = (
            select(iterations.c.memory)
            .where(iterations.c.job == seq, iterations.c.task == task, iterations.c.k > 0)
            .order_by(iterations.c.k)
        )
        return np.array([np.frombuffer(one or b"") for (one,) in self._rows(query)])

    def tasks(self, seq: int) -> list[tuple[Row[Any], Array | None]]:
        """The tasks there are so far, each with its latest iteration's row, see ``rows``."""
        here = and_(
            iterations.c.job == tasks.c.job,
            iterations.c.task == tasks.c.task,
            iterations.c.k == tasks.c.iteration,
        )
        query = (
            select(tasks, iterations.c.row)
            .join_from(tasks, iterations, here, isouter=True)
            .where(tasks.c.job == seq)
            .order_by(tasks.c.task)
        )
        found = self._rows(query)
        return [(one, None if one.row is None else np.frombuffer(one.row)) for one in found]

    def label(self, job_id: str, name: str | None, tags: Sequence[str] | None) -> None:
        """Give a job another name, other tags; None leaves what there is."""
        values = {} if name is None else {"name": name}
        values |= {} if tags is None else {"tags": in_lines(tags)}
        if values:
            with self._engine.begin() as sql:
                sql.execute(update(jobs).where(jobs.c.id == job_id).values(values))

    def stop(self, job_id: str) -> Row[Any] | None:
        """End a job that waits or runs and keep all it has; the job, one that has ended as it was."""
        return self._on_full_disk(self._stop, job_id)

    def _stop(self, job_id: str) -> Row[Any] | None:
        with self._engine.begin() as sql:
            job = self._locked(sql, job_id)
            if job is None or job.status in ENDED:
                return job
            end(sql, job.seq, "dismissed", message=_stopped(job), problem=None)
            return self._locked(sql, job_id)

    def dismiss(self, job_id: str) -> Row[Any] | None:
        """Stop a job, or remove the data of one that has ended; None if there is no such job.

        Who only wants to stop it asks :meth:`stop`, which never removes what a job has found meanwhile.
        """
        row = self._on_full_disk(self._dismiss, job_id)
        if row is not None and row.removed:
            self._give_back()
        return row

    def _dismiss(self, job_id: str) -> Row[Any] | None:
        with self._engine.begin() as sql:
            job = self._locked(sql, job_id)
            if job is None or job.removed:
                return job
            if job.status in ENDED:
                gone = "its data were removed by the client"
                forget(sql, job.seq, status="dismissed", message=gone, problem=None)
            else:
                end(sql, job.seq, "dismissed", message=_stopped(job), problem=None)
            return self._locked(sql, job_id)

    def _on_full_disk(
        self, change: Callable[[str], Row[Any] | None], job_id: str
    ) -> Row[Any] | None:
        """A change that has to succeed on a full disk too: that is when it is needed most."""
        try:
            row = change(job_id)
        except OperationalError:
            if not self._reserve.give_up():
                raise
            row = change(job_id)
        self._reserve.fill()
        return row

    def resume(
        self,
        job_id: str,
        most: Most = (),
        run_seconds: float | None = None,
        iterations: int | None = None,
    ) -> Row[Any] | None:
        """Put a failed or dismissed job back into the queue, if its data are still there; the job.

        It may take as long again as it might before, or ``run_seconds`` where they are given. With more
        ``iterations`` a successful one goes on, too, see ``going_on``. Raises Problem 429 beyond the limits
        ``most``.
        """
        with self._engine.begin() as sql:
            job = self._locked(sql, job_id)
            can = ("failed", "dismissed", *(("successful",) if iterations else ()))
            if job is not None and job.status in can and not job.removed:
                _check_room(sql, most)
                if iterations:
                    iterate_on(sql, job.seq, iterations)
                resume(sql, job.seq, **({"run_seconds": run_seconds} if run_seconds else {}))
            return self._locked(sql, job_id)

    def purge(self, before: float) -> int:
        """Remove the data of all jobs that ended before a Unix time; how many."""
        old = select(jobs.c.seq).where(
            jobs.c.status.in_(ENDED), jobs.c.removed == 0, jobs.c.finished < before
        )
        found = [row.seq for row in self._rows(old)]
        for seq in found:  # one by one: nobody waits long for the lock
            with self._engine.begin() as sql:
                job = locked(sql, seq)
                if job.status in ENDED:  # nobody has resumed it meanwhile
                    forget(sql, seq, message="its data were removed after their time")
        if found:
            self._give_back()
        return len(found)

    def _give_back(self) -> None:
        """Let SQLite's file shrink by what was removed, if it was made for that."""
        if self._engine.dialect.name == "sqlite":
            with suppress(OperationalError), self._engine.connect() as sql:
                driver: Any = sql.connection.driver_connection
                driver.executescript("PRAGMA incremental_vacuum")  # a plain execute frees one page

    @staticmethod
    def _locked(sql: Connection, job_id: str) -> Row[Any] | None:
        query = select(jobs).where(jobs.c.id == job_id).with_for_update(key_share=True)
        return sql.execute(query).one_or_none()


def _stopped(job: Row[Any]) -> str:
    """What is said of a job that was stopped."""
    if job.status == "accepted" and not job.iteration:
        return "stopped by you before it began; it can go on"
    runs = sum(json.loads(job.stages)) > 1
    where = {
        "estimate": f"after {job.iteration} iterations in all"
        if runs
        else f"at iteration {job.iteration}",
        "diagnose": f"at {job.iteration} %",
        "design": f"at {job.iteration} %",
    }.get(job.kind, f"after {job.iteration} of {job.iterations} series")
    if job.stage.startswith("fitting"):
        where = "while it fitted the simulation"
    return f"stopped by you {where}; what it had computed is kept, and it can go on"


def _by_key(sql: Connection, owner: str, key: str | None) -> Row[Any] | None:
    """The job that came first with an idempotency key."""
    query = select(jobs).where(jobs.c.owner == owner, jobs.c.idempotency_key == key)
    return None if key is None else sql.execute(query).one_or_none()


def _repeated(first: Row[Any], digest: str) -> str:
    """The id of the job that a repeated request asks for."""
    if first.digest != digest:
        detail = f"this Idempotency-Key came with another request, job {first.id}"
        raise Problem(422, "idempotency-key-reused", detail)
    return str(first.id)


def _check_room(sql: Connection, most: Most) -> None:
    for owner, number in most:
        query = select(func.count()).where(jobs.c.status.in_(("accepted", "running")))
        if owner is not None:
            query = query.where(jobs.c.owner == owner)
        if (sql.scalar(query) or 0) >= number:
            detail = f"{number} jobs wait or run already; try again later"
            raise Problem(429, "queue-full", detail, retry_after=30)
