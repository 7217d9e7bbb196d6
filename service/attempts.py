"""The store as supervisors and workers use it: who may work on which task, and what they write."""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import accumulate
from typing import Any

from sqlalchemy import Connection, Select, and_, delete, func, insert, or_, select, text

from engine.statespace.model import Array
from service import transitions
from service.db_schema import ITERATIONS, connect, documents, iterations, jobs, tasks, turns
from service.key_values import found_by, reached_by
from service.reserve import Reserve
from service.strict_json import dumps, finite
from service.transitions import KEPT, PRELIMINARY, Attempt, change_job, change_tasks, locked, mine
from service.turns import Running

_SERVED = text(
    "INSERT INTO turns (owner, turn) VALUES (:owner, (SELECT COALESCE(MAX(turn), 0) + 1 FROM turns)) "
    "ON CONFLICT (owner) DO UPDATE SET turn = excluded.turn"
)


class Attempts:
    """One database; usable from many threads, and from many processes by its URL."""

    def __init__(self, url: str) -> None:
        self.url = url
        self._engine = connect(url)
        self._read = self._engine.execution_options(write=False)
        sqlite = self._engine.dialect.name == "sqlite"
        self._reserve = Reserve(self._engine.url.database if sqlite else None)

    def close(self) -> None:
        """Close the pooled connections."""
        self._engine.dispose()

    def _rows(self, query: Select[Any]) -> Sequence[Any]:
        with self._read.begin() as sql:
            return sql.execute(query).all()

    @contextmanager
    def _own(self, attempt: Attempt, **values: Any) -> Iterator[Connection | None]:
        """Change the attempt's task, within a transaction that locks the job; None if it is not its own."""
        with self._engine.begin() as sql:
            locked(sql, attempt.job)
            yield sql if mine(sql, attempt, **values) else None

    def claim(self, holder: str) -> Attempt | None:
        """The oldest task of the key with fewest attempts, or None; its heartbeat begins.

        Of keys with equally many, the one goes first whose latest claim was longest ago.
        """
        now, token = time.time(), uuid.uuid4().hex
        busy = (
            select(jobs.c.owner, func.count().label("n"))
            .join(tasks, tasks.c.job == jobs.c.seq)
            .where(tasks.c.state == "running")
            .group_by(jobs.c.owner)
            .subquery()
        )
        fewest = func.coalesce(busy.c.n, 0), func.coalesce(turns.c.turn, 0)
        first = (
            select(tasks, jobs.c.id, jobs.c.owner, jobs.c.status, jobs.c.run_seconds)
            .join(jobs, jobs.c.seq == tasks.c.job)
            .join(busy, busy.c.owner == jobs.c.owner, isouter=True)
            .join(turns, turns.c.owner == jobs.c.owner, isouter=True)
            .where(tasks.c.state == "queued")
            .order_by(*fewest, tasks.c.job, tasks.c.task)
            .limit(1)
        )
        if not self._rows(first):  # an idle service does not write
            return None
        with self._engine.begin() as sql:
            both = first.with_for_update(skip_locked=True, key_share=True, of=[jobs, tasks])
            task = sql.execute(both).first()
            if task is None:
                return None
            this = and_(tasks.c.job == task.job, tasks.c.task == task.task)
            held = {"token": token, "holder": holder, "beat": tasks.c.beat + 1, "asked": 0}
            change_tasks(sql, this, state="running", **held)
            sql.execute(_SERVED, {"owner": task.owner})
            if task.status == "accepted":
                started = func.coalesce(jobs.c.started, now)
                change_job(sql, task.job, status="running", started=started, updated=now)
        return Attempt(task.job, task.id, task.task, token, task.run_seconds, task.spent)

    def standing(self) -> tuple[list[Running], set[str]]:
        """All attempts, and the keys that have tasks in the queue."""
        columns = (tasks.c.token, jobs.c.owner, tasks.c.asked, tasks.c.taken)
        here = select(*columns).join(jobs, jobs.c.seq == tasks.c.job)
        queue = select(jobs.c.owner).join(tasks, tasks.c.job == jobs.c.seq).distinct()
        with self._read.begin() as sql:
            running = [
                Running(row.token, row.owner, bool(row.asked), row.taken)
                for row in sql.execute(here.where(tasks.c.state == "running"))
            ]
            return running, set(sql.scalars(queue.where(tasks.c.state == "queued")))

    def ask(self, token: str) -> None:
        """Let an attempt leave at its next checkpoint."""
        with self._engine.begin() as sql:
            here = and_(tasks.c.token == token, tasks.c.state == "running")
            change_tasks(sql, here, asked=1)

    def take(self, token: str) -> None:
        """Put a task back into the queue; what its attempt computed since its checkpoint is lost."""
        query = select(tasks.c.job).where(tasks.c.token == token)
        with self._engine.begin() as sql:
            if (seq := sql.scalar(query)) is not None:
                locked(sql, seq)
                transitions.take(sql, seq, token)

    def renew(self, attempt: Attempt) -> bool:
        """One more heartbeat; False if the task is no longer this attempt's."""
        with self._engine.begin() as sql:
            return mine(sql, attempt, beat=tasks.c.beat + 1)

    def beats(self) -> dict[str, int]:
        """The heartbeats of all attempts, of whichever service, by their tokens."""
        query = select(tasks.c.token, tasks.c.beat).where(tasks.c.state == "running")
        return {row.token: row.beat for row in self._rows(query)}

    def holds(self, attempt: Attempt) -> bool:
        """Whether the task is still this attempt's; reads only."""
        return bool(self._rows(select(tasks.c.token).where(transitions.of(attempt))))

    def record(
        self,
        attempt: Attempt,
        iteration: int,
        rows: Mapping[int, Array],
        estimate: Mapping[str, float] | None = None,
        log_likelihood: float | None = None,
        message: str = "",
        ran: float | None = None,
        stage: str = ITERATIONS,
        share: float | None = None,
        memory: Mapping[int, Array] | None = None,
    ) -> bool:
        """Write progress, with the iterations {k: row} done since the last time, and their ``memory``.

        ``share`` of the ``stage`` is done; of the iterations it is known by their number.

        An attempt that says how many seconds it ``ran`` may have to leave here, for others.
        """
        with self._engine.begin() as sql:
            before = locked(sql, attempt.job)
            if not mine(sql, attempt, iteration=iteration):
                return False
            key = {"job": attempt.job, "task": attempt.task}
            if rows:
                known = memory or {}
                new = [
                    key
                    | {"k": k, "row": row.astype(float).tobytes()}
                    | {"memory": known[k].tobytes() if k in known else None}
                    for k, row in rows.items()
                ]
                sql.execute(insert(iterations), new)
            progress: dict[str, Any] = {"updated": time.time(), "stage_share": share}
            if before.stage != stage:
                if stage == ITERATIONS:
                    share = before.iteration / max(before.iterations, 1)
                progress |= {"stage": stage, "stage_begun": time.time(), "stage_from": share or 0.0}
                if before.stage:  # else what is said is how it came to go on
                    progress["message"] = ""
            if message:
                progress["message"] = message
            done = select(func.sum(tasks.c.iteration)).where(tasks.c.job == attempt.job)
            progress["iteration"] = done.scalar_subquery()
            if estimate is not None:
                progress |= {"estimate": dumps(estimate), "log_likelihood": finite(log_likelihood)}
            change_job(sql, attempt.job, **progress)
            return ran is None or not transitions.leave(sql, attempt, ran)

    def keep(self, attempt: Attempt, n: int, text: str, ran: float | None = None) -> bool:
        """Write the n-th text for a later attempt at the job's only task; they go when it is done.

        ``ran`` as in ``record``.
        """
        with self._own(attempt, state="running") as sql:
            if sql is None:
                return False
            transitions.put(sql, attempt.job, f"{KEPT}{n:08d}", text)
            return ran is None or not transitions.leave(sql, attempt, ran)

    def show(self, attempt: Attempt, result: Any) -> bool:
        """Write what is known of the result, in place of what was known before."""
        with self._own(attempt, state="running") as sql:
            if sql is None:
                return False
            known = and_(documents.c.job == attempt.job, documents.c.name == PRELIMINARY)
            sql.execute(delete(documents).where(known))
            transitions.put(sql, attempt.job, PRELIMINARY, dumps(result))
            change_job(sql, attempt.job, found=found_by(result)["found"])
        return True

    def finish(self, attempt: Attempt, result: Any, message: str = "") -> bool:
        """The task is done. The last task of a stage starts the next; that of all ends the job."""
        with self._engine.begin() as sql:
            job = locked(sql, attempt.job)
            if not mine(sql, attempt, state="done"):
                return False
            states = list(sql.scalars(select(tasks.c.state).where(tasks.c.job == attempt.job)))
            ends = list(accumulate(json.loads(job.stages)))
            last = attempt.task + 1 == ends[-1]
            left = "result" if last else f"task-{attempt.task}"
            transitions.put(sql, attempt.job, left, dumps(result))
            if last:
                name = documents.c.name
                left_over = or_(name.startswith(KEPT), name == PRELIMINARY)
                sql.execute(delete(documents).where(documents.c.job == job.seq, left_over))
                told = found_by(result) | reached_by(result)
                transitions.end(sql, job.seq, "successful", message=message, **told)
            elif set(states) == {"done"}:
                stage = ends.index(len(states))
                transitions.add_tasks(sql, attempt.job, ends[stage], ends[stage + 1])
        return True

    def fail(self, attempt: Attempt, problem: Mapping[str, Any]) -> bool:
        """The job failed, for a reason another attempt would meet again."""
        with self._own(attempt, state="stopped") as sql:
            if sql is not None:
                transitions.fail(sql, attempt.job, problem)
        return sql is not None

    def lost(self, attempt: Attempt, cause: str, losses_allowed: int) -> bool:
        """The worker died: queue the task again, or fail the job after too many losses."""
        with self._own(attempt, state="running") as sql:
            if sql is not None:
                transitions.lose(sql, attempt.job, attempt.task, cause, losses_allowed)
        return sql is not None

    def release(self, attempt: Attempt) -> bool:
        """Give a task back unharmed: the service stops and will go on with it later."""
        with self._engine.begin() as sql:
            return mine(sql, attempt, state="queued", token=None)

    def expire(self, silent: Mapping[str, int], losses_allowed: int) -> int:
        """Queue tasks again whose heartbeats, by token, still stand where they stood; how many."""
        lost = 0
        for token, beat in silent.items():
            query = select(tasks).where(
                tasks.c.state == "running", tasks.c.token == token, tasks.c.beat == beat
            )
            with self._engine.begin() as sql:
                if (task := sql.execute(query).one_or_none()) is None:
                    continue
                locked(sql, task.job)
                if (task := sql.execute(query).one_or_none()) is None:  # while waiting for the lock
                    continue
                cause = "the process that watched the worker disappeared"
                transitions.lose(sql, task.job, task.task, cause, losses_allowed)
                lost += 1
        return lost
