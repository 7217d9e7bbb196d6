"""What happens to a job's rows, within a transaction of the caller."""

from __future__ import annotations

import json
import time
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Row, and_, delete, func, insert, select, update

from service.db_schema import documents, iterations, jobs, tasks
from service.problems import Problem, invalid
from service.strict_json import dumps

PRELIMINARY = "preliminary"  # name of the result so far: before standard errors, before causes
KEPT = "kept-"  # names of documents that serve an attempt's successor


@dataclass(frozen=True)
class Attempt:
    """The right to work on one task of a job."""

    job: int
    job_id: str
    task: int
    token: str
    run_seconds: float | None
    spent: float = 0.0  # s, of earlier attempts that made room for others


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


def change_job(sql: Connection, seq: int, **values: Any) -> None:
    """Write values into a job's row."""
    sql.execute(update(jobs).where(jobs.c.seq == seq).values(values))


def change_tasks(sql: Connection, which: Any, **values: Any) -> int:
    """Write values into the rows of tasks; how many."""
    return sql.execute(update(tasks).where(which).values(values)).rowcount


def mine(sql: Connection, attempt: Attempt, **values: Any) -> bool:
    """Change the task if it is still this attempt's; whether it was."""
    return change_tasks(sql, of(attempt), **values) == 1


def leave(sql: Connection, attempt: Attempt, ran: float) -> bool:
    """Put the task back into the queue if it is asked for, after so many seconds; whether it was."""
    asked = and_(of(attempt), tasks.c.asked == 1)
    return _make_room(sql, attempt.job, asked, taken=0, spent=tasks.c.spent + ran)


def take(sql: Connection, seq: int, token: str) -> None:
    """Put a task of a job back into the queue; what its attempt did since its checkpoint is lost."""
    here = and_(tasks.c.token == token, tasks.c.state == "running")
    _make_room(sql, seq, here, taken=tasks.c.taken + 1)


def _make_room(sql: Connection, seq: int, which: Any, **values: Any) -> bool:
    if change_tasks(sql, which, state="queued", token=None, **values) != 1:
        return False
    message = "paused for other jobs; resumes where it was"
    change_job(sql, seq, updated=time.time(), message=message, stage="")
    return True


def locked(sql: Connection, seq: int) -> Row[Any]:
    """The job, locked against other changes. Who will change a job and tasks of it locks the job first."""
    query = select(jobs).where(jobs.c.seq == seq)
    return sql.execute(query.with_for_update(key_share=True)).one()


def end(sql: Connection, seq: int, status: str, **values: Any) -> None:
    """End the job, and stop what of it still waits or runs; its checkpoints stay."""
    left = and_(tasks.c.job == seq, tasks.c.state.in_(("queued", "running")))
    change_tasks(sql, left, state="stopped")
    now = time.time()
    change_job(sql, seq, status=status, finished=now, updated=now, **values)


def fail(sql: Connection, seq: int, problem: Mapping[str, Any]) -> None:
    """End the job with the problem document that tells why."""
    detail = str(problem.get("detail", ""))
    cause = str(problem.get("type", "")).rpartition(":")[2]
    end(sql, seq, "failed", message=detail, problem=dumps(problem), cause=cause)


def lose(sql: Connection, seq: int, task: int, cause: str, allowed: int) -> None:
    """Queue a task again whose attempt was lost, or fail the job.

    It fails when more attempts than ``allowed`` were lost one after the other without a checkpoint
    between them: another would be lost at the same place.
    """
    this = and_(tasks.c.job == seq, tasks.c.task == task)
    row = sql.execute(select(tasks).where(this)).one()
    mark = _checkpoints(sql, seq, task)
    futile = 1 if mark > row.mark else row.futile + 1
    if futile > allowed:
        detail = f"{cause}; given up after {futile} attempts"
        fail(sql, seq, Problem(500, "worker-lost", detail).document())
        return
    again = {"losses": row.losses + 1, "futile": futile, "mark": mark}
    change_tasks(sql, this, state="queued", token=None, **again)
    message = f"{cause}; continues where it was (restart {futile} of {allowed})"
    change_job(sql, seq, updated=time.time(), message=message, stage="")


def _checkpoints(sql: Connection, seq: int, task: int) -> int:
    """How far another attempt at the task would go on: iterations, or finished parts of a diagnosis."""
    rows = select(func.max(iterations.c.k)).where(
        iterations.c.job == seq, iterations.c.task == task
    )
    parts = (
        select(func.count())
        .select_from(documents)
        .where(documents.c.job == seq, documents.c.name.startswith(KEPT))
    )
    return (sql.scalar(rows) or 0) + (sql.scalar(parts) or 0)


def resume(sql: Connection, seq: int, **values: Any) -> None:
    """Queue what was stopped of an ended job; its losses and its time are counted anew."""
    stopped = and_(tasks.c.job == seq, tasks.c.state == "stopped")
    change_tasks(sql, stopped, state="queued", token=None, futile=0, taken=0, spent=0.0)
    message = "resumed; continues where it was"
    anew = {"stage": "", "stage_share": None, "finished": None, "problem": None, "cause": None}
    change_job(sql, seq, status="accepted", updated=time.time(), message=message, **anew, **values)


def iterate_on(sql: Connection, seq: int, iterations: int) -> None:
    """Let a job's only task make more iterations in all; a result that there is becomes the one so far."""
    of_job = documents.c.job == seq
    asked = and_(of_job, documents.c.name == "request")
    request = json.loads(
        zlib.decompress(sql.execute(select(documents.c.body).where(asked)).scalar_one())
    )
    if request["options"]["method"] == "simulation":
        raise invalid("iterations", "the fit of the simulation counts none; leave it out")
    request["options"]["iterations"] = iterations
    sql.execute(delete(documents).where(asked))
    put(sql, seq, "request", dumps(request))
    result = and_(of_job, documents.c.name == "result")
    sql.execute(update(documents).where(result).values(name=PRELIMINARY))
    change_tasks(sql, and_(tasks.c.job == seq, tasks.c.state == "done"), state="stopped")
    change_job(sql, seq, iterations=iterations, outcome=None)


def forget(sql: Connection, seq: int, **values: Any) -> None:
    """Remove all data of an ended job; its row stays."""
    for table in (documents, iterations):
        sql.execute(delete(table).where(table.c.job == seq))
    gone = {"removed": 1, "estimate": None, "log_likelihood": None, "updated": time.time()}
    gone |= {"outcome": None, "found": None}
    change_job(sql, seq, **(gone | values))
