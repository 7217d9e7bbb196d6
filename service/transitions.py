"""What happens to a job's rows, within a transaction of the caller."""

from __future__ import annotations

import time
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, and_, delete, insert, update

from service.strict_json import dumps
from service.tables import documents, jobs, tasks

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


def put(sql: Connection, seq: int, name: str, text: str) -> None:
    """Write a document of the job."""
    body = zlib.compress(text.encode(), 1)
    sql.execute(insert(documents).values(job=seq, name=name, body=body))


def add(sql: Connection, values: dict[str, Any]) -> int:
    """Add a job; its seq."""
    key = sql.execute(insert(jobs).values(values)).inserted_primary_key
    return int(key[0]) if key else 0


def add_tasks(sql: Connection, seq: int, start: int, stop: int) -> None:
    """Put the tasks of a stage into the queue."""
    new = [{"job": seq, "task": i, "state": "queued"} for i in range(start, stop)]
    sql.execute(insert(tasks), new)


def of(attempt: Attempt) -> Any:
    """The condition that a task is this attempt's."""
    return and_(
        tasks.c.job == attempt.job,
        tasks.c.task == attempt.task,
        tasks.c.token == attempt.token,
        tasks.c.state == "running",
    )


def mine(sql: Connection, attempt: Attempt, **values: Any) -> bool:
    """Change the task if it is still this attempt's; whether it was."""
    return sql.execute(update(tasks).where(of(attempt)).values(values)).rowcount == 1


def end(sql: Connection, seq: int, status: str, now: float, **values: Any) -> None:
    """End the job, and stop what of it still waits or runs."""
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


def fail(sql: Connection, seq: int, problem: Mapping[str, Any]) -> None:
    """End the job with the problem document that tells why."""
    detail = str(problem.get("detail", ""))
    cause = str(problem.get("type", "")).rpartition(":")[2]
    end(sql, seq, "failed", time.time(), message=detail, problem=dumps(problem), cause=cause)


def lose(sql: Connection, seq: int, task: int, losses: int, cause: str, allowed: int) -> None:
    """Queue a task again whose attempt was lost, or fail the job after too many losses."""
    if losses >= allowed:
        detail = f"{cause}; given up after {losses + 1} attempts"
        problem = {
            "type": "urn:rbps:problem:worker-lost", "title": "worker lost",
            "status": 500, "detail": detail,
        }  # fmt: skip
        fail(sql, seq, problem)
        return
    sql.execute(
        update(tasks)
        .where(tasks.c.job == seq, tasks.c.task == task)
        .values(state="queued", token=None, losses=losses + 1)
    )
    message = f"{cause}; goes on where it was (restart {losses + 1} of {allowed})"
    sql.execute(update(jobs).where(jobs.c.seq == seq).values(updated=time.time(), message=message))
