"""The store: the only channel between service and workers. All SQL is in this module.

A job has one or more tasks (computations). A task that is running belongs to an attempt, named
by a token, for as long as its lease is renewed. Whoever writes says which attempt it is; the
write of an attempt that is no longer the task's own changes nothing and returns False.

    accepted --claim--> running --finish--> successful
        |                  |--fail--------> failed
        |                  |--lost, expire-> queued again (twice at most), then failed
        +-----dismiss------+--------------> dismissed
"""

from __future__ import annotations

import hashlib
import json
import time
import uuid
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np
from sqlalchemy import Connection, Row, and_, delete, func, insert, or_, select, update
from sqlalchemy.exc import IntegrityError

from engine.model import Array
from service.strict_json import dumps, finite
from service.tables import connect, documents, iterations, jobs, pulse, tasks

ENDED = ("successful", "failed", "dismissed")
KEPT = "kept-"  # names of documents that serve an attempt's successor


@dataclass(frozen=True)
class Attempt:
    """The right to work on one task of a job."""

    job: int
    job_id: str
    task: int
    token: str
    losses: int
    run_seconds: float | None


class KeyReused(Exception):  # noqa: N818 - it is the client that erred
    """An idempotency key came with another request; the argument is the first job's id."""


class Store:
    """One database; usable from many threads, and from many processes by its URL."""

    def __init__(self, url: str) -> None:
        self.url = url
        self._engine = connect(url)
        self._read = self._engine.execution_options(write=False)

    def close(self) -> None:
        """Close the pooled connections."""
        self._engine.dispose()

    # ---- jobs, as clients see them ----------------------------------------------------------

    def create(
        self,
        kind: str,
        model: str,
        request: Any,
        iterations: int,
        stages: Sequence[int] = (1,),
        run_seconds: float | None = None,
        owner: str = "",
        idempotency_key: str | None = None,
    ) -> str:
        """Put a job at the end of the queue; its id, or that of the job with the same key.

        Raises KeyReused if that job's request was another.
        """
        now, job_id, text = time.time(), uuid.uuid4().hex, dumps(request)
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
            "digest": hashlib.sha256(text.encode()).hexdigest(),
        }
        try:
            with self._engine.begin() as sql:
                seq = _add(sql, values)
                _add_tasks(sql, seq, 0, stages[0])
                _put(sql, seq, "request", text)
        except IntegrityError:
            first = self._by_key(owner, idempotency_key)
            if first is None:
                raise
            if first.digest != values["digest"]:
                raise KeyReused(first.id) from None
            return str(first.id)
        return job_id

    def _by_key(self, owner: str, key: str | None) -> Row[Any] | None:
        query = select(jobs).where(jobs.c.owner == owner, jobs.c.idempotency_key == key)
        with self._read.begin() as sql:
            return sql.execute(query).one_or_none()

    def job(self, job_id: str) -> Row[Any] | None:
        """One job, or None."""
        with self._read.begin() as sql:
            return sql.execute(select(jobs).where(jobs.c.id == job_id)).one_or_none()

    def jobs(
        self,
        limit: int,
        before: int | None = None,
        status: Iterable[str] = (),
        model: str | None = None,
        owner: str | None = None,
        kind: Iterable[str] = (),
    ) -> Sequence[Row[Any]]:
        """Newest first; ``before`` continues after the job of that seq. A model's extensions are its."""
        query = select(jobs).order_by(jobs.c.seq.desc()).limit(limit)
        if before is not None:
            query = query.where(jobs.c.seq < before)
        if status := list(status):
            query = query.where(jobs.c.status.in_(status))
        if kind := list(kind):
            query = query.where(jobs.c.kind.in_(kind))
        if model is not None:
            extended = jobs.c.model.startswith(f"{model}+", autoescape=True)
            query = query.where(or_(jobs.c.model == model, extended))
        if owner is not None:
            query = query.where(jobs.c.owner == owner)
        with self._read.begin() as sql:
            return sql.execute(query).all()

    def counts(self, owner: str | None = None) -> dict[str, int]:
        """Number of jobs of each status there is."""
        query = select(jobs.c.status, func.count()).group_by(jobs.c.status)
        if owner is not None:
            query = query.where(jobs.c.owner == owner)
        with self._read.begin() as sql:
            return {row[0]: row[1] for row in sql.execute(query)}

    def statistics(self) -> dict[str, Any]:
        """Totals over all jobs there ever were, for the metrics."""
        with self._read.begin() as sql:
            oldest = sql.scalar(select(func.min(jobs.c.created)).where(jobs.c.status == "accepted"))
            group = (jobs.c.kind, jobs.c.status)
            seconds = func.sum(jobs.c.finished - jobs.c.started)
            return {
                "waiting": time.time() - oldest if oldest else 0.0,
                "iterations": sql.scalar(select(func.coalesce(func.sum(jobs.c.iteration), 0))),
                "durations": sql.execute(
                    select(*group, func.count(), seconds)
                    .where(jobs.c.finished.is_not(None), jobs.c.started.is_not(None))
                    .group_by(*group)
                ).all(),
                "causes": sql.execute(
                    select(jobs.c.cause, func.count())
                    .where(jobs.c.cause.is_not(None))
                    .group_by(jobs.c.cause)
                ).all(),
            }

    def check(self) -> None:
        """Raise if the store cannot be written to."""
        with self._engine.begin() as sql:
            sql.execute(delete(pulse))
            sql.execute(insert(pulse).values(time=time.time()))

    def document(self, seq: int, name: str) -> bytes | None:
        """The JSON text of a request or result."""
        with self._read.begin() as sql:
            body = sql.scalar(
                select(documents.c.body).where(documents.c.job == seq, documents.c.name == name)
            )
        return None if body is None else zlib.decompress(body)

    def kept(self, seq: int) -> list[str]:
        """What attempts have kept, in order, see ``keep``."""
        query = (
            select(documents.c.body)
            .where(documents.c.job == seq, documents.c.name.startswith(KEPT))
            .order_by(documents.c.name)
        )
        with self._read.begin() as sql:
            return [zlib.decompress(body).decode() for body in sql.scalars(query)]

    def rows(self, seq: int, task: int = 0, after: int = -1) -> tuple[list[int], Array]:
        """Iterations k > after of a task: [k, ...] and (n, n_theta + 4), see ``iterations.row``."""
        query = (
            select(iterations.c.k, iterations.c.row)
            .where(iterations.c.job == seq, iterations.c.task == task, iterations.c.k > after)
            .order_by(iterations.c.k)
        )
        with self._read.begin() as sql:
            found = sql.execute(query).all()
        return [k for k, _ in found], np.array([np.frombuffer(row) for _, row in found])

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
        with self._read.begin() as sql:
            found = sql.execute(query).all()
        return [(one, None if one.row is None else np.frombuffer(one.row)) for one in found]

    def dismiss(self, job_id: str) -> Row[Any] | None:
        """Stop a job, or remove what an ended one left; None if there is no such job."""
        now = time.time()
        with self._engine.begin() as sql:
            job = sql.execute(select(jobs).where(jobs.c.id == job_id)).one_or_none()
            if job is None or job.status == "dismissed":
                return job
            _end(sql, job.seq, "dismissed", now, message="dismissed by the client", problem=None)
            for table in (documents, iterations):
                sql.execute(delete(table).where(table.c.job == job.seq))
            return sql.execute(select(jobs).where(jobs.c.id == job_id)).one()

    # ---- attempts ---------------------------------------------------------------------------

    def claim(self, holder: str, lease: float) -> Attempt | None:
        """The first task of the queue, leased for so many seconds, or None."""
        now, token = time.time(), uuid.uuid4().hex
        first = (
            select(tasks, jobs.c.id, jobs.c.status, jobs.c.run_seconds)
            .join(jobs, jobs.c.seq == tasks.c.job)
            .where(tasks.c.state == "queued")
            .order_by(tasks.c.job, tasks.c.task)
            .limit(1)
        )
        with self._read.begin() as sql:  # an idle service does not write
            if sql.execute(first).first() is None:
                return None
        with self._engine.begin() as sql:
            task = sql.execute(first.with_for_update(skip_locked=True, of=tasks)).first()
            if task is None:
                return None
            sql.execute(
                update(tasks)
                .where(tasks.c.job == task.job, tasks.c.task == task.task)
                .values(state="running", token=token, holder=holder, lease_until=now + lease)
            )
            if task.status == "accepted":
                sql.execute(
                    update(jobs)
                    .where(jobs.c.seq == task.job)
                    .values(status="running", started=now, updated=now)
                )
        return Attempt(task.job, task.id, task.task, token, task.losses, task.run_seconds)

    def leased(self) -> int:
        """How many tasks belong to an attempt, of whichever service."""
        with self._read.begin() as sql:
            query = select(func.count()).select_from(tasks).where(tasks.c.state == "running")
            return int(sql.scalar(query) or 0)

    def renew(self, attempt: Attempt, lease: float) -> bool:
        """Keep the lease; False if the task is no longer this attempt's."""
        with self._engine.begin() as sql:
            return _mine(sql, attempt, lease_until=time.time() + lease)

    def holds(self, attempt: Attempt) -> bool:
        """Whether the task is still this attempt's; reads only."""
        with self._read.begin() as sql:
            found = sql.scalar(select(func.count()).select_from(tasks).where(_of(attempt)))
        return bool(found)

    def record(
        self,
        attempt: Attempt,
        iteration: int,
        rows: Mapping[int, Array],
        estimate: Mapping[str, float] | None = None,
        log_likelihood: float | None = None,
        message: str = "",
    ) -> bool:
        """Write progress, with the iterations {k: row} done since the last time."""
        with self._engine.begin() as sql:
            if not _mine(sql, attempt, iteration=iteration):
                return False
            key = {"job": attempt.job, "task": attempt.task}
            if rows:
                new = [
                    key | {"k": k, "row": row.astype(float).tobytes()} for k, row in rows.items()
                ]
                sql.execute(insert(iterations), new)
            progress: dict[str, Any] = {"updated": time.time()}
            if message:
                progress["message"] = message
            progress["iteration"] = (
                select(func.sum(tasks.c.iteration))
                .where(tasks.c.job == attempt.job)
                .scalar_subquery()
            )
            if estimate is not None:
                progress |= {"estimate": dumps(estimate), "log_likelihood": finite(log_likelihood)}
            sql.execute(update(jobs).where(jobs.c.seq == attempt.job).values(progress))
        return True

    def keep(self, attempt: Attempt, n: int, text: str) -> bool:
        """Write the n-th text for a later attempt at the job's only task; they go when the job ends."""
        with self._engine.begin() as sql:
            if not _mine(sql, attempt, state="running"):
                return False
            _put(sql, attempt.job, f"{KEPT}{n:08d}", text)
        return True

    def finish(self, attempt: Attempt, result: Any, message: str = "") -> bool:
        """The task is done. The last task of a stage starts the next; that of all ends the job."""
        with self._engine.begin() as sql:
            job = sql.execute(select(jobs).where(jobs.c.seq == attempt.job).with_for_update()).one()
            if not _mine(sql, attempt, state="done"):
                return False
            states = list(sql.scalars(select(tasks.c.state).where(tasks.c.job == attempt.job)))
            ends = list(accumulate(json.loads(job.stages)))
            last = attempt.task + 1 == ends[-1]
            _put(sql, attempt.job, "result" if last else f"task-{attempt.task}", dumps(result))
            if last:
                _end(sql, attempt.job, "successful", time.time(), message=message)
            elif set(states) == {"done"}:
                stage = ends.index(len(states))
                _add_tasks(sql, attempt.job, ends[stage], ends[stage + 1])
        return True

    def fail(self, attempt: Attempt, problem: Mapping[str, Any]) -> bool:
        """The job failed, for a reason another attempt would meet again."""
        with self._engine.begin() as sql:
            if not _mine(sql, attempt, state="stopped"):
                return False
            _fail(sql, attempt.job, problem)
        return True

    def lost(self, attempt: Attempt, cause: str, losses_allowed: int) -> bool:
        """The worker died: queue the task again, or fail the job after too many losses."""
        with self._engine.begin() as sql:
            if not _mine(sql, attempt, state="running"):
                return False
            _lose(sql, attempt.job, attempt.task, attempt.losses, cause, losses_allowed)
        return True

    def release(self, attempt: Attempt) -> bool:
        """Give a task back unharmed: the service stops and will go on with it later."""
        with self._engine.begin() as sql:
            return _mine(sql, attempt, state="queued", token=None, lease_until=None)

    def expire(self, losses_allowed: int) -> int:
        """Queue tasks again whose lease ran out, so nobody watches them; how many."""
        query = select(tasks).where(tasks.c.state == "running", tasks.c.lease_until < time.time())
        with self._read.begin() as sql:
            if sql.execute(query.limit(1)).first() is None:
                return 0
        with self._engine.begin() as sql:
            expired = sql.execute(query.with_for_update(skip_locked=True)).all()
            for task in expired:
                cause = "the process that watched the worker disappeared"
                _lose(sql, task.job, task.task, task.losses, cause, losses_allowed)
        return len(expired)


def _put(sql: Connection, seq: int, name: str, text: str) -> None:
    body = zlib.compress(text.encode(), 1)
    sql.execute(insert(documents).values(job=seq, name=name, body=body))


def _add(sql: Connection, values: dict[str, Any]) -> int:
    key = sql.execute(insert(jobs).values(values)).inserted_primary_key
    return int(key[0]) if key else 0


def _add_tasks(sql: Connection, seq: int, start: int, stop: int) -> None:
    new = [{"job": seq, "task": i, "state": "queued"} for i in range(start, stop)]
    sql.execute(insert(tasks), new)


def _of(attempt: Attempt) -> Any:
    return and_(
        tasks.c.job == attempt.job,
        tasks.c.task == attempt.task,
        tasks.c.token == attempt.token,
        tasks.c.state == "running",
    )


def _mine(sql: Connection, attempt: Attempt, **values: Any) -> bool:
    """Change the task if it is still this attempt's; whether it was."""
    return sql.execute(update(tasks).where(_of(attempt)).values(values)).rowcount == 1


def _end(sql: Connection, seq: int, status: str, now: float, **values: Any) -> None:
    left_over = and_(documents.c.job == seq, documents.c.name.startswith(KEPT))
    sql.execute(delete(documents).where(left_over))
    sql.execute(
        update(tasks)
        .where(tasks.c.job == seq, tasks.c.state.in_(("queued", "running")))
        .values(state="stopped")
    )
    sql.execute(
        update(jobs)
        .where(jobs.c.seq == seq)
        .values(status=status, finished=now, updated=now, **values)
    )


def _fail(sql: Connection, seq: int, problem: Mapping[str, Any]) -> None:
    detail = str(problem.get("detail", ""))
    cause = str(problem.get("type", "")).rpartition(":")[2]
    _end(sql, seq, "failed", time.time(), message=detail, problem=dumps(problem), cause=cause)


def _lose(sql: Connection, seq: int, task: int, losses: int, cause: str, allowed: int) -> None:
    if losses >= allowed:
        detail = f"{cause}; given up after {losses + 1} attempts"
        problem = {
            "type": "urn:rbps:problem:worker-lost", "title": "worker lost",
            "status": 500, "detail": detail,
        }  # fmt: skip
        _fail(sql, seq, problem)
        return
    sql.execute(
        update(tasks)
        .where(tasks.c.job == seq, tasks.c.task == task)
        .values(state="queued", token=None, lease_until=None, losses=losses + 1)
    )
    message = f"{cause}; goes on where it was (restart {losses + 1} of {allowed})"
    sql.execute(update(jobs).where(jobs.c.seq == seq).values(updated=time.time(), message=message))
