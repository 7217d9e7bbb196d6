"""A job as its owner finds it, its result, and its tasks."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from service.auth import Keys
from service.problems import Problem
from service.store import Store

# What the tasks of each stage do, by the number of stages; see ``stages.plan``.
_ROLES = {
    1: ("computation",),
    2: ("start", "choice"),
    3: ("estimate", "bootstrap", "summary"),
    4: ("start", "choice", "bootstrap", "summary"),
}


def find_job(store: Store, keys: Keys, job_id: str, caller: str) -> Any:
    """The caller's job; another's is as unknown as one that does not exist. Raises Problem 404."""
    row = store.job(job_id)
    if row is None or (keys.needed and row.owner != caller):
        raise Problem(404, "no-such-job", f"there is no job '{job_id}'")
    return row


def find_result(store: Store, row: Any) -> bytes:
    """The JSON text of a job's result. Raises Problem: why it failed, or that there is none."""
    if row.status == "failed":
        raise Problem.of(json.loads(row.problem))
    if row.status == "dismissed":
        raise Problem(404, "dismissed", f"job '{row.id}' was dismissed; it has no results")
    body = store.document(row.seq, "result")
    if body is None:
        detail = f"job '{row.id}' is {row.status}; its results come when it is successful"
        raise Problem(404, "result-not-ready", detail, retry_after=1)
    return body


def roles(stages: Sequence[int]) -> list[str]:
    """What each task of a job does, the tasks of later stages included."""
    names = _ROLES[len(stages)]
    return [name for name, n in zip(names, stages, strict=True) for _ in range(n)]
